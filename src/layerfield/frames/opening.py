"""The registry of readers of videos; a new one is one file and one line here."""

from pathlib import Path

from layerfield.frames import sequences, videos
from layerfield.frames.source import FrameReader, FrameSource
from layerfield.io import FieldOptions

# The first that accepts a text reads it.
READERS: tuple[FrameReader, ...] = (sequences.PATTERN, sequences.FOLDER, videos.READER)


def open_frames(text: str, options: FieldOptions) -> FrameSource:
    """Find the frames of a light field video.

    Args:
        text: a folder with a light field for each frame, a pattern of files or folders
            (`quilt_%04d.png`, `take-*/frame_*`), or a video of quilts or atlases.
        options: how the light field of each frame is stored, and which part to take.

    Raises:
        ValueError: one line that says what was found, what was expected and what to do.
    """
    for reader in READERS:
        if reader.accepts(text):
            return reader.open(text, options)
    if not Path(text).exists():
        raise ValueError(f"there is no file or folder {text}")
    raise ValueError(
        f"{text} is no video that is known; expected a folder of frames, a pattern such as "
        f"quilt_%04d.png, or a video ({', '.join(suffix[1:] for suffix in videos.SUFFIXES)})"
    )
