"""The errors of a scenario file: the line of each, and its sentence, which `desim.config.key_errors` words."""

import re
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from desim.config.errors import KeyPath, Problem, cause_in
from desim.config.key_errors import Wording
from desim.config.model import Value
from desim.scenario.overrides import ScenarioError, Source

Model = TypeVar("Model", bound=Value)
BASE = "base"
"""The key of a scenario file that names its base; it is no field of a scenario."""


def validated(source: Source, model: type[Model]) -> Model:
    """Return the scenario of a source; raise ScenarioError with all errors of the source, sorted by line."""
    folder = Path(source.name).parent if source.folder is None else source.folder
    context = {"folder": folder, "allow_import": source.allow_import, "is_program": source.is_program}
    try:
        return model.model_validate(source.tables, context=context)
    except ValidationError as error:
        problems, cause = _problems(error, source, model), cause_in(error)
    raise ScenarioError(*sorted(problems, key=lambda problem: (problem.line, problem.where, str(problem)))) from cause


def _problems(error: ValidationError, source: Source, model: type[Value]) -> list[Problem]:
    """Return the problems that an error of pydantic describes."""

    def more(place: KeyPath) -> list[str]:
        return [BASE] if source.line(place) else []  # only a key that is in a file has a line

    wording = Wording(source.tables, model, _as_toml, more)
    return [
        Problem(
            _reason(place, reason) + _of_link(source, reason),
            ".".join(map(str, place)),
            source.where(place),
            source.line(place),
        )
        for place, reason in wording.all_problems(error)
    ]


def _of_link(source: Source, reason: str) -> str:
    """Return where files and modules are looked up, if one was not found and the scenario is a link to a file."""
    file = Path(source.name)
    if source.folder is not None or not file.is_symlink() or not re.search(r"cannot be (read|imported)", reason):
        return ""
    return f"; {file} is a link to {file.readlink()}, and what it names is looked up beside the link"


def _reason(place: KeyPath, reason: str) -> str:
    if place == (BASE,):
        return "is a key of scenario files only: it cannot be set, and a recorded scenario is complete without it"
    return reason if place else f"the file: {reason}"


def _as_toml(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else repr(value)
