"""A deeper network that begins as a shallower one."""

import torch
from torch import nn

from layerfield.networks.network import Network


def modules(network: Network) -> int:
    """Return how many 3x3 convolutions with a ReLU a network has."""
    return sum(len(stack) // 2 for stack in _stacks(network).values())


def deepen(deep: Network, known: Network) -> bool:
    """Give a network the weights of one with fewer modules, so that both make the same layers.

    Modules that hand on what they get stand between the known ones: behind a ReLU nothing is below
    0, so that another ReLU leaves it as it is. A shallow network learns in a fraction of the time
    and is a far better start for a deep one than drawn weights.

    Args:
        deep: gets the weights, in place.
        known: a network of the same kind.

    Returns:
        Whether it could be done; if not, `deep` is as it was.

    Reference:
        Chen et al. 2016, "Net2Net: accelerating learning via knowledge transfer".
    """
    places = _places(deep, known)
    state, given = deep.state_dict(), known.state_dict()
    shapes = {key: state[place].shape for key, place in places.items() if place in state}
    if type(deep) is not type(known) or shapes != {key: v.shape for key, v in given.items()}:
        return False
    with torch.no_grad():
        for stack in _stacks(deep).values():
            for convolution in list(stack)[::2]:
                assert isinstance(convolution, nn.Conv2d)
                assert convolution.bias is not None
                nn.init.dirac_(convolution.weight)
                nn.init.zeros_(convolution.bias)
    deep.load_state_dict({places[key]: value for key, value in given.items()}, strict=False)
    return True


def _stacks(network: Network) -> dict[str, nn.Sequential]:
    """Return the stacks of convolutions of a network, by name."""
    return {n: m for n, m in network.named_modules() if isinstance(m, nn.Sequential)}


def _places(deep: Network, known: Network) -> dict[str, str]:
    """Return the name of a weight of the deep network for every one of the known network."""
    places = {key: key for key in known.state_dict()}
    more = _stacks(deep)
    for name, stack in _stacks(known).items():
        old, new = len(stack) // 2, len(more.get(name, stack)) // 2
        for n in range(old):
            for part in ("weight", "bias"):
                places[f"{name}.{2 * n}.{part}"] = f"{name}.{2 * (new * n // old)}.{part}"
    return places
