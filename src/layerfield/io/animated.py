"""Animations out: one kind of file for each suffix."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from layerfield.io.frames import Counted, Frames
from layerfield.io.gif import write_gif
from layerfield.io.mp4 import write_mp4
from layerfield.io.webp import write_webp
from layerfield.nearest import did_you_mean


@dataclass(frozen=True)
class Kind:
    """A kind of animation.

    Args:
        write: path, frames and frames a second to a file.
        fastest: frames a second; browsers slow down what lasts less than they think possible.
        largest: side of a frame in pixels.
        needs: a package that comes with `layerfield[video]`, if any.
    """

    write: Callable[[Path, Frames, float], None]
    fastest: int
    largest: int
    needs: str | None = None


KINDS = {
    ".mp4": Kind(write_mp4, fastest=240, largest=8192, needs="av"),
    ".webp": Kind(write_webp, fastest=60, largest=16383),
    ".gif": Kind(write_gif, fastest=50, largest=65535),
}


def refuse_animation(path: str | Path, fps: float) -> None:
    """Refuse, before any work is done, an animation that `write_animation` cannot write.

    Raises:
        ValueError: an unknown suffix, too many frames a second, or a package that is missing.
    """
    _kind(Path(path), fps)


def write_animation(
    path: str | Path,
    frames: Frames,
    fps: float,
    tick: Callable[[str, int], None] | None = None,
) -> None:
    """Write an animation that starts again at its end; its kind is that of the suffix.

    One frame after another is asked for, so memory does not grow with their number.

    Args:
        path: in `KINDS`; written in place, see `safe_output` for whole files.
        frames: pictures in turn.
        fps: frames a second.
        tick: called with a word and the number of each frame, from 1.

    Raises:
        ValueError: as `refuse_animation`, or frames that are too large.
    """
    path, kind = Path(path), _kind(Path(path), fps)
    height, width = frames[0].shape[-2:]
    if max(height, width) > kind.largest:
        raise ValueError(
            f"frames are {width}x{height} px, a {path.suffix} holds at most {kind.largest} along "
            "a side; make them smaller"
        )
    kind.write(path, frames if tick is None else Counted(frames, tick), fps)


def _kind(path: Path, fps: float) -> Kind:
    suffix = path.suffix.lower()
    if suffix not in KINDS:
        raise ValueError(
            f"{path} has the suffix '{suffix}' of no animation{did_you_mean(suffix, KINDS)}"
        )
    kind = KINDS[suffix]
    if not 1 <= fps <= kind.fastest:
        raise ValueError(
            f"found {fps:g} frames a second for {path}, expected 1 to {kind.fastest} in a {suffix}"
        )
    if kind.needs is not None and find_spec(kind.needs) is None:
        raise ValueError(
            f"writing a {suffix} needs PyAV; install it with pip install 'layerfield[video]', or "
            "write a .webp"
        )
    return kind
