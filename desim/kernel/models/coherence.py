"""How the fading and the shadowing of links change with time and place.

The wave that arrives is a sum of plane waves from many directions (Clarke 1968, "A Statistical Theory of Mobile-Radio
Reception"; Jakes 1974, "Microwave Mobile Communications", 1.1). So a node that moves by a fraction of a wavelength
meets another fade, and one that returns to a place finds the fade that it has left. Shadowing changes over many metres
(Gudmundson 1991, "Correlation Model for Shadow Fading in Mobile Radio Systems").
"""

from collections.abc import Callable
from typing import Annotated, Literal, NamedTuple

from pydantic import Field

from desim.config.arrays import Floats
from desim.config.model import Length, Value

Variation = Literal["fading", "shadowing"]
"""What varies about the mean power of a message: the sum of waves within a wavelength, or obstacles within metres."""
LIGHT = 299_792_458.0
"""Speed of light, m/s."""
Frequency = Annotated[float, Field(ge=1e6, le=1e12, strict=True)]
"""Hz: a smaller number is one in MHz or GHz."""


class ChannelState(NamedTuple):
    """The states of the channels of k pairs of nodes at one instant, from which the powers of a message follow."""

    normals: Callable[[int], Floats]
    """`normals(count)` returns (count, k) numbers; each is distributed normally with mean 0 and variance 1 over the
    seeds, and is a process in time and place that is independent of the others of its pair."""
    shadowing: Callable[[], Floats]
    """Returns (k,) numbers with the same distribution: the shadowing in units of its standard deviation."""


class Coherence(Value):
    """How the random reception of links changes with time and place; only with `fading = "correlated"`.

    Both directions of a link share the channel (reciprocity). Its state is a function of the seed, the pair, the
    positions of both nodes and the time, so it does not depend on who asks for it, when or how often.
    """

    frequency: Frequency | None = None
    """Carrier frequency f, Hz; fading changes as a node moves by a part of the wavelength c / f.

    A node with speed v meets the Doppler frequency f_d = v f / c, and the complex gain has the autocorrelation J0(2 pi
    f_d t) (Clarke 1968). If both nodes move, the autocorrelation is the product of both (Akki & Haber 1986, "A
    Statistical Model of Mobile-to-Mobile Land Communication Channel"). 2.4e9 is that of Wi-Fi, 868e6 of LoRa in Europe.
    None: fading does not depend on positions.
    """
    doppler: Annotated[float, Field(gt=0, le=1e6, strict=True)] | None = None
    """Doppler frequency f_d, Hz, due to what moves around the nodes, in addition to that of their own motion.

    If in doubt, 1 to 5 among people and vehicles; None: the surroundings are at rest, and nodes that do not move keep
    their fade.
    """
    decorrelation: Length | None = None
    """Decorrelation distance d of the shadowing, m.

    Its autocorrelation is exp(-|dx| / d) if one node of a link moves by dx (Gudmundson 1991), and
    exp(-(|dx| + |dy|) / d) if its nodes move by dx and dy (Wang, Tameh & Nix 2008, "Joint Shadowing Process in Urban
    Peer-to-Peer Radio Channels"). If both move, the simulated autocorrelation is off by up to 0.02 in the mean over the
    seeds, and by up to 0.14 with 8 `waves`.

    If in doubt, 5 indoors and 20 in the open.
    """
    shared: Annotated[float, Field(ge=0, lt=1, strict=True)] = 0.0
    """Share of the variance of the shadowing that is due to the surroundings of the two nodes, half to each, in [0, 1).

    So two links with one node in common have the correlation shared / 2, and if only one node of a link moves, the
    autocorrelation tends to shared / 2.

    If in doubt, 0.5, half of the variance.
    """
    waves: Annotated[int, Field(ge=8, le=4096, strict=True)] = 64
    """Number n of plane waves.

    The distribution function of the power of Rayleigh fading is wrong by at most 0.12 / n, and deep fades are too rare
    by the share 1 / (2 n); the cost grows with n.

    If in doubt, 64: these errors are then 0.2 % and 0.8 %.
    """

    def lacks(self, variation: Variation) -> str:
        """Return which keys are missing for a model of reception with this variation, as a sentence; "" if none is."""
        if variation == "shadowing":
            return "" if self.decorrelation is not None else "decorrelation (m) is needed, because of the shadowing"
        can_fade = self.frequency is not None or self.doppler is not None
        return "" if can_fade else "frequency or doppler (Hz) is needed, because the power fades"
