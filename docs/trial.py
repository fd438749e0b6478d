"""What the front page runs in a browser: the examples, and desim with its scenarios and SimPy as one archive.

Python itself, numpy and the other packages come from Pyodide, of which `tests/pyodide.json` has the list.
"""

import json
import zipfile
from collections.abc import Iterator
from importlib.metadata import distribution
from pathlib import Path

from desim.config.packages import package_folder
from desim.scenario.examples import example, first_sentence

EXAMPLES = "_static/try_examples.json"
"""The names of the examples, in a file that a test reads, too."""
FOLDER = "_extra/try"
PACKAGES = ("desim", "protocols", "scenarios")
KINDS = {".py", ".toml", ".html", ".css", ".js", ".json", ".csv", ".typed"}
"""The suffixes of files in the archive: code, templates and data, but no figures."""


def write(docs: Path) -> None:
    """Write the archive and the texts of the examples to the folder `_extra/try`."""
    folder = docs / FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "examples.json").write_text(json.dumps(examples(docs)), encoding="utf-8")
    write_archive(folder / "desim.zip")


def examples(docs: Path) -> dict[str, dict[str, str]]:
    """Return the title, the text and the address of the recorded run of each example, by name."""
    names = json.loads((docs / EXAMPLES).read_text(encoding="utf-8"))
    return {
        name: {
            "title": first_sentence(example(name)),
            "toml": example(name).read_text(encoding="utf-8"),
            "replay": f"gallery/replays/{name}.html",
        }
        for name in names
    }


def write_archive(path: Path) -> None:
    """Write the archive; equal files give equal bytes."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name, content in sorted(_contents()):
            archive.writestr(zipfile.ZipInfo(name), content, zipfile.ZIP_DEFLATED, 9)


def _contents() -> Iterator[tuple[str, bytes]]:
    """Yield the name and the content of each file of the archive."""
    for package in PACKAGES:
        root = package_folder(package)
        for file in root.rglob("*"):
            if file.suffix in KINDS and "benchmarks" not in file.relative_to(root).parts and file.is_file():
                yield f"{package}/{file.relative_to(root).as_posix()}", file.read_bytes()
    for name in ("simpy", "pursuit-desim"):
        for entry in distribution(name).files or ():
            is_code = name == "simpy" and entry.parts[0] == "simpy" and entry.suffix == ".py"
            if is_code or entry.name in {"METADATA", "entry_points.txt"}:
                yield entry.as_posix(), Path(str(entry.locate())).read_bytes()
