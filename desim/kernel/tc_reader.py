"""Commands `tc qdisc add ... netem` as the table `[network]` of a scenario, the inverse of `desim.kernel.tc_writer`."""

from pathlib import Path
from typing import Any, NamedTuple

from pydantic import ValidationError

from desim.kernel.links import Links
from desim.kernel.netem_tables import TABLES
from desim.kernel.tc_syntax import HEADERS, LINK, TcError, Way, commands, order_of

DIGITS = 10
"""Significant digits of numbers that are computed from those of a command, which has 12."""
NONE = {"latency": {"kind": "constant", "value": 0.0}, "loss": {"kind": "bernoulli", "p": 0.0}, "order": "overtaking"}
"""The models of a link without imperfections."""
Table = dict[str, Any]


class Reading(NamedTuple):
    """The content of commands of tc."""

    network: Table
    """The table `[network]`."""
    ignored: list[str]
    """Descriptions of what has no effect in desim, with line and column."""


def read_script(text: str, source: str = "tc", folder: Path | None = None) -> Reading:
    """Return the table `[network]` that commands of tc describe.

    A command below a comment `# link SRC -> DST` is for this link, any other for the whole network.

    Args:
        text: the commands, see `desim.kernel.tc_syntax.commands`.
        source: a name of the text, for messages.
        folder: where the tables NAME.dist are; None: the working directory.

    Raises:
        TcError: if a command is invalid or not modelled, a table cannot be read, or two commands for the whole network,
            or for one link, differ.
    """
    found: dict[Way | None, Table] = {}
    ignored: list[str] = []
    for where, way, options in commands(text, source):
        try:
            table = _checked(_network(options, folder or Path()))
        except ValueError as error:
            raise TcError(f"{where}: {error}") from error
        if found.setdefault(way, table) != table:
            which = "the whole network; a command for one link follows a comment # " + _name(("SRC", "DST"))
            raise TcError(f"{where}: differs from the command above for {_name(way) if way else which}")
        if "limit" in options and "rate" not in options:
            ignored.append(f"{where}: limit has no effect without a rate: a link holds any number of messages")
    network = found.pop(None, {})
    links = [_link(way, table, network, source) for way, table in found.items() if way is not None]
    if links := _merged([link for link in links if link.keys() > {"src", "dst"}]):
        network["link"] = links
    try:
        return Reading(_checked(network), ignored)
    except ValueError as error:
        raise TcError(f"{source}: {error}") from error


def _network(options: dict[str, Any], folder: Path) -> Table:
    """Return the table `[network]` of the options of a command; `folder` is that of the tables.

    Raises:
        ValueError: if it has no such models.
    """
    latency, medium = _latency(options, folder), _medium(options)
    order = order_of(reorders="reorder" in latency, has_rate=bool(medium))
    found = {
        "latency": latency,
        "order": order if latency.get("kind", "constant") != "constant" and order != Links().order else None,
        "loss": _loss(*options["loss"]) if "loss" in options else None,
        "duplicate": _random(*options.get("duplicate", (0.0, 0.0))),
        "medium": medium,
    }
    return {key: each for key, each in found.items() if each}


def _latency(options: dict[str, Any], folder: Path) -> Table:
    """Return the table of the latency, of the simplest kind; empty if there is none."""
    delay, jitter, correlation = options.get("delay", (0.0, 0.0, 0.0))
    reorder, reorder_correlation = options.get("reorder", (0.0, 0.0))
    name = options.get("distribution", "uniform") if jitter else "uniform"
    if not (jitter or reorder):
        return {"kind": "constant", "value": delay} if delay else {}
    if name == "uniform" and not (correlation or reorder) and jitter <= delay:
        middle, half = round(delay * 1e9), round(jitter * 1e9)
        return {"kind": "uniform", "low": (middle - half) / 10**9, "high": (middle + half) / 10**9}
    table = {"kind": "netem", "delay": delay, "jitter": jitter, "correlation": correlation if jitter else 0.0}
    if name != "uniform":
        table |= {"distribution": name} if name in TABLES else {"file": str(folder / f"{name}.dist")}
    if reorder:
        table |= {"reorder": reorder, "reorder_correlation": reorder_correlation}
        table |= {"gap": options["gap"]} if options.get("gap", 1) > 1 else {}
    return {key: each for key, each in table.items() if each or key == "delay"}


def _loss(model: str, values: list[float]) -> Table:
    """Return the table of a loss model; empty if nothing is lost. The defaults of its values are those of tc."""
    first, *more = values
    if model == "random":
        return _random(first, more[0] if more else 0.0)
    if model == "gemodel":
        r, bad, good = [*more, *(1.0 - first, 1.0, 0.0)[len(more) :]]
        lost = {"loss_bad": bad} if bad < 1.0 else {}
        return _bursts(first, r) | lost | ({"loss_good": good} if good else {})
    p31, p32, p23, p14 = [*more, *(1.0 - first, 0.0, 1.0, 0.0)[len(more) :]]
    if not (p32 or p14):  # only the states 1 and 3
        return _bursts(first, p31)
    return {"kind": "four_state", "p13": first, "p31": p31, "p32": p32, "p23": p23, "p14": p14}


def _bursts(p: float, r: float) -> Table:
    """Return the table of a Gilbert-Elliott model with the transition probabilities p to bad and r to good.

    Raises:
        ValueError: if r is 0.
    """
    if r == 0.0:
        raise ValueError("loss: a link that is lost for ever is not modelled: its second value should be above 0%")
    share, burst = _rounded(p / (p + r)), _rounded(1.0 / r)
    return {
        "kind": "gilbert_elliott",
        "share": share,
        "burst": max(burst, share / (1.0 - share) if share < 1.0 else 1.0),
    }


def _random(p: float, correlation: float) -> Table:
    """Return the table of a loss model with a probability and a correlation; empty if nothing is lost."""
    if not p:
        return {}
    return {"kind": "correlated", "p": p, "correlation": correlation} if correlation else {"kind": "bernoulli", "p": p}


def _medium(options: dict[str, Any]) -> Table:
    """Return the table of the medium; empty without a rate."""
    if "rate" not in options:
        return {}
    bitrate, overhead = options["rate"]
    limit = {"queue_limit": float(options["limit"] - 1)} if "limit" in options else {}
    return {"kind": "bitrate", "bitrate": bitrate, "header": HEADERS + overhead, **limit}


def _link(way: Way, table: Table, network: Table, source: str) -> Table:
    """Return the table of a link, with the models in which it differs from the network.

    Raises:
        TcError: if it differs in what all links of a network have in common.
    """
    for key, options in (("medium", "rate and limit"), ("duplicate", "duplicate")):
        if table.get(key) != network.get(key):
            raise TcError(f"{source}: {options} of {_name(way)} should be as for the whole network")
    own = {key: table.get(key, none) for key, none in NONE.items() if table.get(key) != network.get(key)}
    return {"src": way[0], "dst": way[1]} | own


def _merged(links: list[Table]) -> list[Table]:
    """Return the tables of links, with one table for the two ways of a link that follow each other and are equal."""
    merged: list[Table] = []
    for link in links:
        if merged and merged[-1] == link | {"src": link["dst"], "dst": link["src"]}:
            merged[-1] |= {"both_ways": True}
        else:
            merged.append(link)
    return merged


def _name(way: tuple[int, int] | tuple[str, str]) -> str:
    return LINK.format(src=way[0], dst=way[1])


def _checked(network: Table) -> Table:
    """Return a table `[network]`.

    Raises:
        ValueError: if a value is invalid.
    """
    try:
        Links.model_validate(network)
    except ValidationError as error:
        first = error.errors()[0]
        why = first["msg"].removeprefix("Value error, ").replace("Input should be", "should be")
        raise ValueError(f"{first['loc'][0]}: {why}") from error
    return network


def _rounded(number: float) -> float:
    return float(f"{number:.{DIGITS}g}")
