"""Animated WebP: one lossy picture after another.

Written frame by frame, after https://developers.google.com/speed/webp/docs/riff_container:
Pillow would keep all of them, and drop those that are alike.
"""

from io import BytesIO
from pathlib import Path

from PIL import Image

from layerfield.io.frames import Frames, durations, picture

_QUALITY = 90
_ANIMATED, _OPAQUE = 0x02, 0x02  # flags of the file, and of a frame: not blended with the last
_HEADER = 12  # bytes: RIFF, length, WEBP


def write_webp(path: Path, frames: Frames, fps: float) -> None:
    """Write frames as an endless animation; they last whole milliseconds."""
    height, width = frames[0].shape[-2:]
    size = _number(width - 1, 3) + _number(height - 1, 3)
    with path.open("wb") as file:
        file.write(b"RIFF" + _number(0, 4) + b"WEBP")
        file.write(_chunk(b"VP8X", _number(_ANIMATED, 4) + size))
        file.write(_chunk(b"ANIM", _number(0, 4) + _number(0, 2)))  # black behind, no last round
        for i, duration in enumerate(durations(len(frames), fps, 1000)):
            place = _number(0, 6) + size + _number(duration, 3) + _number(_OPAQUE, 1)
            file.write(_chunk(b"ANMF", place + _encoded(picture(frames[i]))))
        length = file.tell()
        file.seek(4)
        file.write(_number(length - 8, 4))


def _encoded(still: Image.Image) -> bytes:
    """Return the chunk with the pixels."""
    file = BytesIO()
    still.save(file, "WEBP", quality=_QUALITY, method=4)
    return file.getvalue()[_HEADER:]


def _chunk(name: bytes, data: bytes) -> bytes:
    return name + _number(len(data), 4) + data + bytes(len(data) % 2)


def _number(value: int, length: int) -> bytes:
    return value.to_bytes(length, "little")
