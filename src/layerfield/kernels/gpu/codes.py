"""From light to codes of a panel, in one pass."""

import torch
import triton.language as tl
from jaxtyping import Float, UInt
from torch import Tensor

from layerfield.kernels.gpu.kernel import blocks, kernel

_BLOCK = 1024


def codes_of(
    light: Float[Tensor, "*batch"], largest: int, dtype: torch.dtype, power: float | None
) -> UInt[Tensor, "*batch"]:
    """Return what makes light from 0 to 1, as whole numbers up to the largest.

    Args:
        light: what is to be made.
        largest: what makes 1.
        dtype: of the whole numbers.
        power: of light, or None for the law of sRGB.
    """
    result = torch.empty(light.shape, dtype=dtype, device=light.device)
    count = light.numel()
    _round[(blocks(count, _BLOCK),)](
        result, light, float(largest), power or 1.0, count, SRGB=power is None,
        GAMMA=power is not None and power != 1, BLOCK=_BLOCK,
    )  # fmt: skip
    return result


@kernel
def _round(
    result, light, largest, power, count, SRGB: tl.constexpr, GAMMA: tl.constexpr,
    BLOCK: tl.constexpr,
):  # fmt: skip
    n = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    value = tl.load(light + n, n < count, 0.0)
    if SRGB:
        knee = 0.04045 / 12.92
        bright = 1.055 * _to_power(tl.maximum(value, knee), 1 / 2.4) - 0.055
        value = tl.where(value <= knee, value * 12.92, bright)
    if GAMMA:
        value = tl.where(value > 0, _to_power(tl.maximum(value, 1e-30), power), 0.0)
    value = tl.minimum(tl.maximum(value * largest, 0.0), largest)
    # To the nearest, and of two as near to the even one: what is added leaves no fraction.
    rounded = (value + 8388608.0) - 8388608.0
    tl.store(result + n, rounded.to(result.dtype.element_ty), n < count)


@kernel
def _to_power(value, power):
    return tl.exp2(power * tl.log2(value))
