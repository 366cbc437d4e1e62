"""Frames that are files or folders of their own, each a light field."""

import glob
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import islice, pairwise
from pathlib import Path

from layerfield.frames.source import FrameReader
from layerfield.io import FieldOptions, field_name, load_light_field
from layerfield.io.images import SUFFIXES
from layerfield.io.view_folder import by_numbers
from layerfield.light_field import LightField

_NUMBER = re.compile(r"%(?:0\d+)?d")
_FIELDS = (*SUFFIXES, ".npy", ".npz", ".h5")  # a light field in one file
_NAMED_AT_MOST = 6


@dataclass(frozen=True)
class FrameSequence:
    """Frames in the order of their paths.

    Args:
        name: of the sequence.
        paths: one for each frame; all that `load_light_field` takes.
        options: how each is read.
    """

    name: str
    paths: tuple[Path, ...]
    options: FieldOptions
    rate: Fraction | None = None
    notes: tuple[str, ...] = ()

    @property
    def count(self) -> int:
        """Number of frames."""
        return len(self.paths)

    def read(self, first: int, stop: int) -> Iterator[LightField]:
        for path in self.paths[first:stop]:
            yield load_light_field(path, self.options)


def open_pattern(text: str, options: FieldOptions) -> FrameSequence:
    """Find the frames that a pattern names.

    `%d` or `%04d` stands for a number, none of which may be missing between the first and the last;
    `*`, `?` and `[...]` for anything: what is there is taken, numbers sorted by their value.

    Raises:
        ValueError: nothing fits, numbers are missing, or two numbers in one pattern.
    """
    if _NUMBER.search(text):
        found = _numbered(text)
    else:
        found = sorted(map(Path, glob.glob(text)), key=_in_order)  # noqa: PTH207  may be absolute
    if not found:
        raise ValueError(
            f"no file or folder fits the pattern {text}; check the folder and the name"
        )
    return FrameSequence(Path(text).name, tuple(path.absolute() for path in found), options)


def open_folder(text: str, options: FieldOptions) -> FrameSequence:
    """Find the frames in a folder: its subfolders that end with a number, otherwise its files.

    Raises:
        ValueError: there are none, or numbers are missing.
    """
    folder = Path(text)
    try:
        entries = [path for path in folder.iterdir() if not path.name.startswith(".")]
    except OSError as error:
        raise ValueError(f"cannot read the folder {folder}: {error.strerror}") from None
    frames = [path for path in entries if path.is_dir() and _last_number(path) is not None]
    frames = frames or [
        path for path in entries if path.suffix.lower() in _FIELDS and path.is_file()
    ]
    if not frames:
        raise ValueError(
            f"found no frames in the folder {folder}; expected a folder for each, as frame_0000, "
            "or numbered pictures, .npy, .npz or .h5"
        )
    frames.sort(key=_in_order)
    numbers = [number for path in frames if (number := _last_number(path)) is not None]
    if len(set(numbers)) < len(frames) > 1:
        raise ValueError(
            f"{folder} holds {len(frames)} frames, but not each has a number of its own at the end "
            "of its name; name them as frame_0000, give a pattern with *, or take synth for one "
            "light field"
        )
    _refuse_gaps(text, numbers)
    return FrameSequence(field_name(folder), tuple(path.absolute() for path in frames), options)


PATTERN = FrameReader(
    accepts=lambda text: (
        not Path(text).exists() and (glob.has_magic(text) or _NUMBER.search(text) is not None)
    ),
    open=open_pattern,
)
FOLDER = FrameReader(accepts=lambda text: Path(text).is_dir(), open=open_folder)


def _numbered(pattern: str) -> list[Path]:
    if len(_NUMBER.findall(pattern)) > 1 or glob.has_magic(pattern):
        raise ValueError(f"the pattern {pattern} must hold one %d and no *, ? or [")
    if "%" in _NUMBER.sub("", pattern):
        raise ValueError(f"the pattern {pattern} holds a % that stands for no number; write %04d")
    before, after = _NUMBER.split(pattern)
    fits = re.compile(re.escape(before) + r"(\d+)" + re.escape(after))
    files = {
        int(match[1]): Path(path)
        for path in glob.glob(f"{before}*{after}")  # noqa: PTH207  may be absolute
        if (match := fits.fullmatch(path)) and pattern % int(match[1]) == path
    }
    _refuse_gaps(pattern, list(files))
    return [files[number] for number in sorted(files)]


def _refuse_gaps(source: str, numbers: Sequence[int]) -> None:
    """Refuse frames whose numbers leave some out, be it millions, as times of day do."""
    ordered = sorted(numbers)
    missing = (n for a, b in pairwise(ordered) for n in range(a + 1, b))
    named = list(islice(missing, _NAMED_AT_MOST))
    if named:
        count = ordered[-1] - ordered[0] + 1 - len(ordered)
        more = " ..." if count > len(named) else ""
        raise ValueError(
            f"{source} lacks {count} of the frames {ordered[0]} to {ordered[-1]}: missing "
            f"{', '.join(map(str, named))}{more}; add them, or give a pattern with * for what is "
            "there"
        )


def _last_number(path: Path) -> int | None:
    """The number of a frame; what says how a quilt lies in its picture comes after it."""
    found = re.findall(r"\d+", re.sub(r"_qs\d.*$", "", path.stem))
    return int(found[-1]) if found else None


def _in_order(path: Path) -> list[tuple[int, int, str]]:
    return by_numbers(str(path))
