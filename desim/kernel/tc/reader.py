"""Commands `tc qdisc add ... netem` as the table `[network]` of a scenario, the inverse of `desim.kernel.tc.writer`."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import ValidationError

from desim.config.error_texts import text_of
from desim.kernel.models.links import Links
from desim.kernel.models.netem import MAX_JITTER
from desim.kernel.models.netem_tables import TABLES
from desim.kernel.models.own_links import Way
from desim.kernel.tc.syntax import FORM, HEADERS, LINK, Command, Device, TcError, commands, order_of
from desim.kernel.tc.units import p_of, shortest, steps_of

NONE = {"latency": {"kind": "constant", "value": 0.0}, "loss": {"kind": "bernoulli", "p": 0.0}, "order": "overtaking"}
"""The models of a link without imperfections."""
TomlTable = dict[str, Any]


class Reading(NamedTuple):
    """The content of commands of tc."""

    network: TomlTable
    """The table `[network]`."""
    ignored: list[str]
    """Descriptions of what has no effect in desim, with line and column."""


def read_script(text: str, source: str = "tc", folder: Path | None = None) -> Reading:
    """Return the table `[network]` that commands of tc describe.

    A command below a comment `# link SRC -> DST` is for this link, any other for the whole network. The last command
    for a device counts, see `_changed`; a deletion that no further command follows has no effect.

    Args:
        text: the commands, see `desim.kernel.tc.syntax.commands`.
        source: a name of the text, for messages.
        folder: where the tables NAME.dist are; None: the working directory.

    Raises:
        TcError: if a command is invalid or not modelled, none adds netem, a table cannot be read, or two devices for
            the whole network, or for one link, differ.
    """
    disciplines = _disciplines(commands(text, source))
    if not disciplines:
        raise TcError(f"{source}: no command adds netem, so nothing is read; {FORM.partition('; ')[2]}")
    tables: dict[Way | None, TomlTable] = {}
    ignored: list[str] = []
    for command in disciplines:
        where, way = command.where, command.way
        try:
            table = _checked(_network(command.options, folder or Path()))
        except ValueError as error:
            raise TcError(f"{where}: {error}") from error
        if tables.setdefault(way, table) != table:
            network_name = "the whole network; a command for one link follows a comment # " + _name(("SRC", "DST"))
            raise TcError(f"{where}: differs from the command above for {_name(way) if way else network_name}")
        if "limit" in command.options and "rate" not in command.options:
            ignored.append(f"{where}: limit has no effect without a rate: a link holds any number of messages")
    network = tables.pop(None, {})
    links = [_link(way, table, network, source) for way, table in tables.items() if way is not None]
    if links := _merged([link for link in links if link.keys() > {"src", "dst"}]):
        network["link"] = links
    try:
        return Reading(_checked(network), ignored)
    except ValueError as error:
        raise TcError(f"{source}: {error}") from error


def _disciplines(script: Iterable[Command]) -> list[Command]:
    """Return the last command for each device, with the options that are then in effect, in the order of the text.

    A second `add` for a device, which Linux refuses, counts as one for another device.
    """
    # The key of a discipline is its device and the number of the command that added it. `present` has the keys of
    # those that no command has deleted.
    commands_by_key: dict[tuple[Device, int], Command] = {}
    present: dict[Device, tuple[Device, int]] = {}
    for number, command in enumerate(script):
        if command.action == "delete":
            *device, parent = command.device
            deleted = [place for place in present if [*place[:-1]] == device and parent in {"", place[-1]}]
            present = {place: key for place, key in present.items() if place not in deleted}
            continue
        key = present.get(command.device)
        if key is not None and command.action != "add":
            commands_by_key[key] = _changed(commands_by_key[key], command)
            continue
        if key is None:  # a new discipline replaces those of the device that were deleted
            commands_by_key = {
                other: last
                for other, last in commands_by_key.items()
                if other[0][:-1] != command.device[:-1] or other[0] in present
            }
        key = present[command.device] = command.device, number
        commands_by_key[key] = command
    return list(commands_by_key.values())


def _changed(before: Command, command: Command) -> Command:
    """Return a command `change` or `replace`, with the options of the command before that it leaves in effect.

    A `replace` changes an existing discipline, unless its handle differs (tc_modify_qdisc, net/sched/sch_api.c of
    Linux). Options that are not given are reset, except the table of a distribution, the rate and, if no correlation is
    given, the correlations (netem_change, net/sched/sch_netem.c).

    Raises:
        TcError: if correlations stay in effect.
    """
    way = command.way or before.way
    if command.action == "replace" and command.handle not in {"", before.handle}:
        return command._replace(way=way)
    if _has_correlation(before.options) and not _has_correlation(command.options):
        raise TcError(
            f"{command.where}: leaves the correlations of the command before in effect: give one of them again"
        )
    kept = {name: before.options[name] for name in ("distribution", "rate") if name in before.options}
    return command._replace(way=way, handle=command.handle or before.handle, options=kept | command.options)


def _has_correlation(options: TomlTable) -> bool:
    """Return whether the options of a command have a correlation of delay, loss or duplicate."""
    model, values = options.get("loss", ("", []))
    delay, duplicate = options.get("delay", (0.0, 0.0, 0.0)), options.get("duplicate", (0.0, 0.0))
    return bool(delay[2] or duplicate[1] or (model == "random" and values[1:] not in ([], [0.0])))


def _network(options: dict[str, Any], folder: Path) -> TomlTable:
    """Return the table `[network]` of the options of a command; `folder` has the tables NAME.dist.

    Raises:
        ValueError: if desim has no model of the options.
    """
    latency, medium = _latency(options, folder), _medium(options)
    order = order_of(reorders="reorder" in latency, has_rate=bool(medium))
    tables = {
        "latency": latency,
        "order": order if latency.get("kind", "constant") != "constant" and order != Links().order else None,
        "loss": _loss(*options["loss"]) if "loss" in options else None,
        "duplicate": _random(*options.get("duplicate", (0.0, 0.0))),
        "medium": medium,
    }
    return {key: table for key, table in tables.items() if table}


def _latency(options: dict[str, Any], folder: Path) -> TomlTable:
    """Return the table of the latency, of the simplest kind; empty if there is none."""
    delay, jitter, correlation = options.get("delay", (0.0, 0.0, 0.0))
    reorder, reorder_correlation = options.get("reorder", (0.0, 0.0))
    name = options.get("distribution", "uniform") if jitter else "uniform"
    if not (jitter or reorder):
        return {"kind": "constant", "value": delay} if delay else {}
    if name == "uniform" and not (correlation or reorder) and jitter <= min(delay, MAX_JITTER):
        middle, half = round(delay * 1e9), round(jitter * 1e9)
        return {"kind": "uniform", "low": (middle - half) / 10**9, "high": (middle + half) / 10**9}
    table = {"kind": "netem", "delay": delay, "jitter": jitter, "correlation": correlation if jitter else 0.0}
    if name != "uniform":
        table |= {"distribution": name} if name in TABLES else {"file": str(folder / f"{name}.dist")}
    if reorder:
        table |= {"reorder": reorder, "reorder_correlation": reorder_correlation}
        table |= {"gap": options["gap"]} if options.get("gap", 1) > 1 else {}
    return {key: value for key, value in table.items() if value or key == "delay"}


def _loss(model: str, values: list[float]) -> TomlTable:
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


def _bursts(p: float, r: float) -> TomlTable:
    """Return the table of a Gilbert-Elliott model with the transition probabilities p to bad and r to good.

    Raises:
        ValueError: if r is 0.
    """
    if r == 0.0:
        raise ValueError("loss: a link that is lost for ever is not modelled: its second value should be above 0%")
    # The shortest numbers that give the same command, so that it stays the same when it is printed again.
    burst = shortest(1.0 / r, lambda burst: steps_of(1.0 / burst) == steps_of(r))
    odds = p * burst
    share = shortest(odds / (1.0 + odds), lambda share: share < 1.0 and steps_of(p_of(share, burst)) == steps_of(p))
    # The maximum allows for rounding: these are the shortest bursts of the model.
    return {"kind": "gilbert_elliott", "share": share, "burst": max(burst, share / (1.0 - share), 1.0)}


def _random(p: float, correlation: float) -> TomlTable:
    """Return the table of a loss model with a probability and a correlation; empty if nothing is lost."""
    if not p:
        return {}
    return {"kind": "correlated", "p": p, "correlation": correlation} if correlation else {"kind": "bernoulli", "p": p}


def _medium(options: dict[str, Any]) -> TomlTable:
    """Return the table of the medium; empty without a rate."""
    if "rate" not in options:
        return {}
    bitrate, overhead = options["rate"]
    # netem counts the packet that is transmitted, too.
    limit = {"queue_limit": float(options["limit"] - 1)} if "limit" in options else {}
    return {"kind": "bitrate", "bitrate": bitrate, "header": HEADERS + overhead, **limit}


def _link(way: Way, table: TomlTable, network: TomlTable, source: str) -> TomlTable:
    """Return the table of a link, with the models in which it differs from the network.

    Raises:
        TcError: if it differs in what all links of a network have in common.
    """
    for key, options in (("medium", "rate and limit"), ("duplicate", "duplicate")):
        if table.get(key) != network.get(key):
            raise TcError(f"{source}: {options} of {_name(way)} should be as for the whole network")
    differing = {key: table.get(key, none) for key, none in NONE.items() if table.get(key) != network.get(key)}
    return {"src": way[0], "dst": way[1]} | differing


def _merged(links: list[TomlTable]) -> list[TomlTable]:
    """Return the tables of links; if those of both ways of a link are equal and successive, they are one table."""
    merged: list[TomlTable] = []
    for link in links:
        if merged and merged[-1] == link | {"src": link["dst"], "dst": link["src"]}:
            merged[-1] |= {"both_ways": True}
        else:
            merged.append(link)
    return merged


def _name(way: tuple[int, int] | tuple[str, str]) -> str:
    return LINK.format(src=way[0], dst=way[1])


def _checked(network: TomlTable) -> TomlTable:
    """Return a table `[network]`.

    Raises:
        ValueError: if a value is invalid.
    """
    try:
        Links.model_validate(network)
    except ValidationError as error:
        first = error.errors()[0]
        raise ValueError(f"{first['loc'][0]}: {text_of(first)}") from error
    return network
