"""The example scenario files of the installed package `scenarios`."""

import re
import tomllib
from collections.abc import Mapping
from itertools import takewhile
from pathlib import Path

from desim.config.arguments import naming_arguments
from desim.config.packages import package_folder
from desim.config.suggestion import did_you_mean
from desim.config.tables import nested
from desim.config.whole_files import write_new


@naming_arguments
def examples() -> Mapping[str, Path]:
    """Return the path of each example scenario file by its name, sorted; use it as in `load(examples()["relay"])`."""
    return {path.stem: path for path in sorted(package_folder("scenarios").glob("*.toml"))}


def example(name: str) -> Path:
    """Return the path of an example, given its name with or without the suffix .toml.

    Raises:
        ValueError: if there is no such example.
    """
    paths = examples()
    stem = name.removesuffix(".toml")
    if stem not in paths:
        raise ValueError(f"there is no example {name!r}{did_you_mean(stem, paths)}; allowed: {', '.join(paths)}")
    return paths[stem]


def first_sentence(path: Path) -> str:
    """Return the first sentence of the comment at the head of a scenario file."""
    lines = path.read_text(encoding="utf-8").splitlines()
    comment = " ".join(line.lstrip("# ") for line in takewhile(lambda line: line.startswith("#"), lines))
    return re.split(r"(?<=[.?!])\s", comment, maxsplit=1)[0]


def copy_example(name: str, target: Path = Path()) -> list[Path]:
    """Copy an example and the data files that it names; return the paths of the copies, the scenario file first.

    Args:
        name: the name of the example.
        target: the path of the copied scenario file if it ends in .toml and is not a folder, else its folder. The
            data files are copied to the same folder. Missing folders are created.

    Raises:
        ValueError: if there is no such example.
        FileExistsError: if a copy exists already; then nothing is written.
        OSError: if a file cannot be written.
    """
    source = example(name)
    file = target if target.suffix == ".toml" and not target.is_dir() else target / source.name
    copies = {file: source} | {file.parent / companion.name: companion for companion in _named_files(source)}
    write_new({path: source_file.read_bytes() for path, source_file in copies.items()})
    return list(copies)


def _named_files(path: Path) -> list[Path]:
    """Return the files that a scenario file names: each string in it that is the path of a file in its folder."""
    values = (value for _, value in nested(tomllib.loads(path.read_text(encoding="utf-8"))))
    beside = (path.parent / value for value in values if isinstance(value, str))
    return sorted({path for path in beside if path.is_file()})
