"""The loss of radio through a slab of building material: Recommendation ITU-R P.2040-3 (08/2023).

The electrical properties are those of its Table 3: the relative permittivity a, and the conductivity c f^d, S/m, with
the frequency f in GHz. The loss is that of a plane wave at normal incidence on a homogeneous slab (Section 2.2.2.2).
"""

from cmath import exp, sqrt
from math import e, log10, pi
from typing import Literal, NamedTuple, get_args

SPEED_OF_LIGHT = 299_792_458.0
"""m/s"""
LOWEST = 0.4e9
"""Frequency, Hz, down to which the properties are extrapolated for materials whose range begins at 1 GHz: radios use
433, 868 and 915 MHz."""
Material = Literal[
    "concrete",
    "brick",
    "plasterboard",
    "wood",
    "glass",
    "ceiling_board",
    "chipboard",
    "plywood",
    "marble",
    "floorboard",
    "metal",
]
"""The name of a material."""


class Properties(NamedTuple):
    """The electrical properties of a material."""

    permittivity: float
    """a"""
    conductivity: float
    """c, S/m at 1 GHz"""
    exponent: float
    """d"""
    low: float
    """Lowest frequency of its range, Hz."""
    high: float
    """Highest frequency of its range, Hz."""

    @property
    def lowest(self) -> float:
        """The lowest frequency that is accepted, Hz."""
        return min(self.low, LOWEST) if self.low == 1e9 else self.low


MATERIALS: dict[str, Properties] = {
    "concrete": Properties(5.24, 0.0462, 0.7822, 1e9, 100e9),
    "brick": Properties(3.91, 0.0238, 0.16, 1e9, 40e9),
    "plasterboard": Properties(2.73, 0.0085, 0.9395, 1e9, 100e9),
    "wood": Properties(1.99, 0.0047, 1.0718, 1e6, 100e9),
    "glass": Properties(6.31, 0.0036, 1.3394, 0.1e9, 100e9),
    "ceiling_board": Properties(1.48, 0.0011, 1.0750, 1e9, 100e9),
    "chipboard": Properties(2.58, 0.0217, 0.7800, 1e9, 100e9),
    "plywood": Properties(2.71, 0.33, 0.0, 1e9, 40e9),
    "marble": Properties(7.074, 0.0055, 0.9262, 1e9, 60e9),
    "floorboard": Properties(3.66, 0.0044, 1.3515, 50e9, 100e9),
    "metal": Properties(1.0, 1e7, 0.0, 1e9, 100e9),
}
"""Table 3 of ITU-R P.2040-3, by name. The permittivity there is a f^b; b is 0 for all of these materials."""
assert tuple(MATERIALS) == get_args(Material)


def slab_loss(material: str, thickness: float, frequency: float) -> float:
    """Return the loss of a wave that passes a slab at normal incidence, dB.

    Args:
        material: a name in `MATERIALS`.
        thickness: m.
        frequency: Hz.

    Raises:
        ValueError: if the frequency is outside of the range of the material.
    """
    properties = MATERIALS[material]
    if not properties.lowest <= frequency <= properties.high:
        span = f"{properties.lowest / 1e9:g} to {properties.high / 1e9:g} GHz"
        raise ValueError(f"frequency: {material} is known from {span} (got {frequency:g} Hz)")
    in_ghz = frequency / 1e9
    # 17.98 is 1 / (2 pi epsilon_0) in units of GHz m / S.
    root = sqrt(
        complex(properties.permittivity, -17.98 * properties.conductivity * in_ghz**properties.exponent / in_ghz)
    )
    phase = 2.0 * pi * frequency / SPEED_OF_LIGHT * thickness * root
    reflection = (1.0 - root) / (1.0 + root)
    # The logarithm of the product, because exp(-j phase) is 0 in a thick sheet of metal.
    through = abs((1.0 - reflection**2) / (1.0 - reflection**2 * exp(-2j * phase)))
    return max(-20.0 * log10(through) - 20.0 * log10(e) * phase.imag, 0.0)
