"""What a form of writing layers can do: take pictures track by track, and join the parts."""

from collections.abc import Iterable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Protocol, runtime_checkable

from jaxtyping import UInt
from torch import Tensor

PARTS = "parts"  # folder, within that of a video, of what is to be joined

Codes = UInt[Tensor, "c y x"]


@runtime_checkable
class Writer(Protocol):
    """Takes the pictures of one track and one batch."""

    def add(self, number: int, codes: Codes) -> None:
        """Take the next picture, of a frame with this number."""
        ...

    def files(self) -> dict[str, bytes]:
        """Return what was made of them, by the names of files within the folder of the video."""
        ...


@runtime_checkable
class Form(Protocol):
    """A form in which layers are written.

    Attributes:
        title: one phrase for people.
        bits: that it can keep.
        lossy: whether pixels come back changed; sizes are made even then, by repeating an edge.
    """

    @property
    def title(self) -> str: ...

    @property
    def bits(self) -> tuple[int, ...]: ...

    @property
    def lossy(self) -> bool: ...

    def refuse_missing(self) -> None:
        """Refuse a form that needs a package which is not there.

        Raises:
            ValueError: it is not.
        """
        ...

    def begin(self, track: str, first: int, rate: Fraction) -> Writer:
        """Begin a part.

        Args:
            track: name of what is written, as layers/layer_0.
            first: number of the first frame.
            rate: frames a second.
        """
        ...

    def join(
        self, folder: Path, tracks: Iterable[str], firsts: Sequence[int], rate: Fraction
    ) -> None:
        """Join the parts of every track; those joined already are left.

        Args:
            folder: of the video.
            tracks: their names.
            firsts: numbers of the first frames of all batches, in order.
            rate: frames a second.
        """
        ...
