"""Spectra of planes, and their products with (G + rho I)^-1.

A plane is transformed fastest with neighbours along x taken for the real and the imaginary part of
one pixel. With E and O, the spectra of its even and of its odd columns,

    Z(fy, fx) = E + i O
    X(fy, fx) = E + w O,    X(fy, fx + W / 2) = E - w O,    w = exp(-2 pi i fx / W)

X, the spectrum of the plane, follows from Z at opposite frequencies, and Z from X.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Complex, Float
from torch import Tensor

from layerfield.kernels.compiled import compiled
from layerfield.kernels.threads import in_spans

_HALF = np.float32(0.5)
_LARGE = 1 << 17  # complex pixels of a plane from which on it is transformed by itself


class Terms(NamedTuple):
    """Of g (G + rho I)^-1 + k I: rho; b of b (I - 1/K), added to G at frequency zero; g; and k."""

    rho: float
    balance: float
    gain: float
    kept: float = 0.0


class _Turns(NamedTuple):
    """Of w."""

    cos: np.ndarray
    sin: np.ndarray


def to_pixels(spectrum: Complex[Tensor, "*batch fy fx"]) -> Float[Tensor, "*batch ty tx"]:
    """Return the planes of an even width with this spectrum, as `irfft2` does."""
    half = spectrum.shape[-1] - 1
    pairs = torch.empty(*spectrum.shape[:-1], half, dtype=spectrum.dtype)
    seen, made, turns = _numbers(spectrum.contiguous()), _numbers(pairs), _turns(2 * half)

    def task(begin: int, end: int) -> None:
        _unite_pairs_of_rows(seen, made, turns, begin, end)

    in_spans(task, spectrum.shape[-2] // 2 + 1, seen.size)
    return torch.view_as_real(_transformed_(torch.fft.ifft2, pairs)).flatten(-2)


def resolve_(
    spectrum: Complex[Tensor, "*batch layer c fy fx"],
    symbol: Float[Tensor, "layer layer sy fx"],
    terms: Terms,
) -> None:
    """Multiply a spectrum, as of `rfft2`, by g (G + rho I)^-1 + k I, in place.

    Args:
        spectrum: contiguous.
        symbol: G(f); one row of it serves all rows of the spectrum.
        terms: rho, b, g and k.
    """
    height, (number, channels, *_) = spectrum.shape[-2], spectrum.shape[-4:]
    _expect(symbol, number, height, spectrum.shape[-1])
    seen, matrices = _numbers(spectrum, number, channels), symbol.numpy()
    known = Terms._make(map(np.float32, terms))
    in_spans(lambda begin, end: _resolve_rows(seen, matrices, known, begin, end), height, seen.size)


def resolved_(
    planes: Float[Tensor, "*batch layer c ty tx"],
    symbol: Float[Tensor, "layer layer fy fx"],
    terms: Terms,
) -> Float[Tensor, "*batch layer c ty tx"]:
    """Return g (G + rho I)^-1 + k I times planes of an even width, which may be written on.

    Nothing but the planes is in memory, where they are large.
    """
    (number, channels, height, width) = planes.shape[-4:]
    _expect(symbol, number, height, width // 2 + 1)
    pairs = _transformed_(torch.fft.fft2, _pairs(planes))
    known = Terms._make(map(np.float32, terms))
    seen = _numbers(pairs, number, channels)
    matrices, turns = symbol.numpy(), _turns(width)

    def task(begin: int, end: int) -> None:
        _resolve_pairs_of_rows(seen, matrices, turns, known, begin, end)

    in_spans(task, height // 2 + 1, seen.size)
    return torch.view_as_real(_transformed_(torch.fft.ifft2, pairs)).flatten(-2)


def _expect(symbol: Tensor, number: int, height: int, columns: int) -> None:
    """Compiled loops would go past the end of smaller arrays."""
    rows = symbol.shape[-2]
    expected = (number, number, rows if rows == 1 else height, columns)
    if symbol.shape != expected:
        raise ValueError(f"found matrices of shape {tuple(symbol.shape)}, expected {expected}")


def _pairs(planes: Tensor) -> Tensor:
    return torch.view_as_complex(planes.contiguous().unflatten(-1, (-1, 2)))


def _transformed_(transform: Callable[..., Tensor], values: Tensor) -> Tensor:
    """Large planes are written on, one by one: each stays in the cache for both directions."""
    if values.shape[-2:].numel() < _LARGE:
        return transform(values).contiguous()
    for plane in values.flatten(end_dim=-3):
        plane.copy_(transform(plane))
    return values


def _numbers(spectrum: Tensor, *by: int) -> np.ndarray:
    """Return `[n, *by, y, 2 x]`."""
    height, width = spectrum.shape[-2:]
    return torch.view_as_real(spectrum).view(-1, *by, height, 2 * width).numpy()


@lru_cache(maxsize=16)
def _turns(width: int) -> _Turns:
    angle = np.arange(width // 2) * (2 * np.pi / width)
    return _Turns(np.cos(angle).astype(np.float32), np.sin(angle).astype(np.float32))


@compiled
def _unite_pairs_of_rows(spectrum, pairs, turns, begin, end):
    """Find Z from X, of rows and of those of the opposite frequencies."""
    items, height, twice = pairs.shape
    here, there = np.zeros((2, twice // 2), pairs.dtype), np.zeros((2, twice // 2), pairs.dtype)
    value = np.zeros((4, twice // 2), pairs.dtype)
    for item in range(items):
        for y in range(begin, end):
            other = spectrum[item, (height - y) % height]
            _split(spectrum[item, y], value[0], value[1])
            _split_back(other, value[2], value[3])
            value[2, 0], value[3, 0] = other[twice], other[twice + 1]
            _scale(value[3], np.float32(-1))
            _unite(value, turns, here, there)
            _join_back(there[0], there[1], pairs[item, (height - y) % height])
            _join(here[0], here[1], pairs[item, y])


@compiled
def _resolve_rows(spectrum, symbol, terms, begin, end):
    items, number, channels, _, twice = spectrum.shape
    width = twice // 2
    matrix = np.zeros((number, number, width), spectrum.dtype)
    seen = np.zeros((2, number, width), spectrum.dtype)
    value = np.zeros((2, width), spectrum.dtype)
    for y in range(begin, end):
        if y == begin or symbol.shape[2] > 1:
            for k in range(number):
                for m in range(k, number):
                    _read(matrix[k, m], symbol[k, m, min(y, symbol.shape[2] - 1)])
            _invert(matrix, terms, y == 0)
        for item in range(items):
            for channel in range(channels):
                for k in range(number):
                    _split(spectrum[item, k, channel, y], seen[0, k], seen[1, k])
                for k in range(number):
                    _multiply(matrix, seen[0], k, value[0])
                    _multiply(matrix, seen[1], k, value[1])
                    _join(value[0], value[1], spectrum[item, k, channel, y])


@compiled
def _resolve_pairs_of_rows(spectrum, symbol, turns, terms, begin, end):
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
        opposite = (height - y) % height
        for k in range(number):
            for m in range(k, number):
                _read(low[k, m], symbol[k, m, y])
                _read_back(high[k, m], symbol[k, m, opposite])
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
                    _unite(value, turns, here, there)
                    _join_back(there[0], there[1], spectrum[item, k, channel, opposite])
                    _join(here[0], here[1], spectrum[item, k, channel, y])


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
