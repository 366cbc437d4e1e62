"""What is to be made of a light field video, and the batches that it is made in.

A batch is the unit of work: numbers of frames alone decide where it begins and ends, and what comes
out of it depends on nothing else than the job. So it does not matter who makes it, nor when.
"""

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from typing import Any, NamedTuple

import torch

from layerfield.display import Display
from layerfield.display_spec import Spec
from layerfield.frames.source import FrameSource
from layerfield.light_field import LightField
from layerfield.provenance import provenance
from layerfield.stream import run_in
from layerfield.synthesizer import find_method

BATCH = 32  # frames


class Batch(NamedTuple):
    """Frames that are made together: the number of the first, and the one behind the last."""

    first: int
    stop: int


@dataclass(frozen=True, eq=False, kw_only=True)
class Job:
    """What is made of which frames, and how; can be sent to another process.

    Args:
        source: the frames.
        frames: number of the first one and of the one behind the last.
        spec: of the display.
        method: as `synthesize_frames` takes it.
        iterations: of every frame that has one before.
        form: name of one of `FORMS`.
        bits: of the layers, 8 or 16.
        rounding: "joint" or "nearest".
        rate: frames a second of what is written.
        length: frames of a batch.
        device: "cpu" or "cuda".

    Raises:
        ValueError: no frames, or ones that the source does not have.
    """

    source: FrameSource
    frames: tuple[int, int]
    spec: Spec
    method: str
    iterations: int
    form: str
    bits: int
    rounding: str
    rate: Fraction
    length: int = BATCH
    device: str = "cpu"

    def __post_init__(self) -> None:
        first, stop = self.frames
        if not 0 <= first < stop <= self.source.count:
            raise ValueError(
                f"frames is {first}:{stop}, but {self.source.name} has {self.source.count}; "
                f"expected first:stop within 0:{self.source.count}"
            )

    @property
    def batches(self) -> list[Batch]:
        """The batches, whose borders are multiples of their length.

        A batch may begin in the middle of one where the frames do.
        """
        first, stop = self.frames
        starts = range(first - first % self.length, stop, self.length)
        return [Batch(max(first, n), min(stop, n + self.length)) for n in starts]

    def count_without(self, batches: Sequence[Batch]) -> int:
        """Return how many frames all other batches have."""
        return self.frames[1] - self.frames[0] - sum(stop - first for first, stop in batches)

    @cached_property
    def display(self) -> Display:
        """What shows the layers."""
        return Display(self.spec)

    @property
    def run_in(self) -> int:
        """Frames that are made before those of a batch, and thrown away."""
        return run_in(find_method(self.method), self.display)

    @property
    def tracks(self) -> list[str]:
        """Names of what is written: a picture of each in every frame."""
        count, subframes = self.display.layer_count, self.display.subframes
        return [
            *_named("layers", "layer", count, subframes),
            *_named("panels", "panel", len(self.display.panels), subframes),
        ]

    @cached_property
    def opening(self) -> LightField:
        """The first frame; all others must be like it."""
        return next(self.source.read(self.frames[0], self.frames[0] + 1))

    def fields(self, first: int, stop: int) -> Iterator[LightField]:
        """Read frames onto the device.

        Raises:
            ValueError: a frame that cannot be read, or is of another size than the first.
        """
        expected = _kind(self.opening)
        for number, field in enumerate(self.source.read(first, stop), first):
            if _kind(field) != expected:
                raise ValueError(
                    f"frame {number} of {self.source.name} has {_kind(field)}, the first has "
                    f"{expected}; all frames must be alike, so make a video of each part"
                )
            yield replace(field, stored=field.stored.to(self.device))

    def facts(self) -> dict[str, Any]:
        """Return what decides on the layers, for their record."""
        here = provenance(torch.device("cpu"))  # workers may have what this process has not
        known = {name: here[name] for name in ("layerfield", "torch", "processor")}
        return {
            "input": self.source.name,
            "frames": list(self.frames),
            "first_frame": {
                "kind": _kind(self.opening),
                "sha256": hashlib.sha256(self.opening.stored.numpy().tobytes()).hexdigest(),
            },
            "display": self.spec.model_dump(mode="json", exclude_defaults=True),
            "margin": list(self.display.margin),
            "method": find_method(self.method).title,
            "iterations": self.iterations,
            "format": self.form,
            "bits": self.bits,
            "rounding": self.rounding if self.bits == 8 else "nearest",
            "fps": str(self.rate),
            "batch": self.length,
            "run_in": self.run_in,
            "seed": None,  # nothing here is random
            "made_with": known | {"device": self.device},
        }


def _named(folder: str, name: str, count: int, subframes: int) -> list[str]:
    places = [folder] if subframes == 1 else [f"{folder}/subframe_{s}" for s in range(subframes)]
    return [f"{place}/{name}_{k}" for k in range(count) for place in places]


def _kind(field: LightField) -> str:
    rows, columns = field.grid
    height, width = field.size
    colour = "grey" if field.stored.shape[-3] == 1 else "in colour"
    return f"{rows}x{columns} views of {width}x{height} px {colour}"
