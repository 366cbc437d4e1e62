"""The normal equations of cropped views, solved and applied in the Fourier domain.

On a torus the Gram matrix of A is one small matrix per frequency, G(f). Views are cropped, so what
counts is A^T M A with a mask M; the difference is a band around the views:

    A^T M A = G - A^T (1 - M) A

and only the band has to be recomputed when layers change.
"""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.projection import Projection


def fast_length(least: int) -> int:
    """Return the smallest even number without prime factors over 5 that is at least `least`.

    >>> fast_length(404)
    432
    """
    length = least + least % 2
    while not _is_smooth(length):
        length += 2
    return length


def _is_smooth(number: int) -> bool:
    for prime in (2, 3, 5):
        while number % prime == 0:
            number //= prime
    return number == 1


class Gram:
    """A^T M W A for views of one size, on a torus with fast Fourier lengths.

    Layers live on the torus here: `[..., layer, c, *torus]`, the layer proper in its top left
    corner, the rest without influence on any view.

    Args:
        projection: A.
        weights: one weight for every view (W).
        view_size: height and width of the views.
        like: a tensor whose device and precision are used.
    """

    def __init__(
        self,
        projection: Projection,
        weights: Sequence[float],
        view_size: tuple[int, int],
        like: Tensor,
    ) -> None:
        self.projection = projection
        self.weights = weights
        (height, width), (my, mx) = view_size, projection.margin
        self.layer_size = (height + 2 * my, width + 2 * mx)
        self.torus = (fast_length(self.layer_size[0]), fast_length(self.layer_size[1]))
        symbol = projection.symbol(self.torus, weights)
        self.symbol = symbol.to(like.device, _matching(symbol, like))
        rows, columns = (_wrapped(n, like.device) for n in self.torus)
        # Two strips make up the band: all columns below and above the views, then what is left
        # and right of them. Each holds the layer pixels its view pixels look at.
        strips = [
            (rows(height, self.torus[0] + 2 * my), columns(0, self.torus[1] + 2 * mx)),
            (rows(0, height + 2 * my), columns(width, self.torus[1] + 2 * mx)),
        ]
        self.strips = [(y, x) for y, x in strips if len(y) > 2 * my and len(x) > 2 * mx]

    def to_torus(self, layers: Float[Tensor, "*batch ly lx"]) -> Float[Tensor, "*batch ty tx"]:
        """Pad layers with zeros to the torus."""
        (ly, lx), (ty, tx) = self.layer_size, self.torus
        return torch.nn.functional.pad(layers, (0, tx - lx, 0, ty - ly))

    def from_torus(self, layers: Float[Tensor, "*batch ty tx"]) -> Float[Tensor, "*batch ly lx"]:
        """Cut the layers proper out of the torus."""
        return layers[..., : self.layer_size[0], : self.layer_size[1]]

    def band(
        self, layers: Float[Tensor, "*batch layer c ty tx"]
    ) -> Float[Tensor, "*batch layer c ty tx"]:
        """Return A^T (1 - M) W A layers: what layers contribute around the views."""
        result = torch.zeros_like(layers)
        self.add_band_(result, layers)
        return result

    def add_band_(self, result: Tensor, layers: Tensor) -> None:
        """Add the band of `layers` to `result`, in place, at the cost of the band alone."""
        for rows, columns in self.strips:
            seen = self.projection.forward(layers[..., rows[:, None], columns])
            part = self.projection.adjoint(seen, self.weights)
            # A strip may hold a row or column of the torus twice: accumulate, one axis at a time.
            full_rows = part.new_zeros(*part.shape[:-1], self.torus[1])
            result.index_add_(-2, rows, full_rows.index_add_(-1, columns, part))

    def __call__(
        self, layers: Float[Tensor, "*batch layer c ty tx"]
    ) -> Float[Tensor, "*batch layer c ty tx"]:
        """Return A^T M W A layers."""
        spectrum = multiply(self.symbol, torch.fft.rfft2(layers))
        return torch.fft.irfft2(spectrum, s=self.torus) - self.band(layers)


def multiply(matrix: Float[Tensor, "layer layer fy fx"], spectrum: Tensor) -> Tensor:
    """Multiply every frequency of `[..., layer, c, fy, fx]` by its layer x layer matrix."""
    rows = []
    for row in matrix:
        total = row[0] * spectrum[..., 0, :, :, :]
        for k in range(1, len(row)):
            total.addcmul_(row[k].to(total.dtype), spectrum[..., k, :, :, :])
        rows.append(total)
    return torch.stack(rows, dim=-4)


def inverse(matrix: Float[Tensor, "layer layer fy fx"]) -> Float[Tensor, "layer layer fy fx"]:
    """Invert the positive definite matrix of every frequency, by Gauss-Jordan elimination.

    All frequencies go together; the few steps over layers cost less than a batched library call.
    """
    left = matrix.clone()
    right = torch.zeros_like(matrix)
    for k in range(len(matrix)):
        right[k, k] = 1
    for k in range(len(matrix)):
        pivot = left[k, k].clone()
        left[k] /= pivot
        right[k] /= pivot
        for row in range(len(matrix)):
            if row != k:
                factor = left[row, k].clone()
                left[row] -= factor * left[k]
                right[row] -= factor * right[k]
    return right


def _matching(symbol: Tensor, like: Tensor) -> torch.dtype:
    return like.dtype.to_complex() if symbol.is_complex() else like.dtype


def _wrapped(length: int, device: torch.device):
    def indices(start: int, stop: int) -> Tensor:
        return torch.arange(start, stop, device=device) % length

    return indices
