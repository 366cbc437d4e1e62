"""What hardware gets: layers as whole numbers of a panel's bit depth."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, UInt
from torch import Tensor

from layerfield.kernels.codes import codes_of
from layerfield.kernels.compiled import serve
from layerfield.kernels.gpu.serving import on_gpu
from layerfield.transfer import NONE, Gamma, Identity, Srgb, Transfer

_DTYPES = {8: torch.uint8, 16: torch.uint16}


def largest_code(bits: int) -> int:
    """Return the code of full brightness.

    Raises:
        ValueError: not 8 or 16 bits.
    """
    if bits not in _DTYPES:
        raise ValueError(f"found {bits} bits, expected 8 or 16")
    return 2**bits - 1


def quantise(
    layers: Float[Tensor, "*batch c y x"], bits: int, transfer: Transfer = NONE
) -> UInt[Tensor, "*batch c y x"]:
    """Round layers, light from 0 to 1, to the nearest codes of a panel."""
    if on_gpu(layers) and isinstance(transfer, Identity | Srgb | Gamma):
        from layerfield.kernels.gpu.codes import codes_of as codes_on_gpu  # noqa: PLC0415  needs Triton

        power = 1 / transfer.gamma if isinstance(transfer, Gamma) else 1.0
        power = None if isinstance(transfer, Srgb) else power
        return codes_on_gpu(layers, largest_code(bits), _DTYPES[bits], power)
    values = transfer.encode(layers)
    if serve(values):
        return codes_of(values, largest_code(bits), _DTYPES[bits])
    codes = values * largest_code(bits)
    return codes.round_().clamp_(0, largest_code(bits)).to(_DTYPES[bits])


def dequantise(
    codes: UInt[Tensor, "*batch c y x"], transfer: Transfer = NONE
) -> Float[Tensor, "*batch c y x"]:
    """Return the layers, light from 0 to 1, that codes stand for."""
    bits = {dtype: bits for bits, dtype in _DTYPES.items()}[codes.dtype]
    return transfer.decode(codes.to(torch.float32) / largest_code(bits))


@dataclass(frozen=True)
class Response:
    """What the codes of one panel make of light.

    Args:
        bits: 8 or 16.
        transfer: from codes, as values from 0 to 1, to light.
    """

    bits: int
    transfer: Transfer = NONE

    def codes(self, light: Tensor) -> Tensor:
        """Return the nearest codes of light from 0 to 1."""
        return quantise(light, self.bits, self.transfer)

    def light(self, codes: Tensor) -> Tensor:
        """Return the light of codes."""
        return dequantise(codes, self.transfer)
