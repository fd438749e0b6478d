"""Networks with a broken part, to see that a test notices it."""

from unittest.mock import patch

from desim.kernel.arrivals import Arrivals
from desim.kernel.network import Network


def network_over(layer):
    """Return a function that creates a network as `Network` does, with another class in place of a part.

    Args:
        layer: a subclass of `Arrivals` or of `LinkLayer`.
    """
    place = "link_layer.Arrivals" if issubclass(layer, Arrivals) else "network.LinkLayer"

    def make(*args, **options):
        with patch(f"desim.kernel.{place}", layer):
            return Network(*args, **options)

    return make
