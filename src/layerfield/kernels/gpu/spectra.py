"""Every frequency of a spectrum times a symmetric matrix of its own, in one pass."""

# pyright: reportGeneralTypeIssues=false
# Loops that are unrolled, over `static_range`, are for Triton alone to understand.

import math

import torch
import triton.language as tl
from jaxtyping import Complex, Float
from torch import Tensor

from layerfield.kernels.gpu.kernel import blocks, kernel

_BLOCK = 1024  # real and imaginary parts


def upper(matrix: Float[Tensor, "layer layer fy fx"]) -> Float[Tensor, "entry fy fx"]:
    """Return the entries of symmetric matrices from the diagonal on, row by row."""
    rows, columns = torch.triu_indices(len(matrix), len(matrix), device=matrix.device)
    return matrix[rows, columns].contiguous()


def multiply(
    entries: Float[Tensor, "entry gy fx"],
    spectrum: Complex[Tensor, "*batch layer c fy fx"],
    kept: float,
) -> Complex[Tensor, "*batch layer c fy fx"]:
    """Return R s + kept s; a single row of frequencies serves all rows of a spectrum.

    Args:
        entries: R, see `upper`.
        spectrum: s, contiguous.
        kept: share of it.
    """
    number, channels, rows, columns = spectrum.shape[-4:]
    result = torch.empty_like(spectrum)
    given, made = (torch.view_as_real(each) for each in (spectrum, result))
    numbers, frequencies = 2 * rows * columns, entries[0].numel()
    pictures = math.prod(spectrum.shape[:-4]) * channels
    _multiply[blocks(numbers, _BLOCK), pictures](
        made, given, entries, kept, channels, numbers, frequencies,
        LAYERS=number, ONE_ROW=entries.shape[-2] < rows, BLOCK=_BLOCK,
    )  # fmt: skip
    return result


@kernel
def _multiply(
    result, spectrum, entries, kept, channels, numbers, frequencies,
    LAYERS: tl.constexpr, ONE_ROW: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    item, channel = tl.program_id(1) // channels, tl.program_id(1) % channels
    plane = (item * LAYERS * channels + channel).to(tl.int64) * numbers
    behind = channels * numbers
    n = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    inside, frequency = n < numbers, n // 2
    if ONE_ROW:
        frequency %= frequencies
    for k in tl.static_range(LAYERS):
        total = kept * tl.load(spectrum + plane + k * behind + n, inside)
        for j in tl.static_range(LAYERS):
            entry = _entry(min(k, j), max(k, j), LAYERS)
            factor = tl.load(entries + entry * frequencies + frequency, inside)
            total += factor * tl.load(spectrum + plane + j * behind + n, inside)
        tl.store(result + plane + k * behind + n, total, inside)


@kernel
def _entry(k: tl.constexpr, j: tl.constexpr, LAYERS: tl.constexpr):
    """Where row k of the upper triangle has column j."""
    return k * LAYERS - k * (k - 1) // 2 + j - k
