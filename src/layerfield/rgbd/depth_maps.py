"""Depth maps from files: how near every pixel is, from 0 to 1."""

from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Num

from layerfield.io.images import SUFFIXES, read_picture
from layerfield.nearest import did_you_mean

KINDS = ("near-white", "near-black", "depth")
_SHAPES_DIFFER = 0.01  # of the aspect, by the rounding of sizes


def read_depth_map(
    path: Path, kind: str, size: tuple[int, int]
) -> tuple[Float32[np.ndarray, "y x"], tuple[str, ...]]:
    """Read how near every pixel of a picture is: 0 the farthest, 1 the nearest.

    Nearness goes with disparity, which is linear in the values of maps of disparity or of inverse
    depth (`near-white`, or `near-black` if small values are near), and linear in 1 / value for
    distances (`depth`). NaN, and distances that are not above 0, stand for pixels without a value.

    Args:
        path: a grey picture of 8 or 16 bits or of floats, or `.npy`.
        kind: one of KINDS.
        size: height and width of the picture; a map of another size but the same shape is resized.

    Returns:
        Nearness, and notes.

    Raises:
        ValueError: no such file, in colour, of another shape, without any values, or all the same.
    """
    if kind not in KINDS:
        raise ValueError(f"unknown kind of map '{kind}'{did_you_mean(kind, KINDS)}")
    values = _read(path).astype(np.float64)
    height, width = values.shape
    if abs(width * size[0] / (height * size[1]) - 1) > _SHAPES_DIFFER:
        raise ValueError(
            f"{path} is {width}x{height} px, but the picture is {size[1]}x{size[0]}; expected a "
            "depth map of the same shape"
        )
    values, notes = _filled(*_nearness(values, kind), path)
    low, high = values.min(), values.max()
    if not high > low:
        raise ValueError(f"{path} holds one value only, expected depths that differ")
    scaled = ((values - low) / (high - low)).astype(np.float32)
    if (height, width) != size:
        scaled = cv2.resize(scaled, size[::-1], interpolation=cv2.INTER_NEAREST)
        notes += (f"the depth map of {width}x{height} px was resized",)
    return scaled, notes


def _read(path: Path) -> Num[np.ndarray, "y x"]:
    if path.suffix.lower() == ".npy":
        values = _read_array(path)
    elif path.suffix.lower() in SUFFIXES or not path.is_file():
        values = read_picture(path).pixels
    else:
        raise ValueError(f"{path} is no depth map that is known; expected a picture or .npy")
    if values.ndim == 3 and (values == values[..., :1]).all():
        values = values[..., 0]
    if values.ndim == 3 and values.shape[-1] == 3:
        raise ValueError(f"{path} is in colour, which tells no depth; expected a grey map")
    if values.ndim != 2 or values.size == 0:
        raise ValueError(f"{path} holds values of shape {values.shape}, expected [y, x]")
    return values


def _read_array(path: Path) -> Num[np.ndarray, "*any"]:
    try:
        values = np.load(path, allow_pickle=False)
    except OSError as error:
        raise ValueError(f"cannot read {path}: {error.strerror or 'it is damaged'}") from None
    except Exception:  # on damaged files NumPy raises whatever it stumbles over
        raise ValueError(f"{path} is no plain NumPy file or is damaged") from None
    if not isinstance(values, np.ndarray) or values.dtype.kind not in "uif":
        raise ValueError(f"{path} holds no numbers, expected one for each pixel")
    return values


def _nearness(
    values: Num[np.ndarray, "y x"], kind: str
) -> tuple[Num[np.ndarray, "y x"], Bool[np.ndarray, "y x"]]:
    """Values that are larger where it is nearer, and whether they are any."""
    if kind == "depth":
        known = values > 0  # not NaN; what is infinitely far has no disparity
        return 1 / np.where(known, values, 1), known
    known = np.isfinite(values)
    return np.where(known, values if kind == "near-white" else -values, 0), known


def _filled(
    values: Num[np.ndarray, "y x"], known: Bool[np.ndarray, "y x"], path: Path
) -> tuple[Num[np.ndarray, "y x"], tuple[str, ...]]:
    """Give pixels without a value that of the nearest pixel with one."""
    if known.all():
        return values, ()
    if not known.any():
        raise ValueError(f"{path} holds no values, expected a depth for most pixels")
    _, found = cv2.distanceTransformWithLabels(
        (~known).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    labels = np.asarray(found, np.int64)
    of_label = np.empty(labels.max() + 1)
    of_label[labels[known]] = values[known]
    missing = f"{1 - known.mean():.1%} of the depth map has no values"
    return of_label[labels], (f"{missing}; they were taken from the nearest pixels that have",)
