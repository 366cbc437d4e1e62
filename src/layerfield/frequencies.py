"""Small matrices, one for every frequency: multiplied, inverted, and those of low frequencies.

Views without borders make the Gram matrix of layers one such matrix, layer by layer.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import torch
from jaxtyping import Complex, Float, Inexact
from torch import Tensor

from layerfield.kernels.blends import Blend
from layerfield.kernels.compiled import serve
from layerfield.kernels.gpu.serving import on_gpu
from layerfield.kernels.inverses import Terms
from layerfield.kernels.spectra import LowPart, Pairs
from layerfield.kernels.symbols import Symbol, symbol_of
from layerfield.kernels.systems import System, system_of
from layerfield.kernels.three_passes import LowApart, solved_in_three_passes
from layerfield.lengths import fast_length, fast_width

_MOST_KEPT = 1 << 31  # bytes of the resolvents of a display: those of `fast` up to 8 megapixels

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
        pixels: float = 1,
    ) -> None:
        self.symbol, self.torus, self.weight = symbol, torus, weight
        self.by_row, self.pixels = by_row, pixels
        self._kept: dict[tuple[Any, ...], Matrix | Tensor] = {}
        self._coarser: dict[int, Spectral] = {}

    def to_frequencies(
        self, planes: Float[Tensor, "*batch c ty tx"]
    ) -> Complex[Tensor, "*batch c fy fx"]:
        """Return the spectrum of planes: of both directions, or of every row."""
        return torch.fft.rfft(planes) if self.by_row else torch.fft.rfft2(planes)

    def to_pixels(
        self, spectrum: Complex[Tensor, "*batch c fy fx"], norm: str = "backward"
    ) -> Float[Tensor, "*batch c ty tx"]:
        """Return the planes of a spectrum; a norm as PyTorch has it."""
        if self.by_row:
            return torch.fft.irfft(spectrum, n=self.torus[1], norm=norm)
        return torch.fft.irfft2(spectrum, s=self.torus, norm=norm)

    def _to_pixels_(
        self, spectrum: Complex[Tensor, "*batch c fy fx"]
    ) -> Float[Tensor, "*batch c ty tx"]:
        """Return the planes of a spectrum, without any factor; it may be written on."""
        if spectrum.is_cuda and on_gpu(spectrum):
            from layerfield.kernels.gpu.cufft import to_planes_  # noqa: PLC0415  as other kernels

            planes = to_planes_(spectrum, self.torus[1], by_row=self.by_row)
            if planes is not None:
                return planes
        return self.to_pixels(spectrum, norm="forward")

    def low_to_pixels(
        self, spectrum: Complex[Tensor, "*batch c fy fx"]
    ) -> Float[Tensor, "*batch c ty tx"]:
        """Return the planes of a spectrum that was made by `low`, in units of larger pixels."""
        if not self.serves(spectrum):
            return self.to_pixels(spectrum).div_(self.pixels)
        count = math.prod(self.torus[int(self.by_row) :]) * self.pixels
        return Pairs.of_low(spectrum, self.by_row, 2 / count).planes()

    def to_low(self, planes: Float[Tensor, "*batch c ty tx"]) -> Complex[Tensor, "*batch c fy fx"]:
        """Return the spectrum again, whose highest do not count; planes may be written on."""
        if not self.serves(planes):
            return self.to_frequencies(planes).mul_(self.pixels)
        return Pairs.of(planes, self.by_row).low(self.torus).mul_(self.pixels)

    def solved_pixels(
        self,
        planes: Float[Tensor, "*batch layer c ty tx"] | Blend,
        penalty: float,
        balance: float,
        gain: float = 1.0,
        kept: float = 0.0,
        apart: "Apart | None" = None,
        added: Blend | None = None,
    ) -> Float[Tensor, "*batch layer c ty tx"]:
        """Return g rho (G + rho I)^-1 of planes, rho = penalty times the weight of all views.

        Args:
            planes: may be written on.
            penalty: share of the weight.
            balance: share of it, too: of b (I - 1/K), which is added to G at frequency zero; not
                of rows by themselves, whose light is where their own bounds want it.
            gain: g.
            kept: of the planes as they are, that is added.
            apart: what takes the place of the `low_part`.
            added: to all that.
        """
        if not self.serves(planes, added):
            seen = self.to_frequencies(planes.planes() if isinstance(planes, Blend) else planes)
            taken = None if apart is None else low_part(seen, apart.grid)
            # What transforms divide by is part of the matrices: a pass less.
            share = 1 / math.prod(self.torus[int(self.by_row) :])
            seen = self.solved_frequencies(seen, penalty, balance, gain * share, kept * share)
            if apart is not None and taken is not None:
                replace_low_part_(seen, apart.solve(taken).mul_(share), apart.grid)
            result = self._to_pixels_(seen)
            return result if added is None else added.planes(onto=result)
        pull, rho = 0 if self.by_row else balance * self.weight, penalty * self.weight
        terms = Terms(rho, pull, gain * rho, kept)
        if isinstance(planes, Blend) and not self.by_row:
            low = None if apart is None else LowApart(apart.grid.window, apart.solve)
            made = solved_in_three_passes(planes, self._entries, terms, added, low)
            if made is not None:
                return made
        pairs, other = Pairs.of(planes, self.by_row), None
        if apart is not None:
            window = apart.grid.window
            other = LowPart(apart.solve(pairs.low(apart.grid.torus) * window), window)
        pairs.solve_(self._entries, terms, other)
        return pairs.planes(added)

    def solved_frequencies(
        self,
        spectrum: Complex[Tensor, "*batch layer c fy fx"],
        penalty: float,
        balance: float,
        gain: float = 1.0,
        kept: float = 0.0,
    ) -> Complex[Tensor, "*batch layer c fy fx"]:
        """Return the same of the spectrum of planes."""
        if self.symbol.dtype == torch.float32 and on_gpu(spectrum):
            from layerfield.kernels.gpu.spectra import multiply as multiply_on_gpu  # noqa: PLC0415  needs Triton
            from layerfield.kernels.gpu.spectra import upper  # noqa: PLC0415  needs Triton

            known = self._resolvent(penalty, balance, gain, upper)
            return multiply_on_gpu(known, spectrum, kept)
        known = self._resolvent(penalty, balance, gain, interleaved)
        product = multiply(known, spectrum)
        return product.add_(spectrum, alpha=kept) if kept else product

    def serves(self, *planes: Tensor | Blend | None) -> bool:
        """Whether compiled loops solve such planes of this torus."""
        if self.torus[1] % 2 != 0 or self.symbol.dtype != torch.float32:
            return False
        return all(each.serves() if isinstance(each, Blend) else serve(each) for each in planes)

    def system(self, balance: float, bounds: tuple[float, float]) -> System:
        """Return what steps have in common, for compiled loops; see `serves`."""
        return system_of(self._entries, self.by_row, self.weight, balance, bounds)

    @cached_property
    def _entries(self) -> Symbol:
        """The symbol for compiled loops."""
        return symbol_of(self.symbol)

    def _resolvent(
        self, penalty: float, balance: float, gain: float, written: Callable[[Tensor], Any]
    ) -> Any:
        """Computed once for a penalty: it depends on the display alone.

        A recording is given what was kept before it, or makes it anew whenever it is played.

        Args:
            penalty: as of `solved_pixels`, and the others.
            balance: share of the weight.
            gain: of it all.
            written: how it is kept.
        """
        key = (penalty, balance, gain, written)
        if key not in self._kept:
            found = written(resolvent(self, penalty, balance, gain))
            if self.symbol.is_cuda and torch.cuda.is_current_stream_capturing():
                return found
            if sum(map(_size, self._kept.values())) + _size(found) > _MOST_KEPT:
                self._kept.clear()
            self._kept[key] = found
        return self._kept[key]

    @property
    def kept(self) -> tuple[Any, ...]:
        """What was computed once and is kept so far, for those who need it for longer."""
        finer = tuple(self._kept.values())
        return sum((each.kept for each in self._coarser.values()), finer)

    def coarser(self, times: int) -> "Spectral":
        """Return the same display seen with pixels larger so many times: its low frequencies.

        They are a little smaller where that gives fast lengths. Rows that do not know of each other
        stay apart: their pixels grow wider alone.
        """
        if times not in self._coarser:
            height, width = self.torus
            rows = height if self.by_row else fast_length(height // times)
            torus = rows, fast_width(width // times)
            pixels = math.prod(self.torus) / math.prod(torus)
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


@dataclass(frozen=True, eq=False)
class Apart:
    """Low frequencies that are solved by themselves.

    Args:
        grid: coarser, of larger pixels.
        solve: returns what takes the place of a `low_part`, and may write on it.
    """

    grid: Spectral
    solve: Callable[[Tensor], Tensor]


def resolvent(
    spectral: Spectral, penalty: float, balance: float, gain: float = 1.0
) -> Inexact[Tensor, "layer layer fy fx"]:
    """Return g rho (G + rho I)^-1; arguments as of `Spectral.solved_pixels`."""
    rho, matrix = penalty * spectral.weight, spectral.symbol.clone()
    identity = torch.eye(len(matrix), dtype=matrix.dtype, device=matrix.device)
    matrix += rho * identity[:, :, None, None]
    if not spectral.by_row:
        matrix[:, :, 0, 0] += balance * spectral.weight * (identity - 1 / len(matrix))
    return gain * rho * inverse(matrix)


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


def _size(matrix: Matrix | Tensor) -> int:
    if isinstance(matrix, Tensor):
        return matrix.numel() * matrix.element_size()
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
