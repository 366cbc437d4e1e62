"""What the networks have in common: views in, pixel values out, a ReLU at the end."""

import math
from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor, nn

_DARKEST = 1 / 128  # the value that has density 1; densities of darker ones are no higher


class Network(nn.Module):
    """A network from the views of one colour channel to the layers of one display.

    Args:
        views: number of views, the channels that go in.
        layers: number of layers, the channels that come out.
        densities: what goes in and what comes out are optical densities D = log V / log V_min of
            the values V. Where layers multiply, densities add: the network has the same to learn
            as for layers that add, and the ReLU at its end lets no layer exceed 1.

    Attributes:
        multiple: height and width of what goes in must be multiples of this.
        reach: no pixel depends on what is farther away than this, in pixels.
    """

    multiple: int = 1
    reach: int = 0
    last: nn.Conv2d

    def __init__(self, views: int, layers: int, *, densities: bool = False) -> None:
        super().__init__()
        self.views = views
        self.layers = layers
        self.densities = densities

    def answer(self, seen: Float[Tensor, "batch view y x"]) -> Float[Tensor, "batch layer y x"]:
        """Return what the convolutions make of views, values or densities, without closing ReLU."""
        raise NotImplementedError

    def seen(self, values: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
        """Return values as the convolutions take them."""
        return density(values) if self.densities else values

    def pixels(self, views: Float[Tensor, "batch view y x"]) -> Float[Tensor, "batch layer y x"]:
        """Return pixel values before the closing ReLU; the regulariser sees those."""
        answer = self.answer(self.seen(views))
        return (answer * math.log(_DARKEST)).exp() if self.densities else answer

    def forward(self, views: Float[Tensor, "batch view y x"]) -> Float[Tensor, "batch layer y x"]:
        """Return layers, at least 0; values above 1 are clamped at synthesis."""
        return self.pixels(views).relu()


def density(values: Tensor) -> Tensor:
    """Return the optical densities of values: 0 for white, 1 for 1/128 and for what is darker."""
    return values.clamp(min=_DARKEST).log() / math.log(_DARKEST)


def convolutions(*channels: int) -> nn.Sequential:
    """Return 3x3 convolutions, each followed by a ReLU, through these numbers of channels."""
    steps: list[nn.Module] = []
    for fan_in, fan_out in pairwise(channels):
        steps += [nn.Conv2d(fan_in, fan_out, 3, padding=1), nn.ReLU()]
    return nn.Sequential(*steps)


def initialise(network: Network, generator: torch.Generator) -> None:
    """Draw all weights uniformly within +-sqrt(6 / fan in), for ReLU; biases are 0.

    An output pixel of an up-convolution (stride = kernel) sees one pixel of its input.

    Reference:
        He et al. 2015, "Delving deep into rectifiers", equation 10.
    """
    for module in network.modules():
        if isinstance(module, nn.Conv2d | nn.ConvTranspose2d):
            area = 1 if isinstance(module, nn.ConvTranspose2d) else math.prod(module.kernel_size)
            bound = math.sqrt(6 / (module.in_channels * area))
            assert module.bias is not None
            with torch.no_grad():
                module.weight.uniform_(-bound, bound, generator=generator)
                module.bias.zero_()


def hand_on(network: Network, share: float = 0.2) -> None:
    """Make every 3x3 convolution but the last the identity plus a share of what was drawn.

    A deep stack without skips hands on little of its input as it is drawn, and learns slowly.
    Values are at least 0 behind a ReLU, so what is handed on passes all of them.
    """
    for module in network.modules():
        if isinstance(module, nn.Conv2d) and module is not network.last:
            with torch.no_grad():
                module.weight *= share
                for channel in range(min(module.in_channels, module.out_channels)):
                    module.weight[channel, channel, 1, 1] += 1


def dead_layers(
    network: Network, views: Float[Tensor, "batch view y x"], share: float = 0.01
) -> list[int]:
    """Return the layers of which less than a share of the pixels is above 0: they cannot learn."""
    with torch.no_grad():
        alive = (network.answer(network.seen(views)) > 0).float().mean(dim=(0, 2, 3))
    return [k for k, found in enumerate(alive.tolist()) if found < share]


def reseed(network: Network, layers: list[int], generator: torch.Generator) -> None:
    """Draw the output channels of these layers anew."""
    bound = math.sqrt(6 / (network.last.in_channels * math.prod(network.last.kernel_size)))
    assert network.last.bias is not None
    with torch.no_grad():
        for k in layers:
            network.last.weight[k].uniform_(-bound, bound, generator=generator)
            network.last.bias[k] = 0


def level(network: Network, views: Float[Tensor, "batch view y x"], target: float) -> None:
    """Scale every output channel so that its mean on these views is the target, a pixel value.

    A channel whose mean is negative changes its sign: the weights stay as uniform as they were.
    """
    assert network.last.bias is not None
    with torch.no_grad():
        target = network.seen(torch.tensor(target)).item()
        mean = network.answer(network.seen(views)).mean(dim=(0, 2, 3))
        network.last.weight *= (target / mean)[:, None, None, None]
        network.last.bias *= target / mean
