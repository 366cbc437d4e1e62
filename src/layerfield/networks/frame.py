"""A network at work on pictures of any size: margin, padding, tiles.

What a network sees outside the views: layers reach past the views by the display's margin, so views
are continued by the nearest pixel over the margin and on to a multiple of the network's stride,
about as far as in training; beyond that the convolutions see zeros. The margin of the layers is
what the network says there, and losses and figures use the exact crop.
"""

from collections.abc import Iterator

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import pad

from layerfield.networks.network import Network

_AT_ONCE = 512 * 512  # pixels of a tile's kept part; activations of a tile take about 1 GB


def pixels(
    network: Network, views: Float[Tensor, "batch view y x"], margin: tuple[int, int]
) -> Float[Tensor, "batch layer ly lx"]:
    """Return what a network says of whole pictures before the closing ReLU, margin included.

    Args:
        network: which.
        views: one colour channel.
        margin: pixels (y, x) by which layers exceed the views on each side.
    """
    wide = _continued(network, views, margin)
    height, width = (n + 2 * m for n, m in zip(views.shape[-2:], margin, strict=True))
    return network.pixels(wide)[..., :height, :width]


def tiled_pixels(
    network: Network,
    views: Float[Tensor, "batch view y x"],
    margin: tuple[int, int],
    at_once: int = _AT_ONCE,
) -> Float[Tensor, "batch layer ly lx"]:
    """Return the same as `pixels`, tile by tile, to bound the memory of large pictures.

    Tiles overlap by the network's reach and lie on multiples of its stride, so that they hold what
    the whole picture would, up to rounding.
    """
    wide = _continued(network, views, margin)
    result = wide.new_empty(len(wide), network.layers, *wide.shape[-2:])
    overlap = -(-network.reach // network.multiple) * network.multiple
    side = max(int(at_once**0.5) // network.multiple, 1) * network.multiple
    for (top, bottom), (left, right) in _tiles(wide.shape[-2], wide.shape[-1], side):
        above, before = max(top - overlap, 0), max(left - overlap, 0)
        seen = wide[..., above : bottom + overlap, before : right + overlap]
        made = network.pixels(seen)
        kept = made[..., top - above : bottom - above, left - before : right - before]
        result[..., top:bottom, left:right] = kept
    height, width = (n + 2 * m for n, m in zip(views.shape[-2:], margin, strict=True))
    return result[..., :height, :width]


def _continued(network: Network, views: Tensor, margin: tuple[int, int]) -> Tensor:
    """Continue views by the nearest pixel over the margin and on to whole strides."""
    (y, x), (height, width), stride = margin, views.shape[-2:], network.multiple
    more_y, more_x = _beyond(height, y, stride), _beyond(width, x, stride)
    wide = pad(views, (x, x + more_x, y, y + more_y), mode="replicate")
    return wide.contiguous(memory_format=torch.channels_last)


def _beyond(length: int, margin: int, stride: int) -> int:
    """Return how far to continue views behind the margin, to the right and below.

    At most a pixel less than around patches whose length is a whole number of strides, as those of
    training are. Behind come zeros, and a network has learned how far away those are: with no more
    than the next whole stride takes, 124 pixels ended 0.7 dB below what they do with eight more.
    """
    least = max(-2 * margin % stride - 1, 0)
    return least + -(length + 2 * margin + least) % stride


def _tiles(height: int, width: int, side: int) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
    for top in range(0, height, side):
        for left in range(0, width, side):
            yield (top, min(top + side, height)), (left, min(left + side, width))
