"""MP4: H.264 as every browser plays it, good enough that stills are hardly told apart."""

from fractions import Fraction
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from layerfield.io.frames import Frames, pixels

_QUALITY = {"crf": "14", "preset": "slow"}
_BT709 = 1  # the number of these primaries, of this curve and of this matrix alike
_LIMITED = 1  # luma from 16 to 235; browsers take nothing else for granted


def write_mp4(path: Path, frames: Frames, fps: float) -> None:
    """Write frames as H.264 in 4:2:0, which has even sizes only: odd ones repeat an edge.

    The stream says that it is BT.709. Left unsaid, players guess by the size of the picture, and
    small ones come out in the colours of old television.
    """
    import av  # noqa: PLC0415  an extra

    rate = Fraction(fps).limit_denominator(1001)
    with av.open(str(path), "w", options={"movflags": "+faststart"}) as container:
        stream = container.add_stream("libx264", rate=rate, options=_QUALITY)
        stream.height, stream.width = (n + n % 2 for n in frames[0].shape[-2:])
        stream.pix_fmt = "yuv420p"
        context = stream.codec_context
        context.color_primaries = context.color_trc = context.colorspace = _BT709
        context.color_range = _LIMITED
        for i in range(len(frames)):
            rgb = av.VideoFrame.from_ndarray(_even(pixels(frames[i])), "rgb24")
            container.mux(
                stream.encode(
                    rgb.reformat(
                        format="yuv420p",
                        dst_colorspace="ITU709",
                        dst_color_range="MPEG",
                        interpolation="AREA",
                    )
                )
            )
        container.mux(stream.encode())


def _even(rgb: UInt8[np.ndarray, "y x 3"]) -> UInt8[np.ndarray, "y2 x2 3"]:
    height, width, _ = rgb.shape
    return np.pad(rgb, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
