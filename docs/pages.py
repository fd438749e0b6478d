"""What is made from the code: keys, protocols, metrics, events, the Python interface, gallery, picture of packages.

It is written before each build, mostly into the folders `reference` and `gallery`, and is not kept in the repository.
Each tutorial is also written as a notebook that can be downloaded.
"""

import ast
import re
from collections.abc import Iterator, Mapping
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Any

import api
import import_picture
from pydantic import BaseModel
from thumbnails import thumbnail

import scenarios
from desim import load, run
from desim.analysis.drawing.plots import save
from desim.analysis.metrics import METRICS, Summary
from desim.cli.description import default_of, summary
from desim.config.choice import choices_of
from desim.config.field_docs import docs_of, fields_of
from desim.config.model_parts import models_in
from desim.results.run_folder import EVENTS
from desim.scenario.scenario import PROTOCOLS, Scenario
from desim.view.formats.trace_table import COLUMNS, KINDS, columns_of
from desim.view.pages.replay import replay_page

SCENARIOS = Path(scenarios.__file__).parent
STUDIES = (
    *("rivals", "delay", "range", "liars", "breaking", "contention", "transport", "coherence", "walls"),
    *("bodies", "evaders", "many", "boids"),
    *("table1", "two_clocks", "first_picture", "figures"),
)
"""The studies of the gallery, in its order."""
METRIC_GROUPS: Mapping[str, tuple[str, tuple[str, ...]]] = MappingProxyType(
    {
        "The run": ("Which run it was, and when it ended.", ("seed", "end_time")),
        "Captures": (
            "Who captured which evader, and when.",
            (
                *("captured", "capture_time", "capturer"),
                *("captures", "mean_capture_time", "capture_times", "capturers"),
            ),
        ),
        "Effort": (
            "How long pursuers chase, and how much of that is more than one pursuer per evader. `active_time` is the"
            " usual measure of what an imperfection costs.",
            ("active_time", "idle_time", "crowded_time", "excess_time", "energy"),
        ),
        "The game": (
            "How far the actions are from those that full and immediate knowledge would give.",
            ("misassigned_time", "time_to_relay", "potential_gap", "regret"),
        ),
        "Decisions": (
            "How often pursuers decide and change their minds.",
            ("decisions", "switches", "handovers", "ping_pongs"),
        ),
        "Messages": (
            "What the network carried. A broadcast is one transmission, and one message for each receiver.",
            (
                *("messages_sent", "messages_delivered", "messages_lost", "messages_lost_by", "messages_in_flight"),
                *("transmissions", "bytes_sent", "utilisation"),
            ),
        ),
        "Transport": (
            "What acknowledgements and repetitions achieve, with a transport or a reliable dissemination.",
            (
                *("share_delivered", "mean_attempts", "delivery_delay", "retransmissions", "acknowledgements"),
                *("given_up", "deadlines_missed", "liveliness_lost"),
            ),
        ),
        "Knowledge": (
            "How old, and how wrong, is what pursuers know of each other. These need recorded messages.",
            ("age_mean", "age_peak", "age_at_decision", "belief_error", "believed_leaders"),
        ),
        "Deception": (
            "What checks of announcements find, with `announce.trust`.",
            ("false_accusations", "time_to_detect"),
        ),
    }
)
"""The groups of the page of the metrics: title, a sentence, and the names."""
HEADER = re.compile(r"^([A-Z][a-z]+(?: [a-z]+)*): +")
"""The beginnings of the items in the header of a protocol."""
FIRST = (
    "relay",
    "imperfect",
    "faults",
    "token_ring",
    "auction",
    "server",
    "flooding",
    "radio",
    "lora",
    "contention",
    "reliable",
    "liars",
    "search",
    "many",
)
"""The scenario files that come first in the gallery; the others follow in the order of their names."""


FOLLOWS_THEME = (
    '<script>addEventListener("message", event => { if (event.data && event.data.theme)'
    " window.replay.setTheme(event.data.theme); });</script>\n"
)
"""What lets a replay in a page follow the theme of the page."""


def write(docs: Path) -> None:
    """Write all generated pages and pictures below a folder."""
    for page in (keys, protocols, metrics, events, table):
        _write(docs / "reference" / f"{page.__name__}.md", page())
    for stem, text in api.pages().items():
        _write(docs / "reference" / "api" / f"{stem}.md", text)
    gallery(docs / "gallery")
    broken(docs)
    _write(docs / "explanation" / "packages.svg", import_picture.picture(import_picture.imports()))


def keys() -> str:
    """Return the page of the keys of scenario files: a section for each table, and one for each kind."""
    parts = [
        "# Keys of a scenario file",
        "Every key has a default. The same text is printed by `desim keys KEY`, for instance `desim keys"
        " network.latency.gamma`, and `desim schema` prints the JSON schema, with which an editor completes keys. "
        "In Python the tables are the arguments of `desim.Scenario`.",
        "Units: lengths in m, times in s, angles in degrees, sizes in bytes; latencies are one-way.",
    ]
    for place, model in _models(Scenario):
        heading = ".".join(place)
        parts.append(f"({_anchor(heading)})=\n##{'#' * (len(place) > 1)} {heading or 'The top level'}")
        parts.append(" ".join((model.__doc__ or "").strip().partition("\n\n")[0].split()))
        rows = [_row(place, name, field) for name, field in fields_of(model).items() if name != "kind"]
        if rows:
            parts.append("\n".join(["| key | default | what it is |", "|---|---|---|", *rows]))
    return "\n\n".join(parts) + "\n"


def key_anchors() -> dict[str, str]:
    """Return the anchor of each key and each kind on the page of the keys; `protocol.kind` is at `protocol`."""
    anchors: dict[str, str] = {}
    for place, model in _models(Scenario):
        for name, field in fields_of(model).items():
            if name != "kind":
                key = ".".join((*place, name))
                anchors[key] = _row_anchor(key)
                if choices_of(field):
                    anchors[f"{key}.kind"] = _row_anchor(key)
        if place:
            anchors.setdefault(".".join(place), _anchor(".".join(place)))
    return anchors


def metric_anchors() -> dict[str, str]:
    """Return the anchor of each metric on the page of the metrics, by the attribute of a summary that it is."""
    return {f"summary.{name}": f"metric-{name}" for _, group in METRIC_GROUPS.values() for name in group}


def protocols() -> str:
    """Return the page of the protocols: the header of each module, which names its paper, and its parameters."""
    parts = [
        "# Protocols",
        "How each protocol decides, the paper it is from, what it assumes, what it sends, and how it bears losses and"
        " crashes. The references are listed in [](bibliography.md).",
    ]
    seen: dict[str, list[str]] = {}
    choices = PROTOCOLS.choices()
    for kind, model in choices.items():
        seen.setdefault(model.__module__, []).append(kind)
    for module, kinds in seen.items():
        text = import_module(module).__doc__ or ""
        first, _, fields = text.partition("\n\n")
        parts.append(f"## {', '.join(kinds)}\n\n{' '.join(first.split())}")
        parts.append(listed(fields))
        parts += [f"- `{kind}`: {summary(choices[kind])} [Parameters]({_link(f'protocol.{kind}')})" for kind in kinds]
    return "\n\n".join(parts) + "\n"


def metrics() -> str:
    """Return the page of the metrics, in groups: name, unit and docstring of each."""
    parts = [
        "# Metrics",
        "All are computed from the trace of a run alone. `desim.summary(result)` returns them; tables, JSON, stores and"
        " `--until` use the same names. [](../howto/metrics.md) adds your own.",
    ]
    for title, (text, names) in METRIC_GROUPS.items():
        rows = [f"| [`{name}`]{{#metric-{name}}} | {METRICS[name].unit} | {_meaning(name)} |" for name in names]
        parts += [f"## {title}", text, "\n".join(["| metric | unit | what it is |", "|---|---|---|", *rows])]
    return "\n\n".join(parts) + "\n"


def _meaning(name: str) -> str:
    """Return the docstring of a metric as one line that begins with a noun: "Number of ...", "Time, s, ..."."""
    text = _markdown(docs_of(Summary).get(name) or METRICS[name].of.__doc__ or "").replace("\n\n", " ")
    text = text.removeprefix("The ").removeprefix("the ")
    return (text[:1].upper() + text[1:]).replace("|", r"\|")


def events() -> str:
    """Return the page of the events of a trace: where each is imported from, and its fields."""
    parts = [
        "# Events of a trace",
        "`result.trace` is iterated in the order of time, and `result.trace.of(Decided)` has the events of one type."
        " `t` is a time in integer nanoseconds: divide it by `desim.kernel.core.units.SECOND` for seconds. The events"
        " of messages are recorded with `record.messages = true`, `Sampled` with `record.trajectory` > 0.",
    ]
    for event in EVENTS:
        docs = docs_of(event)
        fields = [f"- `{name}`{': ' * (name in docs)}{_markdown(docs.get(name, ''))}" for name in event._fields]
        parts += [
            f"## {event.__name__}\n\n{_markdown(event.__doc__ or '')}",
            f"```python\nfrom {event.__module__} import {event.__name__}\n```",
            "\n".join(fields),
        ]
    return "\n\n".join(parts) + "\n"


def table() -> str:
    """Return the page of the columns of an exported trace."""
    having = {name: [kind for kind in KINDS if name in columns_of([kind])] for name in COLUMNS}
    own = {name: kinds for name, kinds in having.items() if kinds != [*KINDS]}
    rows = [
        f"| `{name}` | {column.type} | {column.description} | {', '.join(own[name]) if name in own else 'all'} |"
        for name, column in COLUMNS.items()
    ]
    parts = [
        "# Columns of a trace as a table",
        "`desim export` writes the [events](events.md) of a run as a table, in a CSV or Parquet file; see"
        " [File formats](../howto/formats.md#a-table-for-pandas). Started and Sampled have a row for each pursuer and"
        " each evader, Queued, Broadcast and Sent one for each receiver, and any other event has one.",
        "\n".join(["| column | type | what it is | of events |", "|---|---|---|---|", *rows]),
    ]
    return "\n\n".join(parts) + "\n"


def gallery(folder: Path) -> None:
    """Write the gallery: a page for each scenario file, with the replay of its first run, and a card for each study."""
    files = sorted(SCENARIOS.glob("*.toml"), key=lambda path: (_rank(path.stem), path.stem))
    cards = []
    for file in files:
        result = run(load(file, ["record.messages=true", "record.trajectory=0.05"]))
        title, text, commands = _comment(file)
        (folder / "thumbnails").mkdir(parents=True, exist_ok=True)
        replay = replay_page(result).replace("</body>", FOLLOWS_THEME + "</body>")
        _write(folder.parent / "_extra" / "gallery" / "replays" / f"{file.stem}.html", replay)
        save(thumbnail(file.stem, result), folder / "thumbnails" / f"{file.stem}.png")
        _write(folder / f"{file.stem}.md", _scenario_page(file, title, text, commands))
        cards.append(f":::{{grid-item-card}} {file.stem}\n:img-top: thumbnails/{file.stem}.png\n:link: {file.stem}\n"
                     f":link-type: doc\n\n{title}\n:::")  # fmt: skip
    hidden = "\n".join(file.stem for file in files)
    _write(
        folder / "index.md",
        "# Gallery\n\nOne run of each scenario file, as a replay that can be played, and the figure of each study. "
        "`desim examples` lists the files, `desim examples NAME` copies one.\n\n## Scenarios\n\n"
        "::::{grid} 1 2 3 3\n:gutter: 2\n\n" + "\n".join(cards) + "\n::::\n\n## Studies\n\n"
        + "\n\n".join(_study(name) for name in STUDIES)
        + f"\n\n```{{toctree}}\n:hidden:\n\n{hidden}\n```\n",
    )  # fmt: skip


def broken(docs: Path) -> None:
    """Write the replays of the scenarios that break protocols, which the page about them links to."""
    for file in sorted((docs / "_static" / "broken").glob("*.toml")):
        page = replay_page(run(load(file))).replace("</body>", FOLLOWS_THEME + "</body>")
        _write(docs / "_extra" / "howto" / "broken" / f"{file.stem}.html", page)


def _models(model: type[BaseModel]) -> Iterator[tuple[tuple[str, ...], type[BaseModel]]]:
    """Yield each model of scenario files once, with the key of its table, its kind included."""
    known: set[type[BaseModel]] = set()
    waiting: list[tuple[tuple[str, ...], type[BaseModel]]] = [((), model)]
    while waiting:
        place, each = waiting.pop(0)
        if each in known:
            continue
        known.add(each)
        yield place, each
        inner: list[tuple[tuple[str, ...], type[BaseModel]]] = []
        for name, field in fields_of(each).items():
            for choice in choices_of(field):
                inner += [((*place, name, kind), chosen) for kind, chosen in choice.choices().items()]
            inner += [((*place, name), found) for found in models_in(field.annotation)]
        waiting = inner + waiting


def _row(place: tuple[str, ...], name: str, field: Any) -> str:
    """Return the row of a key in the table of its model."""
    plain = next(models_in(field.annotation), None)
    text = " ".join((field.description or (summary(plain) if plain is not None else "")).split())
    kinds = [f"`{kind}`" for choice in choices_of(field) for kind in choice.choices()]
    if kinds:
        text += " Kinds: " + ", ".join(kinds) + "."
    elif plain is not None:
        text += f" See [{name}]({_link('.'.join((*place, name)))})."
    default = default_of(field).removeprefix(" = ")
    anchor = _row_anchor(".".join((*place, name)))
    return f"| [`{name}`]{{#{anchor}}} | {f'`{default}`' if default else ''} | {text} |".replace("|t|", r"\|t\|")


def listed(text: str) -> str:
    """Return a text whose lines "Name: ..." with indented continuations are the items of a list."""
    paragraphs = []
    for paragraph in text.split("\n\n"):
        if not all(HEADER.match(line) or line.startswith(" ") for line in paragraph.splitlines()):
            paragraphs.append(paragraph)
            continue
        items = re.sub(r"\n +", " ", paragraph).splitlines()
        paragraphs.append("\n".join(HEADER.sub(r"- **\1:** ", item) for item in items))
    return "\n\n".join(paragraphs)


def _markdown(text: str) -> str:
    """Return a docstring as Markdown: its paragraphs, without the indentation of the source."""
    return "\n\n".join(" ".join(part.split()) for part in text.removeprefix("Return ").split("\n\n")).strip()


def _comment(file: Path) -> tuple[str, str, list[str]]:
    """Return the first sentence of the comment of a scenario file, the rest of it, and the commands in it."""
    lines = []
    for line in file.read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            break
        lines.append(line.removeprefix("#").strip())
    commands = [line for line in lines if line.startswith(("desim ", "Found by:", "Start here:"))]
    title, stop, rest = " ".join(line for line in lines if line not in commands).partition(". ")
    return title + stop.strip(), rest, [line.partition(": ")[2] if ": d" in line else line for line in commands]


def _scenario_page(file: Path, title: str, text: str, commands: list[str]) -> str:
    """Return the page of a scenario file."""
    shown = [f"desim replay scenarios/{file.name} -o {file.stem}.html", *(each for each in commands if each)]
    return (
        f"# {file.stem}\n\n{title} {text}\n\n"
        f'```{{raw}} html\n<iframe class="replay" src="replays/{file.stem}.html" title="Replay of {file.stem}"'
        f' loading="lazy"></iframe>\n<p><a href="replays/{file.stem}.html">Full screen</a></p>\n```\n\n'
        "```sh\n" + "\n".join(shown) + "\n```\n\n"
        f"```{{literalinclude}} ../../scenarios/{file.name}\n:language: toml\n```\n"
    )


def _study(name: str) -> str:
    """Return the section of a study: the beginning of its docstring, its command, and its figure if it is kept."""
    text = ast.get_docstring(ast.parse((SCENARIOS / f"{name}.py").read_text(encoding="utf-8"))) or ""
    picture = SCENARIOS / f"{name}.svg"
    shown = f"\n\n![{name}](../../scenarios/{picture.name})" if picture.exists() else ""
    first, _, rest = text.partition("\n\n")
    text = f"{' '.join(first.split())} {' '.join(rest.split())}"
    return f"### {name}\n\n{text}\n\n```sh\npython -m scenarios.{name}\n```{shown}"


def _rank(name: str) -> int:
    return FIRST.index(name) if name in FIRST else len(FIRST)


def _anchor(place: str) -> str:
    return "key-" + (place or "top").replace(".", "-").replace("_", "-")


def _row_anchor(key: str) -> str:
    return "row-" + key.replace(".", "-").replace("_", "-")


def _link(place: str) -> str:
    return f"keys.md#{_anchor(place)}"


def _write(path: Path, text: str) -> None:
    """Write a page if it has changed, so that Sphinx reads again only what is new."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")
