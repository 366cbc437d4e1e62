"""From light to codes of a panel, in one pass."""

import torch
import triton.language as tl
from jaxtyping import Float, UInt
from torch import Tensor

from layerfield.kernels.gpu.kernel import blocks, kernel

_BLOCK = 1024


def codes_of(
    values: Float[Tensor, "*batch"], largest: int, dtype: torch.dtype
) -> UInt[Tensor, "*batch"]:
    """Return values from 0 to 1 as whole numbers up to the largest."""
    result = torch.empty(values.shape, dtype=dtype, device=values.device)
    count = values.numel()
    _round[(blocks(count, _BLOCK),)](result, values, float(largest), count, BLOCK=_BLOCK)
    return result


@kernel
def _round(result, values, largest, count, BLOCK: tl.constexpr):
    n = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    value = tl.load(values + n, n < count, 0.0) * largest
    value = tl.minimum(tl.maximum(value, 0.0), largest)
    # To the nearest, and of two as near to the even one: what is added leaves no fraction.
    rounded = (value + 8388608.0) - 8388608.0
    tl.store(result + n, rounded.to(result.dtype.element_ty), n < count)
