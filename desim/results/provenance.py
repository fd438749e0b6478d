"""The provenance of results: `run.json` records the command, scenario, seed and code, so that a run can be repeated.

The file has no date: the same command on the same code, in the same environment and folder, writes the same bytes.
"""

import json
import shlex
import sys
from collections.abc import Iterator, Mapping, Sequence, Sized
from functools import partial
from pathlib import Path
from types import FunctionType, MethodType, NoneType
from typing import TYPE_CHECKING, Any

from desim.config.errors import KeyPath
from desim.config.json_numbers import from_json, to_json
from desim.config.tables import nested, object_once
from desim.config.trust import regular_or_missing
from desim.config.whole_files import write_whole
from desim.results.environment import environment

if TYPE_CHECKING:
    from desim.scenario.overrides import Source
    from desim.scenario.scenario import Scenario

Document = dict[str, Any]
"""The content of a run.json, as JSON values."""
FILE = "run.json"
FORMAT = 2
"""The format number of a run.json. It changes when a key changes."""
RUN = "run"
"""The value of `what` in documents of runs, which `desim run` can repeat; `desim run` and `desim play` write them."""
OTHER_COMMANDS = ("sweep", "explain", "merge")
"""The values of `what` in documents that the other commands write; any other value is the name of a study."""
SHAPE: Mapping[str, tuple[type, ...]] = {
    "format": (int,),
    "what": (str,),
    "seed": (int,),
    "runs": (int,),
    "scenario": (dict, NoneType),
    "folder": (str, NoneType),
    "unrecorded": (list,),
    "versions": (dict,),
    "platform": (dict,),
    "commit": (str, NoneType),
    "dirty": (bool, NoneType),
    "code": (str,),
    "argv": (list,),
}
"""The keys of every run.json, and the types of their values."""
PARTS: Mapping[str, str] = {
    "python": "Python",
    "desim": "desim",
    "system": "the operating system",
    "machine": "the processor",
    "libc": "the C library",
    "implementation": "the implementation of Python",
}
"""The parts of an environment in messages, by their keys in `versions` and `platform`; other keys are packages."""
WORDS: Mapping[type, str] = {
    str: "a string",
    int: "an integer",
    bool: "true or false",
    dict: "an object",
    list: "an array",
    NoneType: "null",
}
"""The JSON types of `SHAPE` in messages."""


class ProvenanceError(ValueError):
    """A file is not a run.json, or its runs cannot be repeated; the message has one line per error."""


def document(
    made_by: str,
    scenario: "Scenario | None" = None,
    *,
    seed: int,
    runs: int = 1,
    folder: Path | None = None,
    **more: Any,
) -> Document:
    """Return the provenance of results as a JSON document.

    Args:
        made_by: the command (`RUN` or one of `OTHER_COMMANDS`) or the name of the study that made the results.
        scenario: the scenario of the runs, if there is only one.
        seed: seed of the run; of several runs, a sweep, an explanation or a merge, the root seed. It replaces the seed
            in the recorded scenario.
        runs: number of runs; for an explanation, of runs per variant; for a study, of runs per cell. The runs of
            `desim run` have the seeds `seed`, `seed` + 1, ...
        folder: folder of the scenario file, in which modules and files named by the scenario are looked up.
        more: further entries; infinity becomes the string "Infinity", as in the scenario.
    """
    return {
        "format": FORMAT,
        "what": made_by,
        "seed": seed,
        "runs": runs,
        "scenario": None if scenario is None else scenario.plain() | {"seed": seed},
        "folder": None if folder is None else str(folder.absolute()),
        "unrecorded": [] if scenario is None else list(dict.fromkeys(_unrecorded(scenario))),
        **environment(),
        "argv": list(sys.argv),
        **to_json(more),
    }


def of_one(made: Document, seed: int) -> Document:
    """Return the document of the run with this seed, given the document of several runs."""
    return made | {"seed": seed, "runs": 1, "scenario": made["scenario"] | {"seed": seed}}


def write(folder: Path, made: Document, name: str = FILE) -> None:
    """Write a document to a folder, which is created if missing; the file is replaced atomically.

    Raises:
        OSError: if the file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps(made, indent=2, allow_nan=False)
    write_whole(folder / name, f"{text}\n".encode())


def read(path: Path) -> Document:
    """Return the document in a run.json.

    Raises:
        ProvenanceError: if the file is not a run.json; the message names all missing keys or wrong values.
        OSError: if the file cannot be read.
    """
    content = regular_or_missing(path).read_bytes()
    try:
        made = json.loads(content, object_pairs_hook=object_once)
    except json.JSONDecodeError as error:
        hint = f"; a scenario file is run without --from: desim run {path}" if path.suffix == ".toml" else ""
        raise ProvenanceError(f"{path}:{error.lineno}: not JSON: {error.msg}{hint}") from error
    except (ValueError, RecursionError) as error:
        raise ProvenanceError(f"{path}: not JSON: {error}") from error
    if not isinstance(made, dict):
        raise ProvenanceError(f"{path}: is not a {FILE}: should be a JSON object")
    if "what" in made and made.get("format") != FORMAT:
        raise ProvenanceError(f"{path}: {other_format(made.get('format'), FORMAT)}")
    if missing := [key for key in SHAPE if key not in made]:
        raise ProvenanceError(f"{path}: is not a {FILE}: missing keys {', '.join(missing)}")
    if errors := list(_errors(made)):
        raise ProvenanceError("\n".join(f"{path}: {error}" for error in errors))
    return made


def other_format(version: object, expected: int) -> str:
    """Return the error message for a file of another format; files without a format number predate the first format."""
    return (
        f"has {'no format number' if version is None else f'format {version!r}'}, and this version of desim reads"
        f" format {expected}: use the version that wrote it, or run the scenario again (scenario.toml beside it)"
    )


def home(path: Path, made: Document) -> Path:
    """Return the recorded folder of the scenario file; if there is none or it is gone, the folder of the run.json."""
    folder = None if made["folder"] is None else Path(made["folder"])
    return folder if folder is not None and folder.is_dir() else path.parent


def source(path: Path, made: Document, overrides: Sequence[str] = (), *, allow_import: bool = False) -> "Source":
    """Return the recorded scenario of a run.json with overrides, not yet validated.

    Files and modules named by the scenario are looked up in `home(path, made)` if imports are allowed. Otherwise they
    are looked up in the folder of the run.json, because an untrusted file may record any folder.

    Raises:
        ProvenanceError: if `what` is not `RUN`, if the scenario is missing, or if the scenario names a model that
            cannot be imported.
        ScenarioError: if an override is wrong.
    """
    from desim.scenario.overrides import Source
    from desim.scenario.scenario import Scenario

    if made["what"] != RUN or made["scenario"] is None:
        made_by = made["what"]
        if made_by in OTHER_COMMANDS:
            origin = f"was written by desim {made_by}"
        else:
            origin = "records a run without its scenario" if made_by == RUN else f"records the study {made_by!r}"
        command = shlex.join(map(str, made["argv"]))
        raise ProvenanceError(f"{path}: {origin}, which desim run cannot repeat; it was made by: {command}")
    folder = home(path, made) if allow_import else path.parent
    recorded = Source(str(path), _overridable(made["scenario"]), Scenario, folder=folder, allow_import=allow_import)
    for override in overrides:
        recorded.override(override)
    if not_importable := list(_not_importable(recorded.tables)):
        raise ProvenanceError("\n".join(f"{recorded.where(place)}: {text}" for place, text in not_importable))
    return recorded


def differences(recorded: Document, current: Document) -> list[str]:
    """Return why results may differ from recorded ones: changed parts of the environment, unrecorded parameters."""
    reasons = [
        f"{PARTS.get(name, f'the package {name}')} was {recorded[key].get(name) or 'unknown'}"
        f" and is {current[key].get(name) or 'unknown'}"
        for key in ("versions", "platform")
        for name in sorted({*recorded[key], *current[key]})
        if recorded[key].get(name) != current[key].get(name)
    ]
    if recorded["code"] != current["code"]:
        reasons.append(f"the code of desim was {_commit(recorded)} and is {_commit(current)}")
    return reasons + [f"the parameters of {key} are not recorded" for key in recorded["unrecorded"]]


def _commit(made: Document) -> str:
    return f"{made['commit'] or 'of no commit'}{' with changes' if made['dirty'] else ''}, {made['code']}"


def _errors(made: Document) -> Iterator[str]:
    """Yield the errors in the values of a document that has all keys."""
    for key, kinds in SHAPE.items():
        if type(made[key]) not in kinds:
            yield f"{key}: should be {' or '.join(WORDS[kind] for kind in kinds)} (got {json.dumps(made[key])})"
    runs, seed, scenario = made["runs"], made["seed"], made["scenario"]
    if type(runs) is int and runs < 1:
        yield f"runs: should be at least 1 (got {runs})"
    if type(seed) is int and isinstance(scenario, dict) and scenario.get("seed", seed) != seed:
        yield f"seed: should equal the seed of the scenario, {json.dumps(scenario['seed'])} (got {seed})"


def _overridable(scenario: Document) -> Document:
    """Return the tables of a recorded scenario, in which each key can be overridden as in a scenario file.

    The string "Infinity" becomes a number again. A recorded network has all values, those of its preset included.
    Values equal to those of the preset (or, if there is no preset, to the defaults) are removed. Otherwise they would
    take precedence over the values of a preset given by an override.
    """
    from desim.kernel.models.links import Links
    from desim.kernel.models.presets import PRESETS

    # A scenario with the name "Infinity" keeps this text.
    tables: Document = {key: value if key == "name" else from_json(value) for key, value in scenario.items()}
    network = tables.get("network")
    if isinstance(network, dict) and ((preset := network.get("preset")) is None or str(preset) in PRESETS):
        defaults = from_json(Links(preset=preset).plain())
        is_needed = {key: key == "preset" or value != defaults.get(key) for key, value in network.items()}
        tables["network"] = {key: value for key, value in network.items() if is_needed[key]}
    return tables


def _not_importable(tables: Document) -> Iterator[tuple[KeyPath, str]]:
    """Yield (key path, error) for each model that cannot be imported, such as one defined in a script."""
    for (*place, key), value in nested(tables):
        if key == "kind" and isinstance(value, str) and (value.startswith("__main__:") or "<" in value):
            text = f"{value!r} was defined in a script or in a function and cannot be imported; move it to a module"
            yield tuple(place), f"{'.'.join(map(str, place))}: {text}"


def _unrecorded(node: Any, place: tuple[str, ...] = ()) -> Iterator[str]:
    """Yield the dotted key of each callable object with state that is neither a model nor a dataclass.

    The state of such an object is not recorded. The parameters of models and dataclasses are recorded, with two
    exceptions, whose keys are also yielded: parameters that JSON can only name, and those that their object discards.
    """
    from pydantic import BaseModel

    from desim.config.choice import choices_of
    from desim.config.parameters import is_named_only, not_kept, parameters_of
    from desim.config.traits import is_ours

    if isinstance(node, BaseModel):
        members = dict(node)
    elif (parameters := parameters_of(node)) is not None:
        members = parameters
        yield from (".".join((*place, name)) for name in not_kept(node))
    elif isinstance(node, tuple | dict) and not callable(node):  # such as the grid of a sweep
        members = {str(k): entry for k, entry in (node.items() if isinstance(node, dict) else enumerate(node))}
    else:
        if callable(node) and not isinstance(node, FunctionType | type) and _has_state(node):
            yield ".".join(place)
        return
    for name, value in members.items():
        yield from _unrecorded(value, (*place, name))
        field = getattr(type(node), "model_fields", {}).get(name)
        is_chosen = field is not None and choices_of(field)  # the name of a model selects it, so nothing is lost
        if not (isinstance(node, tuple | dict) or is_ours(type(node)) or is_chosen) and is_named_only(value):
            yield ".".join((*place, name))


def _has_state(model: Any) -> bool:
    """Return whether an object holds anything: attributes, arguments of a partial function, an object, or items."""
    return isinstance(model, partial | MethodType) or bool(
        model.__getstate__() or (isinstance(model, Sized) and len(model))
    )
