"""The packages that only an extra installs: a message names the extra and the command that installs it."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from types import MappingProxyType

EXTRAS: Mapping[str, str] = MappingProxyType(
    {
        "PIL": "plot",
        "anywidget": "notebook",
        "dask": "cluster",
        "distributed": "cluster",
        "greenlet": "rl",
        "gymnasium": "rl",
        "imageio_ffmpeg": "film",
        "jinja2": "plot",
        "matplotlib": "plot",
        "mcap": "mcap",
        "msgspec": "live",
        "pandas": "frame",
        "pettingzoo": "rl",
        "pyarrow": "parquet",
        "traitlets": "notebook",
    }
)
"""The extra that installs a package, by the name with which the package is imported."""


def missing(package: str, extra: str | None = None) -> str:
    """Return the message for a package that is not installed, given the extra that installs it."""
    extra = extra or EXTRAS[package]
    return f"{package} is missing: pip install 'pursuit-desim[{extra}]', or in a clone pip install '.[{extra}]'"


@contextmanager
def naming_extras() -> Iterator[None]:
    """Name the extra if a package that only an extra installs is missing; also a decorator.

    Raises:
        ModuleNotFoundError: as Python raises it, but with the command that installs the package.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if package not in EXTRAS:
            raise
        raise ModuleNotFoundError(missing(package), name=package) from None
