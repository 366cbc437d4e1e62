"""Spectra of planes, and their products with (G + rho I)^-1.

A plane is transformed fastest with neighbours along x taken for the real and the imaginary part of
one pixel. With E and O, the spectra of its even and of its odd columns,

    Z(fy, fx) = E + i O
    X(fy, fx) = E + w O,    X(fy, fx + W / 2) = E - w O,    w = exp(-2 pi i fx / W)

X, the spectrum of the plane, follows from Z at opposite frequencies, and Z from X. Widths are even.
Planes whose rows do not know of each other are transformed row by row: the frequencies of a row
have their opposites in the row itself.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Complex, Float
from torch import Tensor

from layerfield.kernels.blends import Blend
from layerfield.kernels.compiled import compiled
from layerfield.kernels.planes import transformed, transformed_back

_HALF = np.float32(0.5)


class Terms(NamedTuple):
    """Of g (G + rho I)^-1 + k I: rho; b of b (I - 1/K), added to G at frequency zero; g; and k."""

    rho: float
    balance: float
    gain: float
    kept: float = 0.0


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

    def planes(self, added: Blend | None = None) -> Float[Tensor, "*batch ty tx"]:
        """Transform what was solved back, in place, and add something to it."""
        return transformed_back(self.values, self.by_row, added)

    def solve_(
        self,
        symbol: Float[Tensor, "layer layer fy fx"],
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
        expected = (number, number, 1 if self.by_row else height, half + 1)
        if symbol.shape != expected:  # compiled loops would go past the end of smaller arrays
            raise ValueError(f"found matrices {tuple(symbol.shape)}, expected {expected}")
        seen = _numbers(self.values, number, channels)
        factor = 1 / (half if self.by_row else height * half)
        kept, gain = terms.kept * factor, terms.gain * factor
        known = Terms._make(map(np.float32, terms._replace(gain=gain, kept=kept)))
        if low is None:
            other, window = seen[..., :0], np.zeros((0, 0), np.float32)
        else:
            other = _numbers(low.spectrum * factor, number, channels)
            window = low.window.expand(other.shape[-2], -1).numpy()
        rows = height if self.by_row else height // 2 + 1
        given = (seen, symbol.numpy(), turns_of(2 * half), known, other, window, self.by_row)
        solve_rows.in_spans(*given, count=rows, numbers=seen.size)

    def low(self, torus: tuple[int, int]) -> Complex[Tensor, "*batch fy fx"]:
        """Return X of low frequencies, as that of a smaller torus; its highest are 0."""
        *batch, _, half = self.values.shape
        result = self.values.new_zeros(*batch, torus[0], torus[1] // 2 + 1)
        made, given = _numbers(result), (_numbers(self.values), turns_of(2 * half), self.by_row)
        _read_low.in_spans(made, *given, count=math.prod(made.shape[:2]), numbers=made.size)
        return result


def _numbers(values: Tensor, *by: int) -> np.ndarray:
    """Return `[n, *by, y, 2 x]`."""
    height, width = values.shape[-2:]
    return torch.view_as_real(values).view(-1, *by, height, 2 * width).numpy()


@lru_cache(maxsize=16)
def turns_of(width: int) -> Turns:
    """Return w of rows of so many pixels."""
    angle = np.arange(width // 2) * (2 * np.pi / width)
    return Turns(np.cos(angle).astype(np.float32), np.sin(angle).astype(np.float32))


@compiled
def solve_rows(spectrum, symbol, turns, terms, other, window, by_row, begin, end):
    """Row y and that of the opposite frequencies say all of X at both."""
    items, number, channels, height, twice = spectrum.shape
    half = twice // 2
    low = np.zeros((number, number, half), spectrum.dtype)  # of fx
    high = np.zeros((number, number, half), spectrum.dtype)  # of fx + W / 2
    here = np.zeros((2, half), spectrum.dtype)  # Z
    there = np.zeros((2, half), spectrum.dtype)  # of opposite frequencies
    seen = np.zeros((4, number, half), spectrum.dtype)  # X at fx, and at fx + W / 2
    value = np.zeros((4, half), spectrum.dtype)
    for y in range(begin, end):
        opposite = y if by_row else (height - y) % height
        row, back, is_low = _small_rows(y, len(window), by_row)
        if y == begin or not by_row:
            for k in range(number):
                for m in range(k, number):
                    _read(low[k, m], symbol[k, m, 0 if by_row else y])
                    _read_back(high[k, m], symbol[k, m, 0 if by_row else opposite])
            _invert(low, terms, y == 0)
            _invert(high, terms, False)
        for item in range(items):
            for channel in range(channels):
                for k in range(number):
                    _split(spectrum[item, k, channel, y], here[0], here[1])
                    _split_back(spectrum[item, k, channel, opposite], there[0], there[1])
                    _part(here, there, turns, seen[:, k])
                for k in range(number):
                    for part in range(4):
                        _multiply(low if part < 2 else high, seen[part], k, value[part])
                    if is_low:
                        _replace(value, other[item, k, channel], window, row, back)
                    _unite(value, turns, here, there)
                    _join_back(there[0], there[1], spectrum[item, k, channel, opposite])
                    _join(here[0], here[1], spectrum[item, k, channel, y])


@compiled
def _small_rows(y, height, by_row):
    """Return where row y and its opposite lie on a smaller torus, and whether they do."""
    if by_row:
        return y, y, height > 0
    return y, (height - y) % max(height, 1), y <= (height - 1) // 2


@compiled
def _replace(value, other, window, row, back):
    """Frequency -fx is at W - fx: among the second half of X, conjugated."""
    half, count = value.shape[1], window.shape[1] - 1  # without the highest
    for x in range(count):
        rest = 1 - window[row, x]
        value[0, x] = rest * value[0, x] + other[row, 2 * x]
        value[1, x] = rest * value[1, x] + other[row, 2 * x + 1]
    for x in range(1, count):
        rest = 1 - window[back, x]
        value[2, half - x] = rest * value[2, half - x] + other[back, 2 * x]
        value[3, half - x] = rest * value[3, half - x] - other[back, 2 * x + 1]


@compiled
def _read_low(result, spectrum, turns, by_row, begin, end):
    """Rows of all planes, from and to, but for the highest frequencies of the smaller torus."""
    height, rows = spectrum.shape[1], result.shape[1]
    for number in range(begin, end):
        plane, row = divmod(number, rows)
        if by_row:
            _read_row(result[plane, row], spectrum[plane, row], spectrum[plane, row], turns)
        elif 2 * row != rows:
            y = row if 2 * row < rows else height - rows + row
            other = spectrum[plane, (height - y) % height]
            _read_row(result[plane, row], spectrum[plane, y], other, turns)


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
def _read(entry, row):
    for x in range(len(entry)):
        entry[x] = row[x]


@compiled
def _read_back(entry, row):
    """The last comes first: frequency W / 2 is that of fx = 0."""
    last = np.uintp(len(entry))  # a whole number that may be negative would keep loops scalar
    for x in range(last):
        entry[x] = row[last - x]


@compiled
def _split(row, real, imaginary):
    for x in range(len(real)):
        real[x] = row[2 * x]
        imaginary[x] = row[2 * x + 1]


@compiled
def _split_back(row, real, imaginary):
    """The same, from frequency -fx; zero is its own opposite."""
    real[0] = row[0]
    imaginary[0] = row[1]
    rest, later, other, last = row[2:], real[1:], imaginary[1:], np.uintp(len(real) - 2)
    for x in range(last + np.uintp(1)):
        later[x] = rest[2 * (last - x)]
        other[x] = rest[2 * (last - x) + 1]


@compiled
def _join(real, imaginary, row):
    for x in range(len(real)):
        row[2 * x] = real[x]
        row[2 * x + 1] = imaginary[x]


@compiled
def _join_back(real, imaginary, row):
    row[0] = real[0]
    row[1] = imaginary[0]
    rest, later, other, last = row[2:], real[1:], imaginary[1:], np.uintp(len(real) - 2)
    for x in range(last + np.uintp(1)):
        rest[2 * (last - x)] = later[x]
        rest[2 * (last - x) + 1] = other[x]


@compiled
def _part(here, there, turns, seen):
    """Find E + w O and E - w O from Z(f) and Z(-f)."""
    zr, zi, yr, yi, cos, sin = here[0], here[1], there[0], there[1], turns.cos, turns.sin
    ar, ai, br, bi = seen[0], seen[1], seen[2], seen[3]
    for x in range(len(zr)):
        er, ei = _HALF * (zr[x] + yr[x]), _HALF * (zi[x] - yi[x])
        qr, qi = _HALF * (zi[x] + yi[x]), _HALF * (yr[x] - zr[x])
        wr, wi = cos[x] * qr + sin[x] * qi, cos[x] * qi - sin[x] * qr
        ar[x] = er + wr
        ai[x] = ei + wi
        br[x] = er - wr
        bi[x] = ei - wi


@compiled
def _unite(value, turns, here, there):
    """Find Z(f) and Z(-f) from E + w O and E - w O."""
    zr, zi, yr, yi, cos, sin = here[0], here[1], there[0], there[1], turns.cos, turns.sin
    ar, ai, br, bi = value[0], value[1], value[2], value[3]
    for x in range(len(zr)):
        er, ei = _HALF * (ar[x] + br[x]), _HALF * (ai[x] + bi[x])
        wr, wi = _HALF * (ar[x] - br[x]), _HALF * (ai[x] - bi[x])
        qr, qi = cos[x] * wr - sin[x] * wi, cos[x] * wi + sin[x] * wr
        zr[x] = er - qi
        zi[x] = ei + qr
        yr[x] = er + qi
        yi[x] = qr - ei


@compiled
def _multiply(matrix, seen, k, value):
    """Find row k of a symmetric matrix, of which there is the part above its diagonal, times X."""
    entry, plane = matrix[0, k], seen[0]
    for x in range(len(value)):
        value[x] = entry[x] * plane[x]
    for m in range(1, len(seen)):
        entry, plane = _entry(matrix, k, m), seen[m]
        for x in range(len(value)):
            value[x] += entry[x] * plane[x]


@compiled
def _invert(matrix, terms, is_first):
    """Find g (G + rho I)^-1 + k I: sweeps over all pivots end with minus the inverse."""
    number = len(matrix)
    for k in range(number):
        _add(matrix[k, k], terms.rho)
    if is_first:
        _balance(matrix, terms.balance)
    for k in range(number):
        _sweep(matrix, k)
    for k in range(number):
        for m in range(k, number):
            _scale(matrix[k, m], -terms.gain)
        _add(matrix[k, k], terms.kept)


@compiled
def _balance(matrix, balance):
    number = len(matrix)
    for k in range(number):
        for m in range(k, number):
            matrix[k, m, 0] += balance * ((1 if k == m else 0) - 1 / number)


@compiled
def _sweep(matrix, k):
    pivot = matrix[k, k]
    for x in range(len(pivot)):
        pivot[x] = 1 / pivot[x]
    for i in range(len(matrix)):
        for j in range(i, len(matrix)):
            if k not in (i, j):
                _eliminate(matrix[i, j], _entry(matrix, i, k), _entry(matrix, j, k), pivot)
    for i in range(len(matrix)):
        if i != k:
            _divide(_entry(matrix, i, k), pivot)
    _scale(pivot, np.float32(-1))


@compiled
def _entry(matrix, i, k):
    return matrix[min(i, k), max(i, k)]


@compiled
def _add(entry, number):
    for x in range(len(entry)):
        entry[x] += number


@compiled
def _scale(entry, number):
    for x in range(len(entry)):
        entry[x] *= number


@compiled
def _divide(entry, pivot):
    for x in range(len(entry)):
        entry[x] *= pivot[x]


@compiled
def _eliminate(entry, one, other, pivot):
    for x in range(len(entry)):
        entry[x] -= one[x] * other[x] * pivot[x]
