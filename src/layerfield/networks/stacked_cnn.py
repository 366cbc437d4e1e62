"""The stacked CNN that the paper compares with."""

from jaxtyping import Float
from torch import Tensor, nn

from layerfield.networks.network import Network, convolutions


class StackedCnn(Network):
    """Modules of one 3x3 convolution and a ReLU, one after the other, and an output layer.

    Args:
        views: number of views.
        layers: number of layers.
        width: channels of every module.
        modules: how many.
        densities: see `Network`.

    Reference:
        Gao et al. 2024, section 3, after Maruyama et al. (the paper's reference 4).
    """

    def __init__(
        self,
        views: int,
        layers: int,
        *,
        width: int = 64,
        modules: int = 19,
        densities: bool = False,
    ) -> None:
        super().__init__(views, layers, densities=densities)
        self.reach = modules + 1
        self.stack = convolutions(views, *[width] * modules)
        self.last = nn.Conv2d(width, layers, 3, padding=1)

    def answer(self, seen: Float[Tensor, "batch view y x"]) -> Float[Tensor, "batch layer y x"]:
        return self.last(self.stack(seen))
