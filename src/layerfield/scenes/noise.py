"""Noise with the spectrum of photographs."""

import torch
from jaxtyping import Complex, Float
from torch import Tensor

from layerfield.scenes.draws import Draws

_CUT = 0.45  # cycles per pixel; lenses and pixels pass little beyond


def spectral_noise(
    draws: Draws,
    slopes: Float[Tensor, "batch surface"],
    *,
    canvas: tuple[int, int],
    texels: int,
) -> tuple[Float[Tensor, "batch surface ty tx"], Float[Tensor, "batch surface ty tx"]]:
    """Return two independent fields of mean 0 and variance 1 with amplitude spectrum 1 / f^slope.

    They hold no frequency above half a cycle per pixel, so that texels finer than pixels can be
    interpolated linearly. They repeat at the edges of the canvas.

    Args:
        draws: where the numbers come from.
        slopes: of the amplitude spectrum; photographs have about 1.
        canvas: height and width in pixels.
        texels: samples per pixel.
    """
    height, width = canvas
    white = torch.view_as_complex(draws.normal(slopes.shape[1], height, width, 2))
    fy, fx = (torch.fft.fftfreq(n, device=draws.device) for n in canvas)
    frequency = torch.hypot(fy[:, None], fx[None, :])
    frequency[0, 0] = 1
    amplitude = frequency ** -slopes[..., None, None] * torch.exp(-((frequency / _CUT) ** 4))
    amplitude[..., 0, 0] = 0
    amplitude /= amplitude.square().sum(dim=(-2, -1), keepdim=True).sqrt()
    spectrum = _finer(white.mul_(amplitude), texels)
    field = torch.fft.ifft2(spectrum, norm="forward")
    return field.real.contiguous(), field.imag.contiguous()


def _finer(spectrum: Complex[Tensor, "*batch fy fx"], texels: int) -> Tensor:
    """Append empty high frequencies, in the middle where the FFT keeps them."""
    if texels == 1:
        return spectrum
    height, width = spectrum.shape[-2:]
    low_y, low_x = (height + 1) // 2, (width + 1) // 2
    fine = spectrum.new_zeros(*spectrum.shape[:-2], height * texels, width * texels)
    for rows in (slice(None, low_y), slice(low_y - height, None)):
        for columns in (slice(None, low_x), slice(low_x - width, None)):
            fine[..., rows, columns] = spectrum[..., rows, columns]
    return fine
