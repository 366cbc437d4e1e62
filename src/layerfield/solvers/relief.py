"""Where light goes that its layer cannot hold: a small network on cells of 8x8 pixels."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import chain
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import (
    avg_pool2d,
    conv2d,
    interpolate,
    leaky_relu,
    max_pool2d,
    pad,
    relu,
)

from layerfield.kernels.cells import APART, BEYOND, CELL, LEAK, SIGNS, Network, relieve_, told
from layerfield.kernels.compiled import serve
from layerfield.kernels.gpu.serving import on_gpu
from layerfield.projection import sum_of


class Convolution(NamedTuple):
    """A hidden layer of the network; those of a display are told apart by what they hold alone.

    Args:
        own: 3x3 taps on what is known of a layer of the display.
        common: the same on the mean of all of them.
        bias: added to both.
    """

    own: Float[Tensor, "out in 3 3"]
    common: Float[Tensor, "out in 3 3"]
    bias: Float[Tensor, " out"]


@dataclass(frozen=True, eq=False)
class Relief:
    """A change of s = z + u between two steps, which those would take many more to find.

    Light of low frequencies can lie in one layer or another nearly without a difference to viewers.
    Bounds decide, and a step hands on by a few pixels what one pixel cannot hold. So for every
    cell, by how much its pixels may fall and rise and how far s goes beyond the bounds is told to a
    network, which answers how much light the layer takes from the others there:

        h = |[min z - low, high - max z, mean u+, mean u-, min u, max u]|   of a window, 0 to 1
        h <- its mean over the four windows of 8x8 pixels around a cell, see `signs`
        h_k <- g(own * h_k + common * mean_k h + bias)  g leaky; from the second on h_k is added
        d_k = last * (h_k - mean_k h),   s <- s + d, between the middles of cells linearly

    All of it together sees the same light: sum_k d_k = 0. The network knows nothing of the display
    nor of what is shown, so it serves any number of layers and any light. Logarithms have no low
    bound; the network is told of one, below which there is little to see (`told`).

    Args:
        hidden: all convolutions but the last.
        last: 3x3 taps.
    """

    hidden: Sequence[Convolution]
    last: Float[Tensor, "1 in 3 3"]

    @property
    def tensors(self) -> list[Tensor]:
        """All of them, one convolution after the other."""
        return [*chain.from_iterable(self.hidden), self.last]

    @cached_property
    def network(self) -> Network:
        """The same for compiled loops."""
        return Network.of(self.hidden, self.last)

    @classmethod
    def of(cls, tensors: Sequence[Tensor]) -> "Relief":
        """Return the network of such tensors."""
        *hidden, last = tensors
        count = len(Convolution._fields)
        starts = range(0, len(hidden), count)
        return cls([Convolution(*hidden[n : n + count]) for n in starts], last)

    def relieve_(
        self,
        shadow: Float[Tensor, "*batch layer c ty tx"],
        size: tuple[int, int],
        bounds: tuple[float, float],
        *,
        by_row: bool = False,
    ) -> Float[Tensor, "*batch layer c ty tx"]:
        """Return s with that change; compiled loops make it in place.

        Args:
            shadow: s, contiguous, on a torus; the layers are in its top left corner.
            size: height and width of the layers.
            bounds: of z; of logarithms the low one may be minus infinity, see `told`.
            by_row: every row is solved by itself, so it is a picture of its own.
        """
        bounds = told(bounds)
        if serve(shadow, *self.tensors):
            relieve_(shadow, size, bounds, self.network, by_row=by_row)
            return shadow
        hidden, last = _for(self, shadow.device, shadow.dtype)
        if on_gpu(shadow, last, *chain.from_iterable(hidden)):
            from layerfield.kernels.gpu.relief import relieve_ as relieve_on_gpu  # noqa: PLC0415  needs Triton

            planes = shadow.flatten(-3, -2).unsqueeze(-2) if by_row else shadow
            relieve_on_gpu(planes, (1, size[1]) if by_row else size, bounds, hidden, last)
            return shadow
        if by_row:
            rows = shadow[..., : size[0], :].flatten(-3, -2).unsqueeze(-2)  # as colours are
            made = self.relieve_(rows, (1, size[1]), bounds).unflatten(-3, (-1, size[0]))
            return torch.cat([made.squeeze(-2), shadow[..., size[0] :, :]], dim=-2)
        change = (bounds[1] - bounds[0]) * self.changes(signs(shadow, size, bounds))
        planes = change.reshape(-1, 1, *change.shape[-2:])
        wide = interpolate(planes, scale_factor=CELL, mode="bilinear")[..., : size[0], : size[1]]
        beside = (0, shadow.shape[-1] - size[1], 0, shadow.shape[-2] - size[0])
        return shadow + pad(wide, beside).reshape(shadow.shape)

    def changes(
        self, known: Float[Tensor, "*batch layer c sign cy cx"]
    ) -> Float[Tensor, "*batch layer c cy cx"]:
        """Return d of every cell.

        Args:
            known: what `signs` returns.
        """
        *batch, number, channels, _, height, width = known.shape
        seen = known.transpose(-5, -4).reshape(-1, number, SIGNS, height, width)
        hidden, last = _for(self, known.device, known.dtype)
        for n, part in enumerate(hidden):
            own = _of_layers(seen, part.own)
            common = _convolved(seen.mean(dim=1), part.common)
            made = own + (common + part.bias[:, None, None])[:, None]
            seen = leaky_relu(made, LEAK) + (seen if n else 0)
        answers = _of_layers(seen, last).reshape(*batch, channels, number, height, width)
        return (answers - answers.mean(dim=-3, keepdim=True)).transpose(-4, -3)


@lru_cache(maxsize=16)
def _for(
    relief: Relief, device: torch.device, dtype: torch.dtype
) -> tuple[list[Convolution], Tensor]:
    """Return its tensors where they are needed, brought there once."""
    hidden = [Convolution(*(each.to(device, dtype) for each in part)) for part in relief.hidden]
    return hidden, relief.last.to(device, dtype)


def signs(
    shadow: Float[Tensor, "*batch layer c ty tx"],
    size: tuple[int, int],
    bounds: tuple[float, float],
) -> Float[Tensor, "*batch layer c sign cy cx"]:
    """Return what is known of every cell, see `Relief`, in shares of the range of z.

    Mean of four windows, two pixels up or down and left or right of the cell: one alone answers
    otherwise wherever the picture lies otherwise, and layers flicker when a scene scrolls.

    Args:
        shadow: s, on a torus.
        size: height and width of the layers in its top left corner; beyond their edges it is as
            it is there.
        bounds: of z.
    """
    low, high = bounds
    planes = (shadow[..., : size[0], : size[1]].reshape(-1, 1, *size) - low) / (high - low)
    below, beside = (APART + -each % CELL for each in size)
    planes = pad(planes, (APART, beside, APART, below), mode="replicate")
    windows = [planes[..., y:, x:] for y in (0, 2 * APART) for x in (0, 2 * APART)]
    found = sum_of([_of_windows(each) for each in windows]) / len(windows)
    return found.reshape(*shadow.shape[:-2], *found.shape[1:])


def _of_windows(planes: Float[Tensor, "n 1 y x"]) -> Float[Tensor, "n sign cy cx"]:
    """Return what is known of windows that lie side by side, of values in shares of the range."""
    least, most = (sign * max_pool2d(sign * planes, CELL) for sign in (-1, 1))
    over, under = (avg_pool2d(relu(each), CELL) for each in (planes - 1, -planes))
    falls, rises = least.clamp(0, 1), 1 - most.clamp(0, 1)
    beyond = over, -under, least - falls, most - (1 - rises)
    return torch.cat([falls, rises, *(BEYOND * each for each in beyond)], dim=1)


def _of_layers(
    values: Float[Tensor, "picture layer in cy cx"], taps: Float[Tensor, "out in 3 3"]
) -> Float[Tensor, "picture layer out cy cx"]:
    return _convolved(values.flatten(0, 1), taps).unflatten(0, values.shape[:2])


def _convolved(values: Tensor, taps: Tensor) -> Tensor:
    return conv2d(pad(values, (1, 1, 1, 1), mode="replicate"), taps)
