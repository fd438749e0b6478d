"""Networks with a broken part, to see that a test notices it."""

from functools import partial
from unittest.mock import patch

from desim.kernel.link_layer.arrival_losses import ArrivalLosses
from desim.kernel.link_layer.arrivals import Arrivals
from desim.kernel.link_layer.delivery import MessageDelivery
from desim.kernel.link_layer.link_layer import LinkLayer, MessageLog
from desim.kernel.network import Network


def network_over(layer):
    """Return a function that creates a network as `Network` does, with another class in place of a part.

    Args:
        layer: a subclass of `ArrivalLosses`, `Arrivals`, `MessageDelivery`, `MessageLog` or `LinkLayer`.
    """
    if issubclass(layer, LinkLayer):
        return partial(Network, link_layer=layer)
    places = {
        ArrivalLosses: "link_layer.link_layer.ArrivalLosses",
        Arrivals: "link_layer.link_layer.Arrivals",
        MessageDelivery: "link_layer.link_layer.MessageDelivery",
        MessageLog: "link_layer.link_layer.MessageLog",
    }
    (place,) = (place for base, place in places.items() if issubclass(layer, base))

    def make(*args, **options):
        with patch(f"desim.kernel.{place}", layer):
            return Network(*args, **options)

    return make
