"""Networks over a link layer of another class, to see that a test notices one that is broken."""

from unittest.mock import patch

from desim.kernel.network import Network


def network_over(layer):
    """Return a function that creates a network as `Network` does, with its messages carried by another class."""

    def make(*args, **options):
        with patch("desim.kernel.network.LinkLayer", layer):
            return Network(*args, **options)

    return make
