"""Layers rounded to the codes of a panel; what codes of views stand for, and the mean of that."""

import numpy as np
import torch
from jaxtyping import Float, Float64, UInt
from torch import Tensor

from layerfield.kernels.compiled import compiled


def codes_of(
    values: Float[Tensor, "*shape"], largest: int, dtype: torch.dtype
) -> UInt[Tensor, "*shape"]:
    """Return the nearest codes of values from 0 to 1, of single precision on a processor.

    Args:
        values: those beyond are shown as the nearest code.
        largest: code of 1.
        dtype: of the codes.
    """
    codes = torch.empty(values.shape, dtype=dtype)
    seen, made = (each.contiguous().view(-1).numpy() for each in (values.detach(), codes))
    _round.in_spans(made, seen, np.float32(largest), count=len(seen), numbers=len(seen))
    return codes


def looked_up(
    codes: UInt[Tensor, "*shape"], table: UInt[Tensor, " code"]
) -> UInt[Tensor, "*shape"]:
    """Return what codes stand for, on a processor.

    Args:
        codes: of views.
        table: what each stands for.
    """
    found = torch.empty(codes.shape, dtype=table.dtype)
    seen, made = (each.view(-1).numpy() for each in (codes.contiguous(), found))
    _look_up_spans.in_spans(made, seen, table.numpy(), count=len(seen), numbers=len(seen))
    return found


def mean_of(
    codes: UInt[Tensor, "*batch view c y x"], table: Float[Tensor, " code"]
) -> Float64[Tensor, "*batch"]:
    """Return the mean of what codes stand for, on a processor: rows are summed in single precision.

    Args:
        codes: of views.
        table: what each stands for, in single precision.
    """
    sums = torch.empty(codes.shape[:-1], dtype=torch.float64)
    rows, made = codes.contiguous().view(-1, codes.shape[-1]).numpy(), sums.view(-1).numpy()
    _sum_rows.in_spans(made, rows, table.numpy(), count=len(rows), numbers=rows.size)
    return sums.mean(dim=(-3, -2, -1)) / codes.shape[-1]


@compiled
def look_up(made, codes, table):
    """Write what the codes of a row stand for."""
    for x in range(len(made)):
        made[x] = table[np.int64(codes[x])]


@compiled
def _sum_rows(made, codes, table, begin, end):
    """Write the sum of what the codes of each row stand for."""
    for n in range(begin, end):
        row, total = codes[n], np.float32(0)
        for x in range(len(row)):
            total += table[np.int64(row[x])]
        made[n] = total


@compiled
def _look_up_spans(made, codes, table, begin, end):
    look_up(made[begin:end], codes[begin:end], table)


@compiled
def _round(codes, values, largest, begin, end):
    """Halves go to even numbers, as PyTorch has it."""
    seen, made = values[begin:end], codes[begin:end]
    for x in range(len(made)):
        made[x] = np.int32(np.rint(min(max(seen[x], np.float32(0)), np.float32(1)) * largest))
