"""Peak memory of a method, in a process that does nothing else."""

from torch import Tensor

from layerfield.display import Display
from layerfield.display_spec import Spec
from layerfield.light_field import LightField
from layerfield.own_process import in_own_process, peak_megabytes
from layerfield.synthesizer import synthesize


def peak_memory(method: str, iterations: int | None, field: LightField, display: Display) -> float:
    """Return megabytes, the interpreter and its libraries included.

    Raises:
        MemoryError: the process was killed.
    """
    return in_own_process(_peak, method, iterations, field.stored, field.grid, display.spec)


def _peak(
    method: str, iterations: int | None, views: Tensor, grid: tuple[int, int], spec: Spec
) -> float:
    synthesize(LightField(views, grid), Display(spec), method=method, iterations=iterations)
    return peak_megabytes()
