"""What every reader of videos returns: frames that are known but not yet read."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from typing import Protocol, runtime_checkable

from layerfield.io import FieldOptions
from layerfield.light_field import LightField


@runtime_checkable
class FrameSource(Protocol):
    """The frames of a light field video; can be sent to another process.

    Attributes:
        name: what errors and records call it: the file or folder, no path.
        count: number of frames; of a video that was cut short, as many as it should have.
        rate: frames a second, if the source says.
        notes: what its user may want to know, one sentence each.
    """

    @property
    def name(self) -> str: ...

    @property
    def count(self) -> int: ...

    @property
    def rate(self) -> Fraction | None: ...

    @property
    def notes(self) -> tuple[str, ...]: ...

    def read(self, first: int, stop: int) -> Iterator[LightField]:
        """Read some frames, one after the other, without reading those before.

        Args:
            first: number of the first one, from 0.
            stop: number behind the last one, at most `count`.

        Raises:
            ValueError: a frame that cannot be read.
        """
        ...


@dataclass(frozen=True)
class FrameReader:
    """One way of storing light field videos.

    Args:
        accepts: whether this reader is meant by what the user wrote.
        open: finds the frames.
    """

    accepts: Callable[[str], bool]
    open: Callable[[str, FieldOptions], FrameSource]
