"""Light, colour and exposure: from the tone and mix of surfaces to the colours of a photograph."""

import math

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import interpolate, pad

from layerfield.scenes.draws import Draws
from layerfield.scenes.noise import spectral_noise
from layerfield.scenes.scene import pixel_centres
from layerfield.scenes.textures import Fields

_HUES = (
    0.45,
    1.0,
    1.9,
    3.7,
    5.2,
)  # orange and skin, yellow and straw, green, blue, purple; radians
_HUE_SHARES = (0.32, 0.18, 0.2, 0.24, 0.06)

_BLACK = 0.08  # of the encoded value; what is darker is black


def develop(
    draws: Draws, fields: Fields, *, silhouettes: Float[Tensor, "batch surface y x"], texels: int
) -> Float[Tensor, "batch surface 3 ty tx"]:
    """Return the encoded colours, 0 to 1, of lit surfaces.

    linear = exposure * (exp(tone + log light) * ((1 - mix) A + mix B) + highlights)
    encoded = (1 - exp(-linear)) ^ (1 / gamma), the black level taken off

    Args:
        draws: where the numbers come from.
        fields: tone and mix of every surface.
        silhouettes: signed distances in pixels; surface 0 is the background.
        texels: texels per pixel.
    """
    tone, mix = fields
    light, shine = _light(draws, silhouettes), _shine(draws, silhouettes)
    maps = torch.stack([light, shine], dim=2).flatten(1, 2)
    maps = interpolate(maps, scale_factor=texels, mode="bilinear").unflatten(1, (-1, 2))
    first, second, glow = _palette(draws, tone.shape[1])
    exposure = _exposure(draws, first)
    gamma = draws.uniform(1, 1, 1, low=1.7, high=2.3)
    tone = tone.add_(maps[:, :, 0]).exp_().mul_(exposure)
    shine = maps[:, :, 1] * exposure
    colours = tone.new_empty(*tone.shape[:2], 3, *tone.shape[2:])
    for channel in range(3):
        out = torch.addcmul(first[:, :, channel], (second - first)[:, :, channel], mix)
        out.mul_(tone).addcmul_(shine, glow[:, :, channel])
        out = out.neg_().expm1_().neg_().pow_(1 / gamma)
        colours[:, :, channel] = out.sub_(_BLACK).div_(1 - _BLACK).clamp_(0, 1)
    return colours


def _exposure(draws: Draws, reflectance: Tensor) -> Float[Tensor, "batch 1 1 1"]:
    """Cameras expose for what is there, the background above all, but not fully nor always."""
    usual = reflectance[:, :3].mean(dim=(1, 2))[:, None]
    return draws.log_uniform(1, 1, 1, low=0.15, high=1.6) / usual**0.75


def _palette(draws: Draws, count: int) -> tuple[Tensor, Tensor, Tensor]:
    """Two reflectances for every surface and the colour of the light, `[batch, surface, 3, 1, 1]`.

    Hues are those of common things, saturations are mostly low.
    """
    family = draws.choice(_HUE_SHARES, count)
    hue = torch.tensor(_HUES, device=draws.device)[family] + 0.35 * draws.normal(count)
    saturation = draws.uniform(1, low=0.35, high=1.0) * 0.85 * draws.uniform(count) ** 1.7
    level = draws.log_uniform(count, low=0.05, high=0.8)
    first = _reflectance(level, hue, saturation)
    second = _reflectance(
        level * draws.log_uniform(count, low=0.5, high=2.0),
        hue + draws.normal(count) * 0.7,
        saturation * draws.uniform(count, low=0.3, high=1.3),
    )
    warmth = draws.normal(1, 1) * 0.12
    light = torch.cat([1 + warmth, torch.ones_like(warmth), 1 - warmth], dim=-1)
    light = light[..., None, None]
    return first * light, second * light, light.expand_as(first)


def _reflectance(level: Tensor, hue: Tensor, saturation: Tensor) -> Tensor:
    angles = torch.tensor([0.0, 2 * math.pi / 3, 4 * math.pi / 3], device=level.device)
    tint = 1 + saturation[..., None] * torch.cos(hue[..., None] - angles)
    return (level[..., None] * tint)[..., None, None]


def _light(draws: Draws, silhouettes: Tensor) -> Float[Tensor, "batch surface y x"]:
    """Logarithm of the light: a ramp, soft unevenness, dim rims, shadows on the background."""
    count, *canvas = silhouettes.shape[1:]
    height, width = canvas
    y, x = pixel_centres((height, width), silhouettes.device)
    angle = draws.uniform(count, 1, 1, high=2 * math.pi)
    strength = draws.uniform(count, 1, 1, high=0.9)
    ramp = strength * (angle.cos() * x / (width / 2) + angle.sin() * y / (height / 2))
    slope = draws.uniform(count, low=2.0, high=2.6)
    soft, _ = spectral_noise(draws, slope, canvas=(height, width), texels=1)
    uneven = draws.uniform(count, 1, 1, high=0.45) * soft
    rim = draws.uniform(count, 1, 1, high=1.2) * draws.chance(0.6, count, 1, 1)
    depth = 0.08 * min(height, width) * draws.log_uniform(count, 1, 1, low=0.3, high=1.5)
    light = ramp + uneven - rim * torch.exp(-silhouettes.clamp_min(0) / depth)
    light[:, 0] += _shadows(draws, silhouettes[:, 1:])
    return light


def _shadows(draws: Draws, silhouettes: Tensor) -> Float[Tensor, "batch y x"]:
    """Logarithm of the light that foreground surfaces leave to the background."""
    size = min(silhouettes.shape[-2:])
    softness = size * draws.log_uniform(1, 1, low=0.01, high=0.06)
    strength = draws.uniform(1, 1, high=2.0)
    shift = (round(0.06 * size), round(0.04 * size))
    total = silhouettes.new_zeros(len(silhouettes), *silhouettes.shape[-2:])
    for outline in silhouettes.unbind(1):
        total += torch.sigmoid(_moved(outline, shift) / softness)
    return -strength * total.clamp_max_(1)


def _moved(picture: Float[Tensor, "batch y x"], shift: tuple[int, int]) -> Tensor:
    """Move a picture down and to the right; its first row and column fill the gap."""
    height, width = picture.shape[-2:]
    down, right = shift
    return pad(picture[:, None], (right, 0, down, 0), mode="replicate")[:, 0, :height, :width]


def _shine(draws: Draws, silhouettes: Tensor) -> Float[Tensor, "batch surface y x"]:
    """Highlights: a small bright oval with a soft halo on some surfaces."""
    count, height, width = silhouettes.shape[1:]
    y, x = pixel_centres((height, width), silhouettes.device)
    # somewhere well inside the surface: the deepest of a few random places
    place = draws.uniform(2, 8, count)
    rows, columns = (place[:, 0] * height).long(), (place[:, 1] * width).long()
    flat = silhouettes.flatten(2)
    depth = flat.gather(2, (rows * width + columns).transpose(1, 2))
    best = depth.argmax(2, keepdim=True).transpose(1, 2)
    cy = rows.gather(1, best)[:, 0, :, None, None] - (height - 1) / 2
    cx = columns.gather(1, best)[:, 0, :, None, None] - (width - 1) / 2
    radius = min(height, width) * draws.log_uniform(count, 1, 1, low=0.015, high=0.08)
    turn = draws.uniform(count, 1, 1, high=math.pi)
    aspect = draws.log_uniform(count, 1, 1, low=1.0, high=3.0)
    px = turn.cos() * (x - cx) + turn.sin() * (y - cy)
    py = (turn.cos() * (y - cy) - turn.sin() * (x - cx)) * aspect
    distance = torch.hypot(px, py) / radius
    strength = draws.log_uniform(count, 1, 1, low=0.3, high=5.0) * draws.chance(0.4, count, 1, 1)
    core = torch.sigmoid((1 - distance) * 6)
    return strength * (core + 0.15 * torch.exp(-distance))
