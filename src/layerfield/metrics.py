"""Figures of quality: how well views are shown, and how layers share the light.

PSNR is pooled: one mean square error over all views, channels and pixels, peak 1. Views are not
clipped.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import cv2
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

EXACT = 1e-10  # a mean square error below this is rounding

_STRIP = 64  # rows that fit into the fast memory of a processor
_BELL = [math.exp(-(((i - 5) / 1.5) ** 2) / 2) for i in range(11)]
_WINDOW = np.array(_BELL) / sum(_BELL)

Views = Float[Tensor, "view c y x"]


def decibels(mean_square_error: float) -> float:
    """Return the PSNR of a mean square error for peak 1; infinite for 0."""
    return math.inf if mean_square_error == 0 else -10 * math.log10(mean_square_error)


def finite(record: Any) -> Any:
    """Return figures as JSON can hold them: infinite ones, of what is exact, become None.

    >>> finite({"psnr": math.inf, "psnr_by_view": [30.0, math.inf]})
    {'psnr': None, 'psnr_by_view': [30.0, None]}
    """
    if isinstance(record, Mapping):
        return {key: finite(value) for key, value in record.items()}
    if isinstance(record, list | tuple):
        return [finite(value) for value in record]
    return None if isinstance(record, float) and not math.isfinite(record) else record


def mean_square_error(views: Tensor, target: Tensor) -> float:
    """Return one mean square error over everything, summed up in double precision."""
    squares = (views - target).square()
    return squares.mean(dim=(-2, -1), dtype=torch.float64).mean().item()


def psnr(views: Tensor, target: Tensor) -> float:
    """Return the pooled peak signal-to-noise ratio in dB, peak 1.

    Raises:
        ValueError: views and target differ in shape.

    >>> round(psnr(torch.zeros(25, 3, 8, 8), torch.full((25, 3, 8, 8), 0.1)), 3)
    20.0
    """
    _refuse_unlike(views, target)
    return decibels(mean_square_error(views, target))


def psnr_by_view(views: Views, target: Views) -> list[float]:
    """Return the PSNR of every view in dB."""
    return [psnr(view, wanted) for view, wanted in zip(views, target, strict=True)]


def interior(views: Tensor, margin: tuple[int, int]) -> Tensor:
    """Return views without a border of four times the display's margin, at least 8 pixels.

    Small views keep at least their middle half.
    """
    height, width = views.shape[-2:]
    y, x = (min(max(4 * m, 8), size // 4) for m, size in zip(margin, (height, width), strict=True))
    return views[..., y : height - y, x : width - x]


def excess(mean_square_error: float, reference: float) -> float:
    """Return the excess error MSE / MSE_reference - 1 (0.1 dB is 2.3 %).

    Errors below 1e-10 (100 dB) count as exact, so that rounding is not compared with rounding.
    """
    return max(mean_square_error, EXACT) / max(reference, EXACT) - 1


def ssim(views: Views, target: Views) -> float:
    """Return the mean structural similarity of views clipped to 0..1.

    SSIM = (2 m_v m_w + c)(2 s_vw + d) / ((m_v^2 + m_w^2 + c)(s_v^2 + s_w^2 + d)), c = 0.01^2, d =
    0.03^2, with means, variances and covariance under a Gaussian window (11 pixels, sigma 1.5)
    around every pixel, the views mirrored at their borders.

    Reference: Wang et al., IEEE Trans. Image Processing 13(4), 2004, equation 13.

    Raises:
        ValueError: views and target differ in shape.
    """
    _refuse_unlike(views, target)
    return sum(map(_similarity, views, target)) / len(views)


def _refuse_unlike(views: Tensor, target: Tensor) -> None:
    if views.shape != target.shape:
        raise ValueError(
            f"found views of shape {tuple(views.shape)} and a target of {tuple(target.shape)}, "
            "expected the same"
        )


def _similarity(view: Float[Tensor, "c y x"], wanted: Float[Tensor, "c y x"]) -> float:
    """Go strip by strip: a large picture would take dozens of times its memory."""
    total, around = 0.0, len(_WINDOW) // 2
    for pair in zip(view.clamp(0, 1), wanted, strict=True):
        wide = [np.pad(_array(each), around, mode="reflect") for each in pair]
        for top in range(0, view.shape[-2], _STRIP):
            v, w = (each[top : top + _STRIP + 2 * around] for each in wide)
            mean_v, mean_w = _blurred(v), _blurred(w)
            both, squares = mean_v * mean_w, mean_v**2 + mean_w**2
            covariance = _blurred(v * w) - both
            variances = _blurred(v * v + w * w) - squares
            index = (2 * both + 0.01**2) * (2 * covariance + 0.03**2)
            index /= (squares + 0.01**2) * (variances + 0.03**2)
            total += index.sum(dtype=np.float64).item()
    return total / view.numel()


def _array(values: Float[Tensor, "y x"]) -> Float[np.ndarray, "y x"]:
    """Return values where OpenCV finds them, in single precision at the least."""
    single = torch.promote_types(values.dtype, torch.float32)
    return values.detach().to("cpu", single).contiguous().numpy()


def _blurred(values: Float[np.ndarray, "y x"]) -> Float[np.ndarray, "y2 x2"]:
    """Return the means under the window wherever it fits."""
    around = len(_WINDOW) // 2
    return cv2.sepFilter2D(values, -1, _WINDOW, _WINDOW)[around:-around, around:-around]


class LayerFigures(NamedTuple):
    """How much one layer does.

    Args:
        mean: its share of the light.
        std: standard deviation of its pixels.
        gradient_energy: mean squared difference to the next pixel in y plus that in x.
        peak: its brightest pixel.
    """

    mean: float
    std: float
    gradient_energy: float
    peak: float


def layer_figures(layers: Float[Tensor, "*batch layer c ly lx"]) -> list[LayerFigures]:
    """Return the figures of every layer, front to back."""
    return [
        LayerFigures(
            layer.mean().item(),
            layer.std(correction=0).item(),
            (layer.diff(dim=-1).square().mean() + layer.diff(dim=-2).square().mean()).item(),
            layer.max().item(),
        )
        for layer in layers.unbind(dim=-4)
    ]
