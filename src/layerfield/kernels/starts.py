"""The balanced start of a solver, in one pass."""

import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.kernels.compiled import compiled


def shared_start(
    seen: Float[Tensor, "*batch layer c ly lx"],
    shares: Float[Tensor, "layer 1 ly lx"],
    rest: Float[Tensor, "*batch 1 c 1 1"],
    size: tuple[int, int],
) -> Float[Tensor, "*batch layer c ty tx"]:
    """Return shares of what is seen, on a torus whose other pixels are 0.

    Args:
        seen: of single precision, on a processor.
        shares: what to multiply it by; where that is 0
        rest: is taken.
        size: height and width of the torus, no smaller than the layers.
    """
    *batch, number, channels, height, width = seen.shape
    if size[0] < height or size[1] < width or shares.shape != (number, 1, height, width):
        found = f"shares {tuple(shares.shape)} and a torus {size}"
        raise ValueError(f"found {found}, expected {(number, 1, height, width)} and no smaller one")
    result = torch.empty(*batch, number, channels, *size)
    planes = (each.detach().contiguous().flatten(end_dim=-3) for each in (result, seen))
    made, known = (each.numpy() for each in planes)
    parts = shares.contiguous().view(number, height, width).numpy()
    others = rest.detach().expand(*batch, 1, channels, 1, 1).contiguous().view(-1, channels).numpy()
    count, numbers = len(made) * size[0], made.size
    _share.in_spans(made, known, parts, others, count=count, numbers=numbers)
    return result


@compiled
def _share(result, seen, shares, rest, begin, end):
    """Rows of all planes, one after the other, from and to."""
    rows, (number, height, width), channels = result.shape[1], shares.shape, rest.shape[1]
    for place in range(begin, end):
        plane, y = divmod(place, rows)
        row = result[plane, y]
        if y < height:
            item, channel = plane // (channels * number), plane % channels
            _set(
                row[:width],
                seen[plane, y],
                shares[plane // channels % number, y],
                rest[item, channel],
            )
            row[width:] = 0
        else:
            row[:] = 0


@compiled
def _set(row, seen, share, rest):
    for x in range(len(row)):
        row[x] = seen[x] * share[x] if share[x] > 0 else rest
