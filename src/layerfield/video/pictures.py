"""Layers as PNG, a folder for every frame."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path

from layerfield.io.images import png
from layerfield.video.form import Codes


@dataclass(frozen=True)
class Pictures:
    """PNG, a folder for every frame."""

    title: str = "PNG, a folder for each frame"
    bits: tuple[int, ...] = (8, 16)
    lossy: bool = False

    def refuse_missing(self) -> None:
        """Nothing can be missing."""

    def begin(self, track: str, first: int, rate: Fraction) -> "PictureWriter":
        return PictureWriter(track)

    def join(
        self, folder: Path, tracks: Iterable[str], firsts: Sequence[int], rate: Fraction
    ) -> None:
        """Do nothing: every picture has been in its place from the beginning."""


@dataclass
class PictureWriter:
    """Turns every picture into a file."""

    track: str
    made: dict[str, bytes] = field(default_factory=dict)

    def add(self, number: int, codes: Codes) -> None:
        self.made[f"frame_{number:06d}/{self.track}.png"] = png(codes.cpu())

    def files(self) -> dict[str, bytes]:
        return self.made
