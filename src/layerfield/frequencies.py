"""Small matrices, one for every frequency: multiplied, inverted, and those of low frequencies.

Views without borders make the Gram matrix of layers one such matrix, layer by layer.
"""

from functools import cached_property
from typing import Any

import torch
from jaxtyping import Complex, Float, Inexact
from torch import Tensor

_MOST_KEPT = 1 << 31  # bytes of the resolvents of a display: those of `fast` up to 8 megapixels
_LARGE = 1 << 14  # frequencies of a plane from which on it is transformed by itself,
_LARGEST = 1 << 21  # and as one of half as many complex pixels

Matrix = tuple[tuple[Tensor, ...], ...]
"""Entries as `multiply` takes them: one small matrix for every frequency; see `interleaved`."""


class Spectral:
    """The Gram matrix of every frequency of a torus, and its resolvents.

    Args:
        symbol: G(f).
        torus: height and width.
        weight: of all views together.
        by_row: rows of pixels do not know of each other. Each is transformed by itself, and a
            single row of frequencies says all.
        pixels: of the picture that one of this torus stands for; see `coarser`.
    """

    def __init__(
        self,
        symbol: Inexact[Tensor, "layer layer fy fx"],
        torus: tuple[int, int],
        weight: float,
        by_row: bool,
        pixels: int = 1,
    ) -> None:
        self.symbol, self.torus, self.weight = symbol, torus, weight
        self.by_row, self.pixels = by_row, pixels
        self._kept: dict[tuple[float, ...], Matrix] = {}
        self._coarser: dict[int, Spectral] = {}

    def to_frequencies(
        self, planes: Float[Tensor, "*batch c ty tx"]
    ) -> Complex[Tensor, "*batch c fy fx"]:
        """Return the spectrum of planes: of both directions, or of every row."""
        return torch.fft.rfft(planes) if self.by_row else torch.fft.rfft2(planes)

    def to_pixels(
        self, spectrum: Complex[Tensor, "*batch c fy fx"]
    ) -> Float[Tensor, "*batch c ty tx"]:
        """Return the planes of a spectrum."""
        if self.by_row:
            return torch.fft.irfft(spectrum, n=self.torus[1])
        return to_pixels(spectrum, self.torus)

    def resolvent(self, penalty: float, balance: float, gain: float = 1.0) -> Matrix:
        """Return g rho (G + rho I)^-1 for `multiply`, rho = penalty times the weight of all views.

        Computed once for a penalty: it depends on the display alone.

        Args:
            penalty: share of the weight.
            balance: share of it, too: of b (I - 1/K), which is added to G at frequency zero; not
                of rows by themselves, whose light is where their own bounds want it.
            gain: g.
        """
        key = (penalty, balance, gain)
        if key not in self._kept:
            found = resolvent(self, penalty, balance, gain)
            if sum(map(_size, self._kept.values())) + _size(found) > _MOST_KEPT:
                self._kept.clear()
            self._kept[key] = found
        return self._kept[key]

    def coarser(self, times: int) -> "Spectral":
        """Return the same display seen with so-many times larger pixels: its low frequencies.

        Rows that do not know of each other stay apart: their pixels grow wider alone.
        """
        if times not in self._coarser:
            height, width = self.torus
            torus = (height if self.by_row else height // times, width // times)
            pixels = times if self.by_row else times**2
            symbol = low(self.symbol, torus, self.by_row)
            self._coarser[times] = Spectral(symbol, torus, self.weight, self.by_row, pixels)
        return self._coarser[times]

    @cached_property
    def window(self) -> Float[Tensor, "fy fx"]:
        """1 at frequency zero, falling to 0 at the highest along each axis: cos^2(pi f).

        Pixels are too coarse for what is clamped on them: sharp edges fall between them and turn up
        at other frequencies, the more so the nearer to the highest, and otherwise where the picture
        lies otherwise. With this window layers move as the picture does.
        """
        width, like = self.torus[1], self.symbol.real
        fy, fx = torch.fft.fftfreq(like.shape[-2]), torch.fft.rfftfreq(width)
        along_y, along_x = (torch.cos(torch.pi * f).square().to(like) for f in (fy, fx))
        return along_y[:, None] * along_x


def resolvent(spectral: Spectral, penalty: float, balance: float, gain: float = 1.0) -> Matrix:
    """Return what `Spectral.resolvent` keeps."""
    rho, matrix = penalty * spectral.weight, spectral.symbol.clone()
    identity = torch.eye(len(matrix), dtype=matrix.dtype, device=matrix.device)
    matrix += rho * identity[:, :, None, None]
    if not spectral.by_row:
        matrix[:, :, 0, 0] += balance * spectral.weight * (identity - 1 / len(matrix))
    return interleaved(gain * rho * inverse(matrix))


def low(
    spectrum: Inexact[Tensor, "*batch fy fx"], torus: tuple[int, int], by_row: bool = False
) -> Inexact[Tensor, "*batch gy gx"]:
    """Return the low frequencies of a spectrum, as those of a smaller torus; its highest are 0.

    Args:
        spectrum: as of `rfft2`, or of `rfft`.
        torus: the smaller one.
        by_row: whether there is a spectrum for every row.
    """
    rows, columns = spectrum.shape[-2] if by_row else torus[0], torus[1] // 2 + 1
    result = spectrum.new_zeros(*spectrum.shape[:-2], rows, columns)
    for here, there in _low_blocks(spectrum, torus, by_row):
        result[there] = spectrum[here]
    return result


def low_part(
    spectrum: Complex[Tensor, "*batch fy fx"], coarser: Spectral
) -> Complex[Tensor, "*batch gy gx"]:
    """Return the share of a spectrum that is solved on larger pixels: the window of its lowest."""
    return low(spectrum, coarser.torus, coarser.by_row) * coarser.window


def replace_low_part_(
    spectrum: Complex[Tensor, "*batch fy fx"],
    other: Complex[Tensor, "*batch gy gx"],
    coarser: Spectral,
) -> None:
    """Put another in the place of the `low_part` of a spectrum, in place."""
    rest = 1 - coarser.window
    for here, there in _low_blocks(spectrum, coarser.torus, coarser.by_row):
        spectrum[here].mul_(rest[there]).add_(other[there])


def _low_blocks(
    spectrum: Tensor, torus: tuple[int, int], by_row: bool
) -> list[tuple[tuple[Any, ...], tuple[Any, ...]]]:
    """Return where low frequencies are: in a spectrum, and in that of a smaller torus.

    All are below the highest frequency of the smaller one: rows from frequency zero up, and rows
    below it.
    """
    height, across = torus[0], slice((torus[1] - 1) // 2 + 1)
    if by_row:
        return [((..., across), (..., across))]
    down = (height - 1) // 2
    up, below = slice(down + 1), slice(spectrum.shape[-2] - down, None)
    return [
        ((..., up, across), (..., up, across)),
        ((..., below, across), (..., slice(height - down, None), across)),
    ]


def to_pixels(
    spectrum: Complex[Tensor, "*batch c fy fx"], torus: tuple[int, int]
) -> Float[Tensor, "*batch c ty tx"]:
    """Return the planes that `rfft2` makes this spectrum of.

    On a processor large planes go one after the other: what is between the transforms along both
    directions stays in its cache, which takes an eighth to a fifth less time. The largest do not
    fit there; see `_in_pairs`.
    """
    frequencies = spectrum.shape[-2:].numel()
    if spectrum.device.type != "cpu" or spectrum.requires_grad or frequencies < _LARGE:
        return torch.fft.irfft2(spectrum, s=torus)
    result = torch.empty(*spectrum.shape[:-2], *torus, dtype=spectrum.real.dtype)
    in_pairs = frequencies >= _LARGEST and torus[1] % 2 == 0
    planes = result.flatten(end_dim=-3)
    for plane, each in zip(planes, spectrum.flatten(end_dim=-3), strict=True):
        if in_pairs:
            torch.fft.ifft2(_in_pairs(each, torus[1]), out=_paired(plane))
        else:
            torch.fft.irfft2(each, s=torus, out=plane)
    return result


def _in_pairs(spectrum: Complex[Tensor, "fy fx"], width: int) -> Complex[Tensor, "fy half"]:
    """Return the spectrum of a plane whose neighbours along x are taken for one complex pixel.

    With E and O, the spectra of even and odd columns, it is

        E + i O = a X(f) + (1 - a) conj X(-fy, width / 2 - fx)
        a = (1 + i exp(2 pi i fx / width)) / 2

    PyTorch's complex transform does both directions at once, its real one direction by direction,
    which where planes fit into no cache takes twice the time of all this.
    """
    angle = torch.arange(width // 2, dtype=torch.float64) * (2 * torch.pi / width)
    a = ((1 + 1j * torch.exp(1j * angle)) / 2).to(spectrum)
    opposite = spectrum[:, 1:].flip((-2, -1)).conj_physical_()  # row n is that of -1 - n
    result = torch.empty_like(opposite)
    torch.lerp(opposite[-1], spectrum[0, :-1], a, out=result[0])
    torch.lerp(opposite[:-1], spectrum[1:, :-1], a, out=result[1:])
    return result


def _paired(plane: Float[Tensor, "ty tx"]) -> Complex[Tensor, "ty half"]:
    return torch.view_as_complex(plane.unflatten(-1, (-1, 2)))


def _size(matrix: Matrix) -> int:
    entries = {id(entry): entry for row in matrix for entry in row}
    return sum(entry.numel() * entry.element_size() for entry in entries.values())


def interleaved(matrix: Inexact[Tensor, "layer layer fy fx"]) -> Matrix:
    """Prepare a Hermitian matrix for `multiply`.

    A real one acts on real and imaginary parts alike; with every entry twice, it fits a spectrum
    whose real and imaginary parts lie side by side in one long real row. It is symmetric, and keeps
    the entries above its diagonal once.
    """
    if matrix.is_complex():
        return tuple(tuple(row.unbind()) for row in matrix)
    count = range(len(matrix))
    upper = {(k, m): matrix[k, m].repeat_interleave(2, dim=-1) for k in count for m in count[k:]}
    return tuple(tuple(upper[min(k, m), max(k, m)] for m in count) for k in count)


def multiply(
    matrix: Matrix, spectrum: Complex[Tensor, "*batch layer c fy fx"]
) -> Complex[Tensor, "*batch layer c fy fx"]:
    """Multiply every frequency of a spectrum by its layer x layer matrix, once `interleaved`."""
    if matrix[0][0].is_complex():
        return _multiply(matrix, spectrum)
    product = _multiply(matrix, torch.view_as_real(spectrum).flatten(-2))
    return torch.view_as_complex(product.unflatten(-1, (-1, 2)))


def _multiply(matrix: Matrix, spectrum: Tensor) -> Tensor:
    product = torch.empty_like(spectrum)
    planes = spectrum.unbind(dim=-4)
    for row, total in zip(matrix, product.unbind(dim=-4), strict=True):
        torch.mul(row[0], planes[0], out=total)
        for entry, plane in zip(row[1:], planes[1:], strict=True):
            total.addcmul_(entry, plane)
    return product


def inverse(matrix: Inexact[Tensor, "layer layer fy fx"]) -> Inexact[Tensor, "layer layer fy fx"]:
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
