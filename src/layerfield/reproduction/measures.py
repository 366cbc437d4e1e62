"""What is measured of a contender on a light field: quality, light, operations, time, memory."""

import copy
import math
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.utils.flop_counter import FlopCounterMode

from layerfield.display import Display
from layerfield.gram import Gram
from layerfield.light_field import LightField
from layerfield.metrics import LayerFigures, decibels, layer_figures, psnr, psnr_by_view
from layerfield.networks import Network
from layerfield.problem import Problem
from layerfield.reference import Reference, reference
from layerfield.reproduction.contenders import COURSES, Contender
from layerfield.reproduction.memory import peak_memory
from layerfield.synthesizer import pose, synthesize
from layerfield.weights import kept_weights

_MEMORY_ITERATIONS = 50  # of solvers, those the paper speaks of; the first few take less memory
Tick = Callable[[str], None]


@dataclass(frozen=True)
class Cost:
    """Multiply-adds per pixel of a view and colour channel.

    Args:
        once: before the first iteration; all of a network's.
        each: of an iteration.
    """

    once: float
    each: float = 0.0

    def of(self, iterations: float) -> float:
        """Return the cost of so many iterations."""
        return self.once + iterations * self.each


@dataclass(frozen=True, eq=False)
class Shown:
    """What a contender made of a light field.

    Args:
        contender: who.
        layers: pixels, 0 to 1.
        psnr: pooled, dB.
        by_view: the same of every view.
        figures: of every layer, front to back.
        seconds: median of a few runs.
        cost: in multiply-adds.
        parameters: of a network.
        megabytes: peak memory of a process that does nothing else, if measured.
        unsteady: slowest over fastest of these runs.
    """

    contender: Contender
    layers: Float[Tensor, "1 layer c ly lx"]
    psnr: float
    by_view: Sequence[float]
    figures: Sequence[LayerFigures]
    seconds: float
    cost: float
    parameters: int | None = None
    megabytes: float | None = None
    unsteady: float = 1.0

    @property
    def view_spread(self) -> float:
        """Standard deviation of PSNR over views, dB."""
        return statistics.pstdev(self.by_view)

    @property
    def light(self) -> list[float]:
        """Share of the light in every layer."""
        return shares([layer.mean for layer in self.figures])

    @property
    def detail(self) -> list[float]:
        """Share of the gradient energy in every layer."""
        return shares([layer.gradient_energy for layer in self.figures])


def shares(values: Sequence[float]) -> list[float]:
    """Return values as parts of their sum; equal parts of nothing.

    >>> shares([3.0, 1.0])
    [0.75, 0.25]
    """
    total = sum(values)
    return [value / total if total > 0 else 1 / len(values) for value in values]


def unevenness(parts: Sequence[float]) -> float:
    """Return the largest part less the smallest: 0 if all are alike, 1 if one has everything."""
    return max(parts) - min(parts)


@dataclass(frozen=True)
class Course:
    """A solver's way to the optimum.

    Args:
        solver: its name.
        psnr: of the start and after every iteration, dB.
        seconds: that had passed by then.
        cost: in multiply-adds.
        megabytes: peak memory of a process that does nothing else, if measured.
    """

    solver: str
    psnr: Sequence[float]
    seconds: Sequence[float]
    cost: Cost
    megabytes: float | None = None

    @property
    def most(self) -> int:
        """Iterations that were made."""
        return len(self.psnr) - 1

    def reaching(self, quality: float) -> float | None:
        """Return the iteration that first reaches a PSNR, interpolated; None if none does."""
        for n, (before, now) in enumerate(zip(self.psnr, self.psnr[1:], strict=False)):
            if quality <= before:
                return float(n)
            if quality <= now:
                return n + (quality - before) / (now - before)
        return float(self.most) if quality <= self.psnr[-1] else None

    def seconds_at(self, iteration: float) -> float:
        """Return the seconds until an iteration, interpolated."""
        whole = min(math.floor(iteration), self.most - 1)
        first, second = self.seconds[whole], self.seconds[whole + 1]
        return first + (iteration - whole) * (second - first)


@dataclass(frozen=True, eq=False)
class Measured:
    """Everything that is measured on one light field.

    Args:
        field: which.
        optimum: of the display.
        shown: by key of the contender.
        courses: by name of the solver.
    """

    field: LightField
    optimum: Reference
    shown: dict[str, Shown]
    courses: dict[str, Course]


@dataclass(frozen=True)
class Effort:
    """How much is measured.

    Args:
        iterations: that the iterative solvers are followed for.
        repeats: runs that the median time is taken of.
        memory: start a process for each contender to measure its peak memory.
    """

    iterations: int = 500
    repeats: int = 3
    memory: bool = True


def measure(
    field: LightField,
    display: Display,
    contenders: Sequence[Contender],
    effort: Effort,
    tick: Tick,
) -> Measured:
    """Measure all contenders and solvers on a light field, one after the other."""
    problem = pose(field, display)
    shown = {}
    for each in contenders:
        tick(f"{field.name}: {each.label}")
        shown[each.key] = _show(each, field, display, effort)
    courses = {}
    for name in COURSES:
        tick(f"{field.name}: {effort.iterations} iterations of {name}")
        courses[name] = follow(name, field, display, effort)
    tick(f"{field.name}: optimum")
    return Measured(field, reference(problem), shown, courses)


def _show(each: Contender, field: LightField, display: Display, effort: Effort) -> Shown:
    def run(part: LightField):
        return synthesize(part, display, method=each.method, iterations=each.iterations)

    run(_corner(field))  # threads and libraries start outside the clock
    runs = [run(field) for _ in range(effort.repeats)]
    seconds = [run.seconds for run in runs]
    layers, views = runs[0].layers, display(runs[0].layers)
    network = None if each.iterations is not None else kept_weights(each.method).network
    if network is None:
        cost = solver_cost(each.method, pose(field, display)).of(each.iterations or 0)
    else:
        cost = network_cost(network, field.size, display.margin)
    return Shown(
        each,
        layers,
        psnr(views, field.views),
        psnr_by_view(views, field.views),
        layer_figures(layers),
        statistics.median(seconds),
        cost,
        None if network is None else sum(p.numel() for p in network.parameters()),
        _memory(each.method, network is not None, field, display) if effort.memory else None,
        max(seconds) / max(min(seconds), 1e-9),
    )


def follow(name: str, field: LightField, display: Display, effort: Effort) -> Course:
    """Return the course of a solver."""
    synthesize(_corner(field), display, method=name, iterations=1)
    start = synthesize(field, display, method=name, iterations=0)
    run = synthesize(field, display, method=name, iterations=effort.iterations, history=True)
    return Course(
        name,
        [psnr(display(start.layers), field.views)]
        + [decibels(each.mean_square_error) for each in run.history],
        [start.seconds] + [each.seconds for each in run.history],
        solver_cost(name, pose(field, display)),
        _memory(name, False, field, display) if effort.memory else None,
    )


def _memory(method: str, is_network: bool, field: LightField, display: Display) -> float | None:
    iterations = None if is_network else _MEMORY_ITERATIONS
    return peak_memory(method, iterations, field, display)


def _corner(field: LightField) -> LightField:
    return LightField(field.stored[..., :32, :32].contiguous(), field.grid)


def network_cost(network: Network, size: tuple[int, int], margin: tuple[int, int]) -> float:
    """Return the multiply-adds of a network, per pixel of a view and colour channel.

    All convolutions on the picture as `frame.pixels` continues it, counted by PyTorch without
    computing anything. Tiles of pictures above 512x512 overlap, which is not counted.
    """
    absent, whole = copy.deepcopy(network).to("meta"), network.multiple
    wide = [-(-(n + 2 * m) // whole) * whole for n, m in zip(size, margin, strict=True)]
    with FlopCounterMode(display=False) as counter:
        absent.pixels(torch.empty(1, network.views, *wide, device="meta"))
    return counter.get_total_flops() / 2 / math.prod(size)


def solver_cost(name: str, problem: Problem) -> Cost:
    """Return the multiply-adds of a solver on an additive display, per pixel and channel.

    With N views of p pixels, K layers of q pixels, T products of a window and a weight over all
    views and layers (N K if all shifts are whole pixels), a torus of n pixels:

        A, A^T           T p each
        FFT              1.25 n log2 n for real values (2.5 n log2 n operations)
        band             2 T (n - p)
        G(f)             K^2 n, twice that if it is complex
        sart             2 T p + N p            A of one view at a time, residual, A^T
        gradient         (B + 4 K) q            B bands of G, residual, step and momentum
                                                                                once: A^T L = T p
                         2 T p + N p + 3 K q    views in no grid: A, residual, A^T, the same
        nmf              2 K FFT + G(f) + band + 2 K q                  once: A^T L = T p
        fourier-admm     2 K FFT + G(f) + band + 4 K n                  once: A^T L = T p

    A sum without a product counts as much as a multiply-add. What depends on the display alone
    (G, coverage) is not counted.
    """
    projection, views, layers = problem.projection, len(problem.weights), problem.layer_count
    view = math.prod(problem.view_size)
    layer = math.prod(projection.layer_size(problem.target))
    taps = sum(len(taps) for row in projection.taps for taps in row)
    linear = 2 * taps * view + views * view
    if name == "sart":
        return Cost(0.0, linear / view)
    if name == "gradient":
        grid = problem.grid(at_once=True)
        if grid is None:
            return Cost(0.0, (linear + 3 * layers * layer) / view)
        bands = sum(int(each.begins[:, -1].sum()) for each in (grid.rows, grid.columns))
        return Cost(float(taps), (bands + 4 * layers) * layer / view)
    gram = problem.gram
    fourier = _gram_cost(gram, layers, taps, view)
    own = {"nmf": 2 * layers * layer, "fourier-admm": 4 * layers * math.prod(gram.torus)}[name]
    return Cost(float(taps), (fourier + own) / view)


def _gram_cost(gram: Gram, layers: int, taps: int, view: int) -> float:
    torus = math.prod(gram.torus)
    transform = 1.25 * torus * math.log2(torus)
    matrix = layers**2 * torus * (2 if gram.spectral.symbol.is_complex() else 1)
    return 2 * layers * transform + matrix + 2 * taps * (torus - view)


def as_record(measured: Measured) -> dict[str, Any]:
    """Return the numbers as plain data for JSON; an exact picture, infinite in dB, is null."""
    return {
        "field": measured.field.name,
        "size": list(measured.field.size),
        "optimum_psnr": finite(measured.optimum.psnr),
        "shown": {key: _shown_record(shown) for key, shown in measured.shown.items()},
        "courses": {
            name: {
                "psnr": [finite(value) for value in course.psnr],
                "seconds": list(course.seconds),
                "operations_once": course.cost.once,
                "operations_of_an_iteration": course.cost.each,
                "peak_mb": course.megabytes,
            }
            for name, course in measured.courses.items()
        },
    }


def _shown_record(shown: Shown) -> dict[str, Any]:
    return {
        "label": shown.contender.label,
        "iterations": shown.contender.iterations,
        "psnr": finite(shown.psnr),
        "psnr_by_view": [finite(value) for value in shown.by_view],
        "layers": [layer._asdict() for layer in shown.figures],
        "seconds": shown.seconds,
        "slowest_over_fastest": shown.unsteady,
        "operations": shown.cost,
        "parameters": shown.parameters,
        "peak_mb": shown.megabytes,
    }


def finite(value: float) -> float | None:
    """Return the value, or None for what JSON does not know."""
    return value if math.isfinite(value) else None
