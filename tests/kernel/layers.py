"""Networks with a broken part, to see that a test notices it."""

from unittest.mock import patch

from desim.kernel.arrival_losses import ArrivalLosses
from desim.kernel.arrivals import Arrivals
from desim.kernel.delivery import Delivery
from desim.kernel.link_layer import LinkLayer
from desim.kernel.message_log import MessageLog
from desim.kernel.network import Network


def network_over(layer):
    """Return a function that creates a network as `Network` does, with another class in place of a part.

    Args:
        layer: a subclass of `ArrivalLosses`, `Arrivals`, `Delivery`, `MessageLog` or `LinkLayer`.
    """
    places = {
        ArrivalLosses: "arrivals.ArrivalLosses",
        Arrivals: "delivery.Arrivals",
        Delivery: "link_layer.Delivery",
        MessageLog: "link_layer.MessageLog",
        LinkLayer: "network.LinkLayer",
    }
    (place,) = (place for base, place in places.items() if issubclass(layer, base))

    def make(*args, **options):
        with patch(f"desim.kernel.{place}", layer):
            return Network(*args, **options)

    return make
