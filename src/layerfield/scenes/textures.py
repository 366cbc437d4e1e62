"""Textures of surfaces as two scalar fields: tone (log reflectance) and mix of two colours."""

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import grid_sample

from layerfield.scenes.collage import collage
from layerfield.scenes.draws import Draws
from layerfield.scenes.noise import spectral_noise

_ROUGH, _PATCHY, _COLLAGE, _PATTERN, _MARKS, _PLAIN = range(6)
_SHARES = (0.14, 0.14, 0.38, 0.12, 0.07, 0.15)

Fields = tuple[Float[Tensor, "batch surface ty tx"], Float[Tensor, "batch surface ty tx"]]


def draw_textures(draws: Draws, count: int, *, canvas: tuple[int, int], texels: int) -> Fields:
    """Return tone (log reflectance, natural logarithm, about -1..1) and mix (0..1) of surfaces.

    A texture is a structure (rough, patchy, collage, pattern, marks or plain) plus grain whose
    strength varies from place to place: smooth areas beside detailed ones, as in photographs.

    Args:
        draws: where the numbers come from.
        count: surfaces of a scene.
        canvas: height and width in pixels.
        texels: samples per pixel.
    """
    kinds = draws.choice(_SHARES, count)
    slope = draws.uniform(count, low=1.0, high=1.8)
    grain, other = spectral_noise(draws, slope, canvas=canvas, texels=texels)
    contrast = draws.log_uniform(count, 1, 1, low=0.25, high=1.0)
    detail = draws.log_uniform(count, 1, 1, low=0.03, high=0.35)
    offset = draws.uniform(count, 1, 1, low=-1, high=1)
    tone = _structure(grain, other, kinds, offset)
    mix = torch.sigmoid(2 * other)
    _put(
        tone, mix, kinds, _COLLAGE, lambda n: collage(draws, count, n, canvas=canvas, texels=texels)
    )
    _put(tone, mix, kinds, _PATTERN, lambda n: _patterns(draws, count, n, canvas, texels))
    _put(tone, mix, kinds, _MARKS, lambda n: _marks(draws, count, n, canvas, texels))
    activity = detail * torch.exp((1.2 * other).clamp_(-3, 1.5))
    return torch.addcmul(tone * contrast, activity, grain), mix


def _structure(grain: Tensor, other: Tensor, kinds: Tensor, offset: Tensor) -> Tensor:
    """Tone of the kinds that are noise: rough, patchy (two tones, sharp borders) and plain."""
    kinds = kinds[..., None, None]
    patchy = torch.tanh((grain + offset) * 6)
    tone = torch.where(kinds == _ROUGH, grain, patchy)
    return tone.masked_fill_((kinds != _ROUGH) & (kinds != _PATCHY), 0.0)


def _put(tone: Tensor, mix: Tensor, kinds: Int[Tensor, "batch surface"], kind: int, make) -> None:
    """Replace tone and mix of the surfaces of one kind."""
    chosen = (kinds.flatten() == kind).nonzero()[:, 0]
    new_tone, new_mix = make(chosen)
    tone.flatten(0, 1).index_copy_(0, chosen, new_tone)
    mix.flatten(0, 1).index_copy_(0, chosen, new_mix)


def _patterns(
    draws: Draws, count: int, chosen: Tensor, canvas: tuple[int, int], texels: int
) -> tuple[Tensor, Tensor]:
    """Stripes, checks, tiles with joints, and dots: what people make."""
    kind = draws.choice((0.3, 0.2, 0.3, 0.2), count)
    turn = draws.normal(count) * 0.4
    period = draws.log_uniform(count, low=5, high=0.35 * min(canvas))
    aspect = draws.log_uniform(count, low=0.5, high=1.0)
    duty = draws.uniform(count, low=0.15, high=0.5)
    parameters = (kind, turn, period, aspect, duty)
    kind, turn, period, aspect, duty = (p.flatten()[chosen, None, None] for p in parameters)
    y, x = _texel_centres(canvas, texels, draws.device)
    along = (turn.cos() * x + turn.sin() * y) / period
    across = (turn.cos() * y - turn.sin() * x) / (period * aspect)
    shifted = along + 0.5 * across.floor().remainder(2)  # every second row of tiles moves by half
    wave_x, wave_y = _wave(along, period, duty), _wave(across, period * aspect, duty)
    joint_x = _wave(shifted, period, 0.08)
    joint_y = _wave(across, period * aspect, 0.08)
    dots = (duty - torch.hypot(along.remainder(1) - 0.5, across.remainder(1) - 0.5)) * period * 2
    tone = torch.where(kind == 1, wave_x * wave_y, wave_x)
    tone = torch.where(kind == 2, -torch.maximum(joint_x, joint_y), tone)
    tone = torch.where(kind == 3, dots.clamp(-1, 1), tone)
    return tone, 0.5 + 0.5 * tone


def _wave(phase: Tensor, period: Tensor, duty: Tensor | float) -> Tensor:
    """A square wave of -1 and 1 (1 for the share `duty`), edges one pixel wide."""
    distance = duty / 2 - (phase.remainder(1) - 0.5).abs()
    return (2 * distance * period).clamp_(-1, 1)


def _marks(
    draws: Draws, count: int, chosen: Tensor, canvas: tuple[int, int], texels: int
) -> tuple[Tensor, Tensor]:
    """Lines of fine marks on paper, like print seen from afar."""
    rows, columns = (max(8, n // 2) for n in canvas)
    ink = draws.uniform(count, rows, columns).flatten(0, 1)[chosen]
    row, column = (torch.arange(n, device=draws.device) for n in (rows, columns))
    words = (draws.uniform(count, rows // 4 + 1, columns // 4 + 1) < 0.75).float()
    words = words.flatten(0, 1)[chosen][:, row // 4][:, :, column // 4]
    lines = ((row % 4 > 0) & (row % 32 > 4)).float()[:, None]
    ends = ((column > 0.06 * columns) & (column < 0.94 * columns)).float()
    picture = 2 * (ink < 0.55).float() * words * lines * ends - 1
    turn = (draws.normal(count) * 0.25).flatten()[chosen, None, None]
    scale = draws.log_uniform(count, low=0.6, high=1.2).flatten()[chosen, None, None]
    y, x = _texel_centres(canvas, texels, draws.device)
    across = (turn.cos() * x + turn.sin() * y) * scale * (2 / canvas[1])
    down = (turn.cos() * y - turn.sin() * x) * scale * (2 / canvas[0])
    grid = torch.stack([across, down], dim=-1)
    tone = -grid_sample(picture[:, None], grid, padding_mode="border", align_corners=False)[:, 0]
    return tone, 0.5 + 0.5 * tone


def _texel_centres(
    canvas: tuple[int, int], texels: int, device: torch.device
) -> tuple[Tensor, Tensor]:
    """Return y `[ty, 1]` and x `[1, tx]` of texels, in pixels from the centre of the canvas."""
    y, x = ((torch.arange(n * texels, device=device) + 0.5) / texels - n / 2 for n in canvas)
    return y[:, None], x[None, :]
