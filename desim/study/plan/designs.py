"""The points of a design: numbers between 0 and 1 for each key that is drawn, and the settings of each point."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import Any

from desim.config.arrays import Floats
from desim.kernel.core.seeds import stream
from desim.scenario.sweep_table import Design
from desim.scenario.value_ranges import is_range, setting_at


def unit_points(design: Design, dimensions: int) -> Floats:
    """Return the (size, dimensions) points of a design, each number in [0, 1).

    Sources: Sobol 1967, "On the distribution of points in a cube", scrambled as by Owen 1998, "Scrambling Sobol' and
    Niederreiter-Xing points"; McKay, Beckman & Conover 1979, "A comparison of three methods for selecting values of
    input variables" (Latin hypercubes).
    """
    rng = stream(design.seed, "design")
    if design.method == "random":
        return rng.random((design.size, dimensions))
    from scipy.stats import qmc  # slow to import

    if design.method == "latin_hypercube":
        return qmc.LatinHypercube(dimensions, seed=rng).random(design.size)  # type: ignore[no-any-return]
    # `random_base2` gives the same points as `random`, which warns if their number is no power of 2.
    exponent = (design.size - 1).bit_length()
    return qmc.Sobol(dimensions, seed=rng).random_base2(exponent)[: design.size]  # type: ignore[no-any-return]


def drawn_keys(grid: Mapping[str, Sequence[Any]], design: Design) -> list[str]:
    """Return the keys of a grid whose values a design draws: keys with a range, and keys that the design names."""
    return [key for key, values in grid.items() if is_range(values) or key in design.drawn]


def design_settings(grid: Mapping[str, Sequence[Any]], design: Design) -> Iterator[dict[str, Any]]:
    """Yield the settings of each point of a design, with all combinations of the values of the other keys.

    Repeated settings are left out: several points may select the same value of a short list.
    """
    keys = drawn_keys(grid, design)
    others = {key: values for key, values in grid.items() if key not in keys}
    yielded = set()
    for point in unit_points(design, len(keys)).tolist():
        at_point = {key: setting_at(grid[key], share) for key, share in zip(keys, point, strict=True)}
        for values in product(*others.values()):
            by_key = at_point | dict(zip(others, values, strict=True))
            settings = {key: by_key[key] for key in grid}
            if repr(settings) not in yielded:
                yielded.add(repr(settings))
                yield settings
