"""Pictures in and out: 8 and 16 bit, grey and RGB."""

import io
import warnings
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float32, Num
from PIL import Image, UnidentifiedImageError
from torch import Tensor

SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".webp", ".bmp")
_FORMATS = ("PNG", "JPEG", "TIFF", "WEBP", "BMP")
_ALPHA_DROPPED = "the alpha channel was dropped"
_TIFF_BITS = 258  # the TIFF tag BitsPerSample


@dataclass(frozen=True, eq=False)
class Picture:
    """A decoded picture as stored: uint8, uint16 or floats, 1 or 3 channels last."""

    pixels: Num[np.ndarray, "y x c"]
    notes: tuple[str, ...] = ()


def read_image(path: str | Path) -> Float32[np.ndarray, "c y x"]:
    """Read a picture, dropping an alpha channel.

    Args:
        path: PNG, JPEG, TIFF, WebP or BMP.

    Returns:
        Values from 0 to 1, one channel or RGB.

    Raises:
        ValueError: no such file, not a picture, a truncated one, or a kind that is not supported.
    """
    return to_floats(read_picture(Path(path)).pixels, str(path))


def read_picture(path: Path) -> Picture:
    """Read a picture in its own depth; arguments and errors as in `read_image`."""
    data = _read_bytes(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about metadata, or a large picture short of the limit
            return _decode(data, path)
    except (ValueError, MemoryError) as error:
        raise ValueError(f"{path}: {_first_line(error) or 'too large for the memory'}") from None
    except Image.DecompressionBombError:
        limit = 2 * (Image.MAX_IMAGE_PIXELS or 0) // 10**6
        raise ValueError(f"{path} has more than {limit} million pixels, the most we read") from None
    except UnidentifiedImageError:
        raise ValueError(f"{path} is not a picture; expected {', '.join(_FORMATS)}") from None
    except Exception as error:  # on damaged files decoders raise whatever they stumble over
        raise ValueError(
            f"{path} is damaged or truncated ({_first_line(error)}); fetch or write it again"
        ) from None


def select_channels(
    pixels: Num[np.ndarray, "*view_y_x c"], source: str
) -> tuple[Num[np.ndarray, "*view_y_x kept"], tuple[str, ...]]:
    """Drop alpha.

    Args:
        pixels: channels last.
        source: what an error calls the picture.

    Returns:
        The pixels with 1 or 3 channels, and a note if there was alpha.

    Raises:
        ValueError: not 1 to 4 channels.
    """
    channels = pixels.shape[-1]
    if channels not in (1, 2, 3, 4):
        raise ValueError(f"{source} has {channels} channels, expected 1 (grey) or 3 (RGB)")
    if channels in (2, 4):
        return pixels[..., : channels - 1], (_ALPHA_DROPPED,)
    return pixels, ()


def to_planes(pixels: Num[np.ndarray, "y x c"], source: str) -> Num[np.ndarray, "c y x"]:
    """Return stored values with the channels first: whole numbers as they are, others as floats.

    Arguments and errors as in `to_floats`.
    """
    if pixels.dtype in (np.uint8, np.uint16):
        return np.ascontiguousarray(np.moveaxis(pixels, -1, 0))
    return to_floats(pixels, source)


def to_floats(pixels: Num[np.ndarray, "y x c"], source: str) -> Float32[np.ndarray, "c y x"]:
    """Bring stored values to the range from 0 to 1.

    Args:
        pixels: uint8, uint16, or floats that are in that range already.
        source: what an error calls the picture.

    Raises:
        ValueError: another type of number, or floats that are out of range or not finite.
    """
    planes = np.ascontiguousarray(np.moveaxis(pixels, -1, 0))
    if pixels.dtype in (np.uint8, np.uint16):
        return planes.astype(np.float32) / np.float32(np.iinfo(pixels.dtype).max)
    if pixels.dtype.kind != "f":
        raise ValueError(f"{source} holds {pixels.dtype}, expected uint8, uint16 or floats 0 to 1")
    low, high = float(planes.min()), float(planes.max())
    if not np.isfinite([low, high]).all():
        raise ValueError(f"{source} holds values that are not finite (NaN or infinite)")
    if low < 0 or high > 1:
        raise ValueError(
            f"{source} holds values from {low:g} to {high:g}, expected 0 to 1; divide them by "
            "their maximum or store them as uint8"
        )
    return planes.astype(np.float32)


def write_png(path: str | Path, pixels: np.ndarray | Tensor) -> None:
    """Write an 8 or 16 bit PNG; equal pixels give equal bytes.

    Args:
        path: where; written in place, see `safe_output` for whole files.
        pixels: uint8 or uint16, `[c, y, x]`, one channel or RGB.

    Raises:
        ValueError: another shape or type, or the file cannot be written.
    """
    content = png(pixels, str(path))
    try:
        Path(path).write_bytes(content)
    except OSError as error:
        raise ValueError(f"cannot write {path}: {error.strerror}") from None


def png(pixels: np.ndarray | Tensor, name: str = "a picture") -> bytes:
    """Return the bytes of an 8 or 16 bit PNG; arguments and errors as in `write_png`."""
    array = pixels.detach().cpu().numpy() if isinstance(pixels, Tensor) else pixels
    if array.dtype not in (np.uint8, np.uint16):
        raise ValueError(
            f"found {array.dtype} for {name}, expected uint8 or uint16; quantise first"
        )
    if array.ndim != 3 or array.shape[0] not in (1, 3) or 0 in array.shape:
        raise ValueError(f"found shape {array.shape} for {name}, expected [1 or 3, y, x]")
    blue_first = np.ascontiguousarray(np.moveaxis(array[::-1], 0, -1))
    done, data = cv2.imencode(".png", blue_first)
    if not done:
        raise ValueError(f"cannot encode {name} as PNG")
    return data.tobytes()


def _read_bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise ValueError(f"cannot read {path}: {error.strerror}") from None


def _first_line(error: BaseException) -> str:
    return str(error).partition("\n")[0].strip()


def _decode(data: bytes, path: Path) -> Picture:
    with Image.open(io.BytesIO(data), formats=_FORMATS) as image:
        frames = getattr(image, "n_frames", 1)
        if frames > 1 and image.format != "MPO":  # a camera's JPEG with a preview behind it
            raise ValueError(f"found {frames} pictures in one file, expected a single one")
        bits = _bits(image, data)
        image.load()  # pillow notices truncated files, OpenCV does not
        if bits == 16 and not image.mode.startswith("I;16"):
            pixels = _decode_deep(data)
        else:
            pixels = np.asarray(_plain(image))
        transparent = "transparency" in image.info
    pixels = pixels[..., None] if pixels.ndim == 2 else pixels
    if 0 in pixels.shape:
        raise ValueError(f"found a picture of size {pixels.shape[1]}x{pixels.shape[0]}")
    pixels, notes = select_channels(pixels, path.name)
    return Picture(pixels, notes or ((_ALPHA_DROPPED,) if transparent else ()))


def _bits(image: Image.Image, data: bytes) -> int:
    if image.format == "PNG":
        return data[24]  # IHDR is the first chunk by the standard; pillow has checked it
    bits = image.tag_v2.get(_TIFF_BITS, 8) if image.format == "TIFF" else 8  # pyright: ignore[reportAttributeAccessIssue]
    return max(bits) if isinstance(bits, tuple) else int(bits)


def _decode_deep(data: bytes) -> np.ndarray:
    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if pixels is None or pixels.dtype != np.uint16:
        raise ValueError("found a 16-bit picture of a kind that is not supported; save it as PNG")
    if pixels.ndim == 3 and pixels.shape[-1] >= 3:
        pixels[..., :3] = pixels[..., 2::-1].copy()  # OpenCV has blue first
    return pixels


def _plain(image: Image.Image) -> Image.Image:
    if image.mode in ("L", "LA", "RGB", "RGBA", "F") or image.mode.startswith("I;16"):
        return image
    if image.mode == "I":
        raise ValueError("found a picture with 32-bit integers, expected 8 or 16 bit")
    return image.convert("L" if image.mode == "1" else "RGB")
