"""Videos whose every frame is a quilt, an atlas, or a picture taken through lenslets.

An index of all packets is made once; it says how many frames there are and where decoding can
begin, so that a frame in the middle costs no more than those since the last key frame.
"""

import math
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from fractions import Fraction
from importlib.util import find_spec
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Int64, Num

from layerfield.frames.source import FrameReader
from layerfield.io import FieldOptions
from layerfield.io.images import Picture
from layerfield.io.loading import decoded
from layerfield.io.one_picture import views_in_picture
from layerfield.light_field import LightField

if TYPE_CHECKING:
    import av
    import av.container

SUFFIXES = (".mp4", ".m4v", ".mov", ".mkv", ".webm")
_HIGH_DEFINITION = 576  # rows; larger pictures that do not say are taken for BT.709, as by players
_UNSAID = 2  # the number of a matrix that a stream does not tell
_ROUNDING = 0.1  # of a frame, by which times may be too short


@dataclass(frozen=True, eq=False)
class VideoFrames:
    """The frames of a video.

    Args:
        path: of the file.
        options: how views lie in a frame.
        times: of the frames that are there, ascending, in units of the stream.
        starts: the times at which decoding can begin, ascending.
        lost: how many frames are missing at the end, as far as the file says.
        rate: frames a second.
    """

    path: Path
    options: FieldOptions
    times: Int64[np.ndarray, "frame"]
    starts: Int64[np.ndarray, "key"]
    lost: int
    rate: Fraction | None
    notes: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """The file, no path."""
        return self.path.name

    @property
    def count(self) -> int:
        """Number of frames that the file should have."""
        return len(self.times) + self.lost

    def read(self, first: int, stop: int) -> Iterator[LightField]:
        if stop > len(self.times):
            raise ValueError(
                f"{self.path} was cut short: of its {self.count} frames {self.lost} are missing at "
                f"the end; fetch it again, or take those that are there with --frames "
                f"0:{len(self.times)}"
            )
        for number, pixels in enumerate(self._pixels(first, stop), first):
            stored = views_in_picture(self.path, self.options, Picture(pixels))
            yield decoded(stored, self.options, f"{self.name}, frame {number}")

    def _pixels(self, first: int, stop: int) -> Iterator[Num[np.ndarray, "y x c"]]:
        wanted = self.times[first:stop]
        if len(wanted) == 0:
            return
        number = first
        with _opened(self.path) as container:
            for frame in _decoded_from(container, self._start(int(wanted[0])), int(wanted[0])):
                if frame.pts != self.times[number] or frame.is_corrupt:
                    break
                yield _values(frame)
                number += 1
                if number == stop:
                    return
        raise ValueError(
            f"frame {number} of {self.path} is damaged; fetch the file again, or leave the frame "
            f"out with --frames"
        )

    def _start(self, time: int) -> int:
        return int(self.starts[np.searchsorted(self.starts, time, side="right") - 1])


def open_video(text: str, options: FieldOptions) -> VideoFrames:
    """Find the frames of a video, without decoding them.

    Raises:
        ValueError: PyAV is missing, or the file holds no video or is damaged.
    """
    if find_spec("av") is None:
        raise ValueError(
            "reading a video needs PyAV; install it with pip install 'layerfield[video]'"
        )
    path = Path(text).absolute()
    with _opened(path) as container:
        stream = container.streams.video[0]
        index, rate = _index(container, path), stream.average_rate or stream.guessed_rate
        times = np.unique(np.array(index.times, np.int64))
        sound = [f"the sound of {path.name} is left out"] if container.streams.audio else []
        return VideoFrames(
            path,
            options,
            times,
            np.unique(np.array(index.keys, np.int64)),
            _lost(stream, index, rate),
            rate,
            (*sound, *_gaps(times, (stream.time_base or 1) * (rate or 0), path.name)),
        )


READER = FrameReader(
    accepts=lambda text: Path(text).suffix.lower() in SUFFIXES and Path(text).is_file(),
    open=open_video,
)


@contextmanager
def _opened(path: Path) -> "Iterator[av.container.InputContainer]":
    """Open a video; whatever the decoder stumbles over becomes one line."""
    import av  # noqa: PLC0415  an extra
    from av.error import FFmpegError  # noqa: PLC0415

    try:
        with av.open(str(path)) as container:
            if not container.streams.video or not container.streams.video[0].height:
                raise ValueError(f"{path} holds no video; expected one of quilts or atlases")
            yield container
    except (FFmpegError, IndexError) as error:
        reason = getattr(error, "strerror", None) or "nothing in it can be decoded"
        raise ValueError(
            f"{path} is damaged, cut short or no video ({reason}); fetch it again"
        ) from None


class _Index(NamedTuple):
    """When frames are shown, in the order of their packets, how long, and which are key frames."""

    times: list[int]
    lengths: list[int]
    keys: list[int]


def _index(container: "av.container.InputContainer", path: Path) -> _Index:
    """Go through the packets without decoding them, up to where the file ends."""
    found = _Index([], [], [])
    with suppress(OSError, ValueError):  # what is behind a damage counts as lost
        for packet in container.demux(container.streams.video[0]):
            if packet.size and packet.pts is not None and not packet.is_corrupt:
                found.times.append(packet.pts)
                found.lengths.append(packet.duration or 0)
                if packet.is_keyframe:
                    found.keys.append(packet.pts)
    if not found.keys:
        raise ValueError(f"{path} holds no frame that can be decoded; fetch it again")
    return found


def _lost(stream: "av.VideoStream", index: _Index, rate: Fraction | None) -> int:
    """How many frames a file says it has beyond those that are there."""
    if stream.frames:
        return max(0, stream.frames - len(index.times))
    told = re.match(r"(\d+):(\d+):(\d+(?:\.\d+)?)", stream.metadata.get("DURATION", ""))
    if told is None or rate is None:
        return 0
    last = max(range(len(index.times)), key=index.times.__getitem__)
    unit = stream.time_base or Fraction(1)
    end = index.times[last] * unit + (index.lengths[last] * unit or 1 / rate)
    promised = 3600 * int(told[1]) + 60 * int(told[2]) + Fraction(told[3])
    return max(0, math.floor((promised - end) * rate + _ROUNDING))


def _gaps(times: Int64[np.ndarray, "frame"], frames: Fraction | int, name: str) -> list[str]:
    """Tell of frames that are missing between others; frames: of a unit of time."""
    skipped = np.round(np.diff(times) * float(frames)).astype(int) - 1
    if (skipped < 1).all():
        return []
    where = int(np.argmax(skipped))
    return [
        f"{name} shows no frames for a while, the longest {skipped[where]} frames behind frame "
        f"{where}: it is damaged, or its rate varies; what is made has one rate and no gaps"
    ]


def _decoded_from(
    container: "av.container.InputContainer", start: int, first: int
) -> "Iterator[av.VideoFrame]":
    """Decode from a key frame on, or from the beginning where seeking goes past it."""
    stream = container.streams.video[0]
    for place in (start, None):
        container.seek(0) if place is None else container.seek(place, stream=stream)
        frames = container.decode(stream)
        early = next(frames, None)
        if early is not None and early.pts is not None and early.pts <= first:
            yield from (f for f in chain([early], frames) if f.pts is None or f.pts >= first)
            return


def _values(frame: "av.VideoFrame") -> Num[np.ndarray, "y x c"]:
    """Return a frame as RGB or grey, in 8 bits, or in 16 where it has more than 8."""
    deep = max(component.bits for component in frame.format.components) > 8
    if not frame.format.is_rgb and len(frame.format.components) == 1:
        return frame.to_ndarray(format="gray16le" if deep else "gray")[..., None]
    large = frame.colorspace == _UNSAID and frame.height > _HIGH_DEFINITION
    matrix = "ITU709" if large and not frame.format.is_rgb else None
    rgb = frame.reformat(format="rgb48le" if deep else "rgb24", src_colorspace=matrix)
    return rgb.to_ndarray()
