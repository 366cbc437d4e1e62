"""The normal equations of cropped views, solved and applied in the Fourier domain.

On a torus the Gram matrix of A is one small matrix per frequency, G(f). Views are cropped, so what
counts is A^T M A with a mask M; the difference is a band around the views:

    A^T M A = G - A^T (1 - M) A

and only the band has to be recomputed when layers change.
"""

from collections.abc import Sequence
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.band import ANY, Bounds, band_of
from layerfield.frequencies import Spectral, interleaved, multiply
from layerfield.kernels.compiled import serve
from layerfield.kernels.gpu.serving import on_gpu
from layerfield.kernels.strips import Sides, Strips, strips_of
from layerfield.lengths import fast_length, fast_on_gpu, fast_width
from layerfield.projection import Projection


def spectral_of(
    projection: Projection, weights: Sequence[float], torus: tuple[int, int], like: Tensor
) -> Spectral:
    """Return G(f) of a torus with its resolvents, in the precision and on the device of `like`."""
    by_row = projection.is_horizontal
    symbol = projection.symbol((1, torus[1]) if by_row else torus, weights)
    dtype = like.dtype.to_complex() if symbol.is_complex() else like.dtype
    return Spectral(symbol.to(like.device, dtype), torus, sum(weights), by_row)


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
        self.projection, self.view_size = projection, view_size
        self.weights = weights
        (height, width), (my, mx) = view_size, projection.margin
        self.layer_size = (height + 2 * my, width + 2 * mx)
        rows, columns = self.layer_size
        on_processor = like.device.type == "cpu"
        tall, wide = (fast_length, fast_width) if on_processor else (fast_on_gpu, fast_on_gpu)
        if projection.is_horizontal:  # rows whose ends see each other converge more slowly
            both_ends = 2 * (2 * mx)  # G reaches twice as far as a view
            self.torus = (rows, wide(columns + both_ends))
        else:
            self.torus = (tall(rows), wide(columns))
        self._like = like
        self._band = band_of(projection, weights, view_size, self.torus)

    @cached_property
    def spectral(self) -> Spectral:
        """G(f) and its resolvents."""
        return spectral_of(self.projection, self.weights, self.torus, self._like)

    def to_torus(self, layers: Float[Tensor, "*batch ly lx"]) -> Float[Tensor, "*batch ty tx"]:
        """Pad layers with zeros to the torus."""
        (ly, lx), (ty, tx) = self.layer_size, self.torus
        return torch.nn.functional.pad(layers, (0, tx - lx, 0, ty - ly))

    def from_torus(self, layers: Float[Tensor, "*batch ty tx"]) -> Float[Tensor, "*batch ly lx"]:
        """Cut the layers proper out of the torus."""
        return layers[..., : self.layer_size[0], : self.layer_size[1]]

    def clamped_from_torus(
        self, layers: Float[Tensor, "*batch ty tx"], bounds: Bounds
    ) -> Float[Tensor, "*batch ly lx"]:
        """Return the layers proper, clamped."""
        if on_gpu(layers):
            from layerfield.kernels.gpu.blends import cut  # noqa: PLC0415  needs Triton

            return cut(layers, self.layer_size, bounds)
        return self.from_torus(layers).clamp(*bounds)

    def band(
        self, layers: Float[Tensor, "*batch layer c ty tx"]
    ) -> Float[Tensor, "*batch layer c ty tx"]:
        """Return A^T (1 - M) W A layers: what layers contribute around the views."""
        result = torch.zeros_like(layers)
        self.add_band_(result, layers)
        return result

    def add_band_(
        self, result: Tensor, layers: Tensor, factor: float = 1.0, bounds: Bounds = ANY
    ) -> None:
        """Add a multiple of the band of `layers`, clamped, at the cost of the band alone."""
        if on_gpu(result, layers) and type(self.projection) is Projection:
            from layerfield.kernels.gpu.bands import add_band_  # noqa: PLC0415  needs Triton

            given = self.projection, self.weights, self.view_size
            add_band_(result, layers, factor, bounds, *given)
        else:
            self._band.add_(result, layers, factor, bounds)

    def strips(self, layers: Tensor, bounds: Bounds) -> Strips | None:
        """Return the band of layers, clamped, for compiled loops to add, or None."""
        if self.sides is None or not serve(layers):
            return None
        return strips_of(layers, self.sides, bounds)

    @property
    def sides(self) -> Sides | None:
        """What compiled loops find the band with, or None where they do not serve."""
        return self._band.sides

    def __call__(
        self, layers: Float[Tensor, "*batch layer c ty tx"]
    ) -> Float[Tensor, "*batch layer c ty tx"]:
        """Return A^T M W A layers."""
        spectral = self.spectral
        spectrum = multiply(interleaved(spectral.symbol), spectral.to_frequencies(layers))
        return spectral.to_pixels(spectrum) - self.band(layers)
