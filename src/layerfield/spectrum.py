"""How well layers can show a light field, in closed form: one small matrix per frequency.

On a torus and without bounds on the layers, frequencies do not know of each other. The views'
spectrum v(f), one number a view, is projected on the column space of A(f):

    error(f) = ||v - A p||^2,   p = R b,   R = (G + e N I)^-1,   b = A^H v,   G = A^H A
             = ||v||^2 - b^H (R + e N R^2) b                     with N views

b and G depend on the disparities of the layers, entry by entry. With tables of both for pairs of
disparities, the error of a display is a sum over some thousands of frequencies.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Complex, Float, Int
from torch import Tensor

from layerfield.frequencies import inverse
from layerfield.geometry import grid_points
from layerfield.light_field import LightField
from layerfield.links import Link
from layerfield.projection import response

FREQUENCIES = 2048  # drawn from those of a light field
# Layers with bounds cannot avoid small errors by large pixels: e. It and the taper are the best of
# a few on procedural scenes, judged by solving.
_PRICE = 0.015
_TAPER = 0.05  # of the image, at each border
_AT_ONCE = 1 << 20  # numbers in the matrices that are inverted together


@dataclass(frozen=True, eq=False)
class Spectrum:
    """The views of a light field at some frequencies, in the domain where the link is a sum.

    Args:
        grid: (rows, columns) of the views.
        values: v(f), without the mean over views and pixels, which any display can show.
        along_y: frequencies, cycles per pixel.
        along_x: the same.
        weights: mean square error = sum_f weights * error(f).

    In double precision: what layers cannot show is a small difference of large numbers.
    """

    grid: tuple[int, int]
    values: Complex[Tensor, "view c f"]
    along_y: Float[Tensor, " f"]
    along_x: Float[Tensor, " f"]
    weights: Float[Tensor, " f"]

    def thinned(self, every: int) -> "Spectrum":
        """Return each so-manieth frequency, which stands for those left out."""
        return Spectrum(
            self.grid,
            self.values[..., ::every],
            self.along_y[::every],
            self.along_x[::every],
            self.weights[::every] * every,
        )


def spectrum(
    field: LightField, link: Link, *, centre: float = 0.0, count: int = FREQUENCIES
) -> Spectrum:
    """Return the spectrum of a light field, at frequencies drawn by how much views differ there.

    A torus joins opposite borders, so views fade out toward them. What fades moves with
    points of disparity `centre`: others fade in one view a little earlier than in the next.

    Args:
        field: the views.
        link: of the display. Errors in the domain where it is a sum are taken for errors of
            light of the root mean square of the views.
        centre: pixels per view step.
        count: of frequencies to draw.
    """
    height, width = field.size
    light = link.to_sum(field.views)
    mean = light.mean(dim=(0, 2, 3))[:, None, None]
    values, energy = [], 0.0
    for view, (x, y) in zip(light, grid_points(field.grid), strict=True):
        window = _window(height, y * centre)[:, None] * _window(width, x * centre)
        values.append(torch.fft.rfft2((view - mean) * window).flatten(-2))
        energy += window.square().sum().item()
    counted = _counted(width).repeat(height)
    chosen, times = _drawn(_differences(values) * counted, count)
    bright = 1.0 if link.is_sum else field.views.square().mean().item()
    columns = width // 2 + 1
    return Spectrum(
        grid=field.grid,
        values=torch.stack([view[:, chosen] for view in values]).to(torch.complex128),
        along_y=torch.fft.fftfreq(height, dtype=torch.float64)[chosen // columns],
        along_x=torch.fft.rfftfreq(width, dtype=torch.float64)[chosen % columns],
        weights=times * counted[chosen] * (bright / (height * width * len(mean) * energy)),
    )


def _window(length: int, shift: float) -> Float[Tensor, " n"]:
    """Return a window that rises and falls at its ends as a cosine, moved by some pixels."""
    place = (torch.arange(length) + 0.5 + shift) / length
    edge = (torch.minimum(place, 1 - place) / _TAPER).clamp(0, 1)
    return 0.5 - 0.5 * torch.cos(math.pi * edge)


def _counted(width: int) -> Float[Tensor, " f"]:
    """How often a column of `rfft2` is there: the mirrored half is left out."""
    counted = torch.full((width // 2 + 1,), 2.0)
    counted[0] = 1
    if width % 2 == 0:
        counted[-1] = 1
    return counted


def _differences(values: Sequence[Complex[Tensor, "c f"]]) -> Float[Tensor, " f"]:
    """Return the energy of what views do not have in common."""
    common, power = torch.zeros_like(values[0]), torch.zeros_like(values[0].real)
    for view in values:
        common += view
        power += view.real.square() + view.imag.square()
    return (power - common.abs().square() / len(values)).sum(dim=0).clamp(min=0)


def _drawn(
    energy: Float[Tensor, " f"], count: int
) -> tuple[Int[Tensor, " n"], Float[Tensor, " n"]]:
    """Draw places, half by energy and half evenly; return them and how many each stands for."""
    energy = energy.double()
    even = torch.full_like(energy, 1 / len(energy))
    total = energy.sum()
    chance = (energy / total + even) / 2 if total > 0 else even
    steps = (torch.arange(count, dtype=torch.float64) + 0.5) / count
    found = torch.searchsorted(chance.cumsum(0), steps).clamp(max=len(energy) - 1)
    chosen, times = found.unique(return_counts=True)
    return chosen, times / count / chance[chosen]


class Errors:
    """Mean square errors of displays whose layers are at some of these disparities.

    Args:
        given: the spectrum of a light field.
        disparities: in pixels per view step.
    """

    def __init__(self, given: Spectrum, disparities: Sequence[float]) -> None:
        along_y = _columns(given.grid[0], given.along_y, disparities)
        along_x = _columns(given.grid[1], given.along_x, disparities)
        back = _back_projected(given, along_y, along_x)
        # Centred grids make G real, so that of b b^H only the real part counts.
        self.gram = (_products(along_y) * _products(along_x)).real.contiguous()
        self.back = _products(back * given.weights.sqrt()).real.contiguous()
        self.power = given.values.abs().square().sum(dim=(0, 1)) * given.weights
        self.price = _PRICE * len(given.values)

    def __call__(self, chosen: Int[Tensor, "n layer"]) -> Float[Tensor, " n"]:
        """Return the errors of displays, each given by the places of its layers."""
        at_once = max(1, _AT_ONCE // (chosen.shape[1] ** 2 * len(self.power)))
        shown = torch.cat([self._shown(part) for part in chosen.split(at_once)])
        return (self.power.sum() - shown).clamp(min=0)

    def _shown(self, chosen: Int[Tensor, "n layer"]) -> Float[Tensor, " n"]:
        pairs = chosen.T[:, None], chosen.T[None, :]
        return (_shown(self.gram[pairs], self.price) * self.back[pairs]).sum(dim=(0, 1, 3))


def _shown(gram: Float[Tensor, "k k n f"], price: float) -> Float[Tensor, "k k n f"]:
    """Return R + price R^2, whose quadratic form in b is the energy that layers can show."""
    priced = gram.clone()
    for k in range(len(gram)):
        priced[k, k] += price
    right = inverse(priced)
    return right + price * torch.stack([(row[:, None] * right).sum(dim=0) for row in right])


def predicted_error(given: Spectrum, disparities: Sequence[float]) -> float:
    """Return the mean square error to expect of layers at these disparities."""
    return Errors(given, disparities)(torch.arange(len(disparities))[None]).item()


def contrast(
    layers: Sequence[float],
    views: int,
    disparities: Float[Tensor, " d"],
    frequencies: Float[Tensor, " f"],
) -> Float[Tensor, "d f"]:
    """Return the contrast with which a display shows gratings that move from view to view.

    v_i = exp(2 pi i f d x_i) at view x_i; the share of its energy in the column space of A(f),
    which is also the contrast, averaged over the views, of what is shown.

    Args:
        layers: disparities of the display, pixels per view step.
        views: along the grating's direction.
        disparities: of gratings, pixels per view step.
        frequencies: of gratings, cycles per pixel.
    """
    columns = _columns(views, frequencies, layers)
    steps = disparities.new_tensor([x for x, _ in grid_points((1, views))])
    turns = disparities[:, None, None] * steps[:, None] * frequencies
    gratings = torch.exp(2j * math.pi * turns)
    back = torch.einsum("knf,dnf->kdf", columns.conj(), gratings)
    shares = _shown(_products(columns).real.unsqueeze(2), _PRICE * views)
    shares = shares.squeeze(2).to(back.dtype)
    return torch.einsum("kdf,klf,ldf->df", back.conj(), shares, back).real / views


def _columns(
    count: int, frequencies: Float[Tensor, " f"], disparities: Sequence[float]
) -> Complex[Tensor, "d n f"]:
    """Return what the views along one direction see of each frequency of a layer."""
    steps = [x for x, _ in grid_points((1, count))]
    rows = [torch.stack([response(x * d, frequencies) for x in steps]) for d in disparities]
    return torch.stack(rows)


def _back_projected(
    given: Spectrum, along_y: Complex[Tensor, "d y f"], along_x: Complex[Tensor, "d x f"]
) -> Complex[Tensor, "d c f"]:
    """Return b = A^H v of every disparity."""
    values = given.values.unflatten(0, given.grid)
    rows = [(values * y.conj()[:, None, None]).sum(dim=0) for y in along_y]
    return torch.stack(
        [(row * x.conj()[:, None]).sum(dim=0) for row, x in zip(rows, along_x, strict=True)]
    )


def _products(columns: Complex[Tensor, "d n f"]) -> Complex[Tensor, "d d f"]:
    """Return sum_n conj(a_n) a_n of all pairs of columns."""
    by_frequency = columns.permute(2, 0, 1)
    return (by_frequency.conj() @ by_frequency.mT).permute(1, 2, 0)
