"""Spectra of planes, and their products with (G + rho I)^-1.

A plane is transformed fastest with neighbours along x taken for the real and the imaginary part of
one pixel. With E and O, the spectra of its even and of its odd columns,

    Z(fy, fx) = E + i O
    X(fy, fx) = E + w O,    X(fy, fx + W / 2) = E - w O,    w = exp(-2 pi i fx / W)

X, the spectrum of the plane, follows from Z at opposite frequencies, and Z from X. Widths are even.
Planes whose rows do not know of each other are transformed row by row: the frequencies of a row
have their opposites in the row itself.

Where X(fx) is multiplied by T and X(fx + W / 2) by U, both real, Z need not be taken apart. With
R = i conj(Z(-f)), S = (T + U) / 2, D = (T - U) / 2 and w = cos - i sin,

    Z'(f) = (S - sin D) Z + cos D R,    R'(f) = (S + sin D) R + cos D Z

Real and imaginary parts are multiplied by the same, and R is a row of Z turned round, number by
number.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Complex, Float
from torch import Tensor

from layerfield.kernels.blends import Blend
from layerfield.kernels.compiled import compiled, native
from layerfield.kernels.inverses import Terms, invert
from layerfield.kernels.planes import transformed, transformed_back
from layerfield.kernels.symbols import BESIDE, Symbol, row_of

_HALF, _ONE = np.float32(0.5), np.float32(1)  # whole numbers would make the rest double


class LowPart(NamedTuple):
    """What takes the place of low frequencies.

    Args:
        spectrum: as that of a smaller torus; its highest frequencies do not count.
        window: shares of what is replaced.
    """

    spectrum: Complex[Tensor, "*batch fy fx"]
    window: Float[Tensor, "fy fx"]


class Turns(NamedTuple):
    """Of w."""

    cos: np.ndarray
    sin: np.ndarray


@dataclass(frozen=True, eq=False)
class Pairs:
    """The spectrum of planes, as Z.

    Args:
        values: Z.
        by_row: whether every row is transformed by itself.
    """

    values: Complex[Tensor, "*batch ty half"]
    by_row: bool

    @classmethod
    def of(cls, planes: Float[Tensor, "*batch ty tx"] | Blend, by_row: bool) -> "Pairs":
        """Transform planes, which may be written on."""
        return cls(transformed(planes, by_row), by_row)

    @classmethod
    def of_low(
        cls, spectrum: Complex[Tensor, "*batch fy fx"], by_row: bool, factor: float
    ) -> "Pairs":
        """Return Z of a multiple of X as `low` returns it, whose highest frequencies do not count.

        `planes` then are those of X, times what transforms leave out.
        """
        values = spectrum.new_empty(*spectrum.shape[:-1], spectrum.shape[-1] - 1)
        made, seen, turns = numbers_of(values), numbers_of(spectrum), turns_of(2 * values.shape[-1])
        given = (made, seen, turns, np.float32(factor), by_row)
        put_low.in_spans(*given, count=math.prod(made.shape[:2]), numbers=made.size)
        return cls(values, by_row)

    def planes(self, added: Blend | None = None) -> Float[Tensor, "*batch ty tx"]:
        """Transform what was solved back, in place, and add something to it."""
        return transformed_back(self.values, self.by_row, added)

    def solve_(
        self,
        symbol: Symbol,
        terms: Terms,
        low: LowPart | None = None,
    ) -> None:
        """Multiply X by g (G + rho I)^-1 + k I, and by what transforms leave out, in place.

        Args:
            symbol: G(f), of a single row where all are transformed by themselves; layers and their
                channels are the batch.
            terms: rho, b, g and k.
            low: what takes the place of low frequencies afterwards.
        """
        number, channels, height, half = self.values.shape[-4:]
        refuse_other_matrices(symbol.shape, number, self.values.shape, self.by_row)
        seen = numbers_of(self.values, number, channels)
        factor = 1 / (half if self.by_row else height * half)
        kept, gain = terms.kept * factor, terms.gain * factor
        known = Terms._make(map(np.float32, terms._replace(gain=gain, kept=kept)))
        if low is None:
            other, window = seen[..., :0], np.zeros((0, 0), np.float32)
        else:
            other = numbers_of(low.spectrum * factor, number, channels)
            window = low.window.expand(other.shape[-2], -1).numpy()
        rows = height if self.by_row else height // 2 + 1
        given = (seen, symbol, turns_of(2 * half), known, other, window, self.by_row)
        solve_rows.in_spans(*given, count=rows, numbers=seen.size)

    def low(self, torus: tuple[int, int]) -> Complex[Tensor, "*batch fy fx"]:
        """Return X of low frequencies, as that of a smaller torus; its highest are 0."""
        *batch, _, half = self.values.shape
        result = self.values.new_zeros(*batch, torus[0], torus[1] // 2 + 1)
        made, given = numbers_of(result), (numbers_of(self.values), turns_of(2 * half), self.by_row)
        read_low.in_spans(made, *given, count=math.prod(made.shape[:2]), numbers=made.size)
        return result


def refuse_other_matrices(
    found: Sequence[int], number: int, pairs: Sequence[int], by_row: bool
) -> None:
    """Refuse G(f) of another shape: compiled loops would go past the end of smaller arrays.

    Args:
        found: its shape.
        number: of layers.
        pairs: the shape of a spectrum as Z.
        by_row: whether every row is transformed by itself.

    Raises:
        ValueError: they do not fit.
    """
    expected = (number, number, 1 if by_row else pairs[-2], pairs[-1] + 1)
    if tuple(found) != expected:
        raise ValueError(f"found matrices {tuple(found)}, expected {expected}")


def numbers_of(values: Tensor, *by: int) -> np.ndarray:
    """Return `[n, *by, y, 2 x]`."""
    height, width = values.shape[-2:]
    return torch.view_as_real(values).view(-1, *by, height, 2 * width).numpy()


@lru_cache(maxsize=16)
def turns_of(width: int) -> Turns:
    """Return w of rows of so many pixels."""
    angle = np.arange(width // 2) * (2 * np.pi / width)
    return Turns(np.cos(angle).astype(np.float32), np.sin(angle).astype(np.float32))


_ask_for = native("layerfield.kernels.ahead", "ask_for")
_multiply_rows = native("layerfield.kernels.matrix_lanes", "multiply_rows")


class _Matrices(NamedTuple):
    """What leads from Z and R to Z and R: rows of the entries [k, m], k <= m.

    Args:
        forth: from Z to Z.
        back: from R to R.
        across: from one to the other.
    """

    forth: np.ndarray
    back: np.ndarray
    across: np.ndarray


@compiled
def solve_rows(spectrum, symbol, turns, terms, other, window, by_row, begin, end):
    """Row y and that of the opposite frequencies say all of Z at both."""
    items, number, channels, height, twice = spectrum.shape
    wide = (twice + BESIDE - 1) // BESIDE * BESIDE
    forth = np.zeros((number, number, wide), spectrum.dtype)  # arrays of their own: what may be
    back = np.zeros((number, number, wide), spectrum.dtype)  # the same memory is not vectorised
    across = np.zeros((number, number, wide), spectrum.dtype)
    matrices = _Matrices(forth, back, across)
    low = np.zeros((number, number, twice // 2), spectrum.dtype)  # T of fx
    high = np.zeros((number, number, twice // 2), spectrum.dtype)  # of fx + W / 2
    seen = np.zeros((2, number, wide), spectrum.dtype)  # Z and R
    made = np.zeros((2, number, wide), spectrum.dtype)
    for y in range(begin, end):
        opposite = y if by_row else (height - y) % height
        rows = _small_rows(y, len(window), by_row)
        if y == begin or not by_row:
            places = (0, 0) if by_row else (y, opposite)
            _find_matrices(matrices, (low, high), symbol, places, terms, window, rows, turns)
        for item in range(items):
            for channel in range(channels):
                if channel + 1 < channels:
                    _ask_for_rows(spectrum, item, channel + 1, y, opposite)
                elif y + 1 < end:
                    _ask_for_rows(spectrum, 0, 0, y + 1, y + 1 if by_row else height - y - 1)
                for k in range(number):
                    _read(seen[0, k], spectrum[item, k, channel, y])
                    _turn_round(spectrum[item, k, channel, opposite], seen[1, k])
                _multiply(matrices, seen, made)
                for k in range(number):
                    if rows[2]:
                        _add_low(made[:, k, :twice], other[item, k, channel], rows, window, turns)
                    _turn_round(made[1, k, :twice], spectrum[item, k, channel, opposite])
                    _read(spectrum[item, k, channel, y], made[0, k])


@compiled
def _ask_for_rows(spectrum, item, channel, y, opposite):
    """Those of all layers."""
    for k in range(spectrum.shape[1]):
        _ask_for(spectrum[item, k, channel, y])
        _ask_for(spectrum[item, k, channel, opposite])


@compiled
def _find_matrices(made, room, symbol, places, terms, window, rows, turns):
    """Find those of two rows of frequencies."""
    (low, high), (y, opposite), (small, turned, is_low) = room, places, rows
    number = len(low)
    for k in range(number):
        for m in range(k, number):
            row, factor = row_of(symbol, k, m, y)
            _read_times(low[k, m], row, factor)
            row, factor = row_of(symbol, k, m, opposite)
            _read_back(high[k, m], row, factor)
    invert(low, terms, y == 0)
    invert(high, terms, False)
    for k in range(number):
        for m in range(k, number):
            if is_low:
                _leave_out_low(low[k, m], high[k, m], window[small], window[turned])
            entries = low[k, m], high[k, m], made.forth[k, m], made.back[k, m], made.across[k, m]
            _pair(entries, turns)


@compiled
def _multiply(matrices, seen, made):
    """Find Z' and R' of Z and R of all layers."""
    forth, back, across = matrices
    entries = forth.reshape(-1), back.reshape(-1), across.reshape(-1)
    numbers = seen[0].reshape(-1), seen[1].reshape(-1), made[0].reshape(-1), made[1].reshape(-1)
    _multiply_rows(seen.shape[1], seen.shape[2], *entries, *numbers)


@compiled
def _small_rows(y, height, by_row):
    """Return where row y and its opposite lie on a smaller torus, and whether they do."""
    if by_row:
        return y, y, height > 0
    return y, (height - y) % max(height, 1), y <= (height - 1) // 2


@compiled
def _leave_out_low(low, high, window, opposite):
    """Frequency -fx is at W - fx, among those of the second half."""
    count = len(window) - 1
    for x in range(count):
        low[x] *= _ONE - window[x]
    for x in range(1, count):
        high[len(high) - x] *= _ONE - opposite[x]


@compiled
def _add_low(value, other, rows, window, turns):
    """Add X of low frequencies to Z and R."""
    row, opposite, _ = rows
    half, count = value.shape[1] // 2, window.shape[1] - 1  # without the highest
    for x in range(count):
        real, imaginary = other[row, 2 * x], other[row, 2 * x + 1]
        _add_one(value, x, real, imaginary, turns.cos[x], turns.sin[x])
    for x in range(1, count):  # E - w O is that of the second half
        real, imaginary, h = other[opposite, 2 * x], -other[opposite, 2 * x + 1], half - x
        _add_one(value, h, real, imaginary, -turns.cos[h], -turns.sin[h])


@compiled
def _add_one(value, x, real, imaginary, cos, sin):
    """E = w O = X / 2."""
    less, more = _ONE - sin, _ONE + sin
    value[0, 2 * x] += _HALF * (less * real - cos * imaginary)
    value[0, 2 * x + 1] += _HALF * (less * imaginary + cos * real)
    value[1, 2 * x] += _HALF * (cos * real - more * imaginary)
    value[1, 2 * x + 1] += _HALF * (cos * imaginary + more * real)


@compiled
def read_low(result, spectrum, turns, by_row, begin, end):
    """Rows of all planes, from and to, but for the highest frequencies of the smaller torus."""
    height, rows = spectrum.shape[1], result.shape[1]
    for number in range(begin, end):
        plane, row = divmod(number, rows)
        if by_row:
            _read_row(result[plane, row], spectrum[plane, row], spectrum[plane, row], turns)
        elif 2 * row != rows:
            y = row_in(height, row, rows)
            other = spectrum[plane, (height - y) % height]
            _read_row(result[plane, row], spectrum[plane, y], other, turns)


@compiled
def row_in(height, row, rows):
    """Return where a row of a smaller torus is."""
    return row if 2 * row < rows else height - rows + row


@compiled
def _read_row(result, here, there, turns):
    half = len(here) // 2
    for x in range(len(result) // 2 - 1):
        opposite = half - x if x > 0 else 0
        zr, zi = here[2 * x], here[2 * x + 1]
        yr, yi = there[2 * opposite], there[2 * opposite + 1]
        er, ei = _HALF * (zr + yr), _HALF * (zi - yi)
        qr, qi = _HALF * (zi + yi), _HALF * (yr - zr)
        result[2 * x] = er + turns.cos[x] * qr + turns.sin[x] * qi
        result[2 * x + 1] = ei + turns.cos[x] * qi - turns.sin[x] * qr


@compiled
def put_low(result, spectrum, turns, factor, by_row, begin, end):
    """Rows of all planes, one after the other, from and to."""
    height = result.shape[1]
    for number in range(begin, end):
        plane, y = divmod(number, height)
        row = result[plane, y]
        if not by_row and 2 * y == height:
            row[:] = 0
        else:
            other = spectrum[plane, y if by_row else (height - y) % height]
            _put_row(row, spectrum[plane, y], other, turns, factor * _HALF)


@compiled
def _put_row(result, here, there, turns, factor):
    """E = (X + Y) / 2 and w O = (X - Y) / 2, with Y(fx) = X(fx + W / 2) = conj(X(W / 2 - fx))."""
    half = len(result) // 2
    for x in range(half):
        xr, xi = here[2 * x], here[2 * x + 1]
        yr = there[2 * (half - x)] if x > 0 else np.float32(0)
        yi = -there[2 * (half - x) + 1] if x > 0 else np.float32(0)
        dr, di = xr - yr, xi - yi
        result[2 * x] = factor * (xr + yr - turns.sin[x] * dr - turns.cos[x] * di)
        result[2 * x + 1] = factor * (xi + yi - turns.sin[x] * di + turns.cos[x] * dr)


@compiled
def _read(entry, row):
    """As many numbers as both have."""
    for x in range(min(len(entry), len(row))):
        entry[x] = row[x]


@compiled
def _read_times(entry, row, factor):
    for x in range(len(entry)):
        entry[x] = factor * row[x]


@compiled
def _read_back(entry, row, factor):
    """The last comes first: frequency W / 2 is that of fx = 0."""
    last = np.uintp(len(entry))  # a whole number that may be negative would keep loops scalar
    for x in range(last):
        entry[x] = factor * row[last - x]


@compiled
def _turn_round(row, other):
    """From Z of one row to R of the other, and back; frequency zero is its own opposite."""
    other[0] = row[1]
    other[1] = row[0]
    rest, later, last = row[2:], other[2:], np.uintp(len(row) - 3)
    for x in range(last + np.uintp(1)):
        later[x] = rest[last - x]


@compiled
def _pair(entries, turns):
    """Find what leads from Z and R to Z and R; the same for real and imaginary parts."""
    low, high, forth, back, across = entries
    for x in range(len(low)):
        mean, half = _HALF * (low[x] + high[x]), _HALF * (low[x] - high[x])
        forth[2 * x] = forth[2 * x + 1] = mean - turns.sin[x] * half
        back[2 * x] = back[2 * x + 1] = mean + turns.sin[x] * half
        across[2 * x] = across[2 * x + 1] = turns.cos[x] * half
