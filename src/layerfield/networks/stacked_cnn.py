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

    Attributes:
        depth: number of modules.

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
        self.depth = modules
        self.reach = modules + 1
        self.stack = convolutions(views, *[width] * modules)
        self.last = nn.Conv2d(width, layers, 3, padding=1)

    @property
    def kernels(self) -> list[nn.Conv2d]:
        """The convolutions of the modules, first to last."""
        return [module for module in self.stack if isinstance(module, nn.Conv2d)]

    def answer(self, seen: Float[Tensor, "batch view y x"]) -> Float[Tensor, "batch layer y x"]:
        return self.last(self.stack(seen))


def deepened(network: StackedCnn, modules: int) -> StackedCnn:
    """Return a network with more modules that gives the same layers.

    Modules that hand on what they get stand between the old ones: behind a ReLU nothing is below
    0, so that another ReLU leaves it as it is. A shallow stack learns in a fraction of the time
    and is a far better start for a deep one than drawn weights.

    Args:
        network: to be deepened.
        modules: how many the new one has, as many as the old one or more.

    Reference:
        Chen et al. 2016, "Net2Net: accelerating learning via knowledge transfer".
    """
    width = network.last.in_channels
    deep = StackedCnn(
        network.views, network.layers, width=width, modules=modules, densities=network.densities
    )
    for module in deep.kernels:
        assert module.bias is not None
        nn.init.dirac_(module.weight)
        nn.init.zeros_(module.bias)
    for n, module in enumerate(network.kernels):
        deep.kernels[modules * n // network.depth].load_state_dict(module.state_dict())
    deep.last.load_state_dict(network.last.state_dict())
    return deep
