"""What is measured of one method, with one number of iterations, on one field and display."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import torch
from torch import Tensor

from layerfield.bench.operations import OperationCounter, TransformRecorder
from layerfield.bench.road import EightBitViews, Panels, views_to_panels
from layerfield.bench.timing import Seconds, timed, timed_by_turns
from layerfield.display import Display
from layerfield.display_spec import Spec
from layerfield.metrics import excess, mean_square_error, psnr
from layerfield.own_process import in_own_process, peak_megabytes
from layerfield.panels import dequantise
from layerfield.reference import Reference
from layerfield.synthesizer import find_method, spelled

NOT_OURS = "found a row that this version has not written; make it again with --force"
Key = tuple[str, str, str, int]


@dataclass(frozen=True)
class Effort:
    """How carefully runs are measured.

    Args:
        repeats: runs after the warm-up, at least, of which the median counts; see `timed`.
        cap: seconds; a run that takes longer is not repeated, and its method gets no more
            iterations on that field and display.
        memory: measure peak memory in a process of its own, with a method's most iterations.
    """

    repeats: int = 5
    cap: float = 20.0
    memory: bool = False

    def __post_init__(self) -> None:
        if not self.cap > 0:
            raise ValueError(f"the cap is {self.cap:g} s, expected more than 0")


@dataclass(frozen=True)
class BenchRow:
    """One run; mean square errors are those of light, of views that are not clipped.

    Args:
        field: name of the light field.
        size: height and width of its views.
        display: name.
        method: title.
        iterations: that were asked for.
        psnr: of the 8-bit panels, in values of the files, dB.
        mean_square_error: of the 8-bit panels.
        unrounded: mean square error of the layers before they were rounded.
        seconds: from 8-bit views to 8-bit panels.
        capped: the run took longer than the cap.
        operations: of the run; see `OperationCounter`.
        operations_per_pixel: the same for every pixel of a view and colour channel.
        transform_seconds: its Fourier transforms alone, on arrays of the same sizes; None if it
            makes none.
        peak_mb: peak memory of a process that does nothing else; of the device on a GPU.
        reference: what errors are compared with.
    """

    field: str
    size: tuple[int, int]
    display: str
    method: str
    iterations: int
    psnr: float
    mean_square_error: float
    unrounded: float
    seconds: Seconds
    capped: bool
    operations: float
    operations_per_pixel: float
    transform_seconds: float | None
    peak_mb: float | None = None
    reference: Reference | None = None

    @property
    def key(self) -> Key:
        """What no two rows share."""
        return self.field, self.display, self.method, self.iterations

    @property
    def label(self) -> str:
        """The method and its iterations."""
        return spelled(self.method, self.iterations)

    @property
    def least(self) -> float:
        """The mean square error that this run has shown to be possible."""
        return min(self.mean_square_error, self.unrounded)

    @property
    def yardstick(self) -> Reference:
        """The reference, which every row has once its field and display are done."""
        assert self.reference is not None
        return self.reference

    @property
    def excess(self) -> float:
        """Of the 8-bit panels over the reference, MSE / MSE_reference - 1."""
        return excess(self.mean_square_error, self.yardstick.mean_square_error)

    @property
    def excess_unrounded(self) -> float:
        """The same before rounding."""
        return excess(self.unrounded, self.yardstick.mean_square_error)

    def as_record(self) -> dict[str, Any]:
        """Return the row as plain data for JSON."""
        return asdict(self) | {
            "excess": self.excess,
            "excess_unrounded": self.excess_unrounded,
            "reference_psnr": self.yardstick.psnr,
        }

    @classmethod
    def of_record(cls, record: dict[str, Any]) -> "BenchRow":
        """Return the row that a record was made from.

        Raises:
            ValueError: it is none.
        """
        try:
            own = {name: record[name] for name in cls.__dataclass_fields__}
            own["size"] = tuple(own["size"])
            own["psnr"] = float("inf") if own["psnr"] is None else own["psnr"]
            own["seconds"] = Seconds(**own["seconds"])
            own["reference"] = Reference(**own["reference"])
            return cls(**own)
        except (KeyError, TypeError):
            raise ValueError(NOT_OURS) from None


def measured(
    views: EightBitViews, display: Display, method: str, iterations: int, effort: Effort
) -> BenchRow:
    """Run a method a few times and judge what it makes; all but peak memory and reference."""

    def run() -> Panels:
        return views_to_panels(views, display, method, iterations)

    device = views.codes.device
    seconds, made = timed(run, device, repeats=effort.repeats, cap=effort.cap)
    field = views.light_field()
    from_codes = display(dequantise(made.codes, display.transfer))
    light = display.transfer.decode(field.views)
    error, unrounded = (mean_square_error(v, light) for v in (from_codes, display(made.layers)))
    with OperationCounter() as counter:
        run()
    with TransformRecorder() as recorder:
        run()
    return BenchRow(
        field=views.name,
        size=views.size,
        display=display.name,
        method=find_method(method).title,
        iterations=iterations,
        psnr=psnr(display.transfer.encode(from_codes), field.views),
        mean_square_error=error,
        unrounded=unrounded,
        seconds=seconds,
        capped=seconds.median > effort.cap,
        operations=counter.operations,
        operations_per_pixel=counter.operations / views.codes[0].numel(),
        transform_seconds=_transforms(recorder, run, seconds, device, effort),
    )


def _transforms(
    recorder: TransformRecorder,
    run: Callable[[], Panels],
    seconds: Seconds,
    device: torch.device,
    effort: Effort,
) -> float | None:
    """Return the seconds of a run's transforms alone: both by turns, their ratio is the point.

    The seconds of the run are those by itself, as of methods that have none.
    """
    if not len(recorder):
        return None
    alone, (repeats, cap) = recorder.again(), (effort.repeats, effort.cap)
    return seconds.median / timed_by_turns(run, alone, device, repeats=repeats, cap=cap)[1]


def with_peak(row: BenchRow, views: EightBitViews, display: Display, method: str) -> BenchRow:
    """Return a row with the peak memory of its run.

    Raises:
        MemoryError: the process was killed.
    """
    if views.codes.device.type == "cuda":
        torch.cuda.reset_peak_memory_stats()
        views_to_panels(views, display, method, row.iterations)
        return replace(row, peak_mb=torch.cuda.max_memory_allocated() / 2**20)
    job = (views.codes, views.grid, display.spec, method, row.iterations)
    return replace(row, peak_mb=in_own_process(_peak, *job))


def _peak(codes: Tensor, grid: tuple[int, int], spec: Spec, method: str, iterations: int) -> float:
    views_to_panels(EightBitViews(codes, grid), Display(spec), method, iterations)
    return peak_megabytes()
