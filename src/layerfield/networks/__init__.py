"""Networks that make layers from views: pure modules, as published; one file each, one line here.

A network takes the views of one colour channel, `[batch, view, y, x]`, and returns layers of the
same size. `frame` puts it to work on pictures of any size.
"""

from collections.abc import Callable

from layerfield.networks.deepening import deepen, modules
from layerfield.networks.network import Network
from layerfield.networks.stacked_cnn import StackedCnn
from layerfield.networks.unet import UNet

NETWORKS: dict[str, Callable[..., Network]] = {"stacked-cnn": StackedCnn, "unet": UNet}

__all__ = ["NETWORKS", "Network", "StackedCnn", "UNet", "deepen", "modules"]
