"""The packages that are installed beside `desim`: `protocols` and `scenarios`."""

from pathlib import Path

_SITE = Path(__file__).parents[2]


def folder_of(package: str) -> Path:
    """Return the folder of a package that is installed beside `desim`, whatever `sys.path` has first."""
    return _SITE / package
