"""What training minimises: how far layers are from showing the views, and pixel values at bay."""

import math

import torch
from jaxtyping import Float
from torch import Tensor, nn

from layerfield.display import Display
from layerfield.networks import Network
from layerfield.networks.frame import pixels
from layerfield.training.recipe import Loss

_FLOOR = 1e-6  # of mean square errors under the logarithm, 60 dB


class Objective(nn.Module):
    """The loss of a batch.

    E = ||link_k (A relu(P))_k - L||^2 / n + weight * R(P), P = network(L)

    With `clamped`, min(relu(P), 1) stands for relu(P), as at synthesis: what is above 1 shows
    nothing more, and only R brings it back. R is the mean of relu(P - 1)^2 + relu(-P)^2 (`range`)
    or of P^2 (`energy`). P is what the network says before its closing ReLU: behind it relu(-P)
    would be nothing, and a layer that is dark everywhere would get no gradient and stay dark for
    good. Views are not clipped.

    Args:
        network: to be trained.
        display: that shows its layers.
        loss: error, regulariser and weight.

    Reference:
        Gao et al. 2024, section 3, item 6.
    """

    def __init__(self, network: Network, display: Display, loss: Loss) -> None:
        super().__init__()
        self.network = network
        self.display = display
        self.error = _ERRORS[loss.error]
        self.regulariser = _REGULARISERS[loss.regulariser]
        self.weight = loss.weight
        self.most = 1.0 if loss.clamped else math.inf

    def forward(self, views: Float[Tensor, "batch view y x"]) -> Float[Tensor, ""]:
        """Return the loss of a batch of samples, one colour channel each, as light."""
        light = self.display.transfer.decode(views)
        values = pixels(self.network, light, self.display.margin).float()
        shown = shown_by(self.display, values.relu().clamp(max=self.most))
        squares = (shown - light).square().mean(dim=(1, 2, 3))
        return self.error(squares) + self.weight * self.regulariser(values)


def shown_by(
    display: Display, layers: Float[Tensor, "batch layer ly lx"]
) -> Float[Tensor, "batch view y x"]:
    """Return the unclipped views of one colour channel that layers show."""
    return display(layers[:, None, :, None])[:, :, 0]


def range_penalty(values: Float[Tensor, "batch layer y x"]) -> Float[Tensor, ""]:
    """Return the mean of relu(P - 1)^2 + relu(-P)^2.

    >>> range_penalty(torch.tensor([[[[0.5, 3.0, -1.0, 1.0]]]]))
    tensor(1.2500)
    """
    return ((values - 1).relu().square() + (-values).relu().square()).mean()


def energy_penalty(values: Float[Tensor, "batch layer y x"]) -> Float[Tensor, ""]:
    """Return the mean of P^2."""
    return values.square().mean()


def log_error(squares: Float[Tensor, "batch"]) -> Float[Tensor, ""]:
    """Return the mean logarithm of mean square errors, PSNR up to sign and factor."""
    return (squares + _FLOOR).log().mean()


_REGULARISERS = {"range": range_penalty, "energy": energy_penalty}
_ERRORS = {"mean": torch.mean, "log": log_error}
