"""The U-Net of the paper."""

from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor, nn

from layerfield.networks.network import Network, convolutions


class UNet(Network):
    """Views down through pooled levels and up again, levels of one size connected.

        width -> 2 width -> ... -> 2^depth width -> ... -> 2 width -> width -> layers

    Every level has two 3x3 convolutions on the way down and two on the way up, each followed by a
    ReLU; 2x2 maximum pooling down, 2x2 up-convolution up, a 1x1 convolution and a ReLU at the end.

    Args:
        views: number of views.
        layers: number of layers.
        width: channels after the input module; doubled after every pooling.
        depth: number of poolings. The paper does not state it; 3 gives 7.7 million parameters.
        skips: connect the levels; without, for ablations, the way up sees only what is below.
        first: convolutions of the level at full resolution on the way down, and as many on the
            way up. More than the paper's 2 help on fine textures.
        densities: see `Network`.

    Reference:
        Gao et al. 2024, section 3 and figure 2; Ronneberger et al. 2015.
    """

    def __init__(
        self,
        views: int,
        layers: int,
        *,
        width: int = 64,
        depth: int = 3,
        skips: bool = True,
        first: int = 2,
        densities: bool = False,
    ) -> None:
        super().__init__(views, layers, densities=densities)
        self.multiple = 2**depth
        # Level l adds 2^l in pooling, 4 * 2^l below, 2^l on the way up, 2 * 2^l in merging.
        self.reach = 2 * (first - 1) + 8 * (2**depth - 1)
        self.skips = skips
        channels = [width * 2**level for level in range(depth + 1)]
        pairs = list(pairwise(channels))
        self.entry = convolutions(views, *[width] * first)
        self.pool = nn.MaxPool2d(2)
        self.down = nn.ModuleList(convolutions(low, high, high) for low, high in pairs)
        self.up = nn.ModuleList(
            nn.ConvTranspose2d(high, low, 2, stride=2) for low, high in reversed(pairs)
        )
        self.merge = nn.ModuleList(
            convolutions(2 * low if skips else low, *[low] * (2 if level else first))
            for level, (low, _) in reversed(list(enumerate(pairs)))
        )
        self.last = nn.Conv2d(width, layers, 1)

    def answer(self, seen: Float[Tensor, "batch view y x"]) -> Float[Tensor, "batch layer y x"]:
        level = self.entry(seen)
        passed = []
        for down in self.down:
            passed.append(level)
            level = down(self.pool(level))
        for up, merge in zip(self.up, self.merge, strict=True):
            level, beside = up(level), passed.pop()
            level = merge(torch.cat([beside, level], dim=1) if self.skips else level)
        return self.last(level)
