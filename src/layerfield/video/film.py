"""Layers as videos: every batch is a part, the parts are joined without being encoded again.

A Matroska file that was cut short cannot be appended to: so parts are whole files, and the video
is written when all are there.

FFV1 keeps RGB and grey as they are, bit for bit: its 8-bit RGB is called bgr0, that of 16 bits
gbrp16. Its frames are all key frames, so that any is found at once.
"""

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from layerfield.io import whole_file
from layerfield.video.form import PARTS, Codes

if TYPE_CHECKING:
    import av

_BT709, _LIMITED = 1, 1  # as in `io.mp4`
_SAME = {"fflags": "+bitexact"}  # equal packets give equal bytes: no dates, no random numbers
_CONTAINERS = {".mkv": "matroska", ".mp4": "mp4"}
_STORED = {(1, 8): "gray", (3, 8): "rgb24", (1, 16): "gray16le", (3, 16): "rgb48le"}

os.environ.setdefault(
    "SVT_LOG", "1"
)  # only errors: the AV1 encoder tells the terminal its settings


@dataclass(frozen=True)
class Film:
    """A video for each track.

    Args:
        title: one phrase for people.
        bits: that it can keep.
        codec: of FFmpeg.
        suffix: of the files, which says their container.
        pixels: the pixel format for channels and bits.
        options: of the encoder.
        lossy: whether pixels come back changed. Sizes are made even then, by repeating an edge,
            and colours those of BT.709.
    """

    title: str
    bits: tuple[int, ...]
    codec: str
    suffix: str
    pixels: Mapping[tuple[int, int], str]
    options: Mapping[str, str]
    lossy: bool

    def refuse_missing(self) -> None:
        if find_spec("av") is None:
            raise ValueError(
                "writing a video needs PyAV; install it with pip install 'layerfield[video]', or "
                "take --format png"
            )

    def begin(self, track: str, first: int, rate: Fraction) -> "FilmWriter":
        return FilmWriter(self, self.part(track, first), rate)

    def part(self, track: str, first: int) -> str:
        """Return the name of the part of a track that begins with a frame."""
        return f"{PARTS}/{track}-{first:09d}{self.suffix}"

    def join(
        self, folder: Path, tracks: Iterable[str], firsts: Sequence[int], rate: Fraction
    ) -> None:
        for track in tracks:
            path = folder / f"{track}{self.suffix}"
            if not path.is_file():
                path.parent.mkdir(parents=True, exist_ok=True)
                with whole_file(path) as temporary:
                    parts = [(folder / self.part(track, n), n - firsts[0]) for n in firsts]
                    _join(temporary, parts, rate)


class FilmWriter:
    """Encodes pictures into a video in memory."""

    def __init__(self, film: Film, name: str, rate: Fraction) -> None:
        import av  # noqa: PLC0415  an extra

        self._film, self._name, self._rate = film, name, rate
        self._file = BytesIO()
        container = _CONTAINERS[film.suffix]
        self._container = av.open(self._file, "w", format=container, options=_SAME)
        self._stream: av.VideoStream | None = None

    def add(self, number: int, codes: Codes) -> None:
        if self._stream is None:
            self._stream = self._begun(codes)
        self._container.mux(self._stream.encode(_frame(codes, self._film)))

    def files(self) -> dict[str, bytes]:
        if self._stream is not None:
            self._container.mux(self._stream.encode())
        self._container.close()
        return {self._name: self._file.getvalue()}

    def _begun(self, codes: Codes) -> "av.VideoStream":
        import av  # noqa: PLC0415

        film, (channels, height, width) = self._film, codes.shape
        stream = self._container.add_stream(film.codec, rate=self._rate, options=dict(film.options))
        assert isinstance(stream, av.VideoStream)
        stream.height, stream.width = (n + n % 2 * film.lossy for n in (height, width))
        stream.pix_fmt = film.pixels[channels, 8 * codes.element_size()]
        context = stream.codec_context
        context.thread_count = 1  # what encoders make may depend on it
        if film.lossy:
            context.color_primaries = context.color_trc = context.colorspace = _BT709
            context.color_range = _LIMITED
        return stream


def _frame(codes: Codes, film: Film) -> "av.VideoFrame":
    import av  # noqa: PLC0415  an extra

    kind = (codes.shape[0], 8 * codes.element_size())
    pixels = np.ascontiguousarray(np.moveaxis(codes.cpu().numpy(), 0, -1))
    if not film.lossy:
        plain = pixels[..., 0] if kind[0] == 1 else pixels
        stored = av.VideoFrame.from_ndarray(plain, _STORED[kind])
        return stored.reformat(format=film.pixels[kind])
    odd = [(0, n % 2) for n in pixels.shape[:2]]
    rgb = np.pad(np.broadcast_to(pixels, (*pixels.shape[:2], 3)), (*odd, (0, 0)), mode="edge")
    return av.VideoFrame.from_ndarray(rgb, "rgb24").reformat(
        format=film.pixels[kind],
        dst_colorspace="ITU709",
        dst_color_range="MPEG",
        interpolation="AREA",
    )


def _join(path: Path, parts: Sequence[tuple[Path, int]], rate: Fraction) -> None:
    """Write the packets of parts one after the other.

    Args:
        path: of the video.
        parts: files, and the number of the frame that each begins with.
        rate: frames a second.
    """
    import av  # noqa: PLC0415  an extra

    with av.open(str(path), "w", format=_CONTAINERS[path.suffix], options=_SAME) as whole:
        track = None
        for file, first in parts:
            with av.open(str(file)) as part:
                stream = part.streams.video[0]
                track = track or whole.add_stream_from_template(stream, opaque=True)
                frames = (stream.time_base or Fraction(1)) * rate  # in a unit of time
                for packet in part.demux(stream):
                    if packet.pts is None or packet.dts is None:  # the last, which is empty
                        continue
                    packet.pts = first + round(packet.pts * frames)
                    packet.dts = first + round(packet.dts * frames)
                    packet.duration = 1
                    packet.time_base = 1 / rate
                    packet.stream = track
                    whole.mux(packet)
