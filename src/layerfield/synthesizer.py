"""Method name to synthesizer: one call for every way to make layers from a light field."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from torch import Tensor

from layerfield.display import Display
from layerfield.light_field import LightField
from layerfield.links import LINKS, Link
from layerfield.nearest import did_you_mean
from layerfield.solve import Problem, Solution, Solver, State, solve
from layerfield.solvers.fourier_admm import FourierAdmm
from layerfield.solvers.fourier_start import FourierStart
from layerfield.solvers.gradient import Gradient
from layerfield.solvers.nmf import Nmf
from layerfield.solvers.sart import Sart
from layerfield.solvers.sweeps import Sweeps


@runtime_checkable
class Synthesizer(Protocol):
    """Anything that makes layers from a light field."""

    def __call__(self, field: LightField, display: Display, /) -> Solution:
        """Return layers for a display."""
        ...


@dataclass(frozen=True)
class Method:
    """One entry of the list of methods.

    Args:
        name: what the command line calls it.
        summary: one sentence.
        iterations: how many it makes unless told otherwise.
        links: the displays it serves.
        make: its solver for a link.
    """

    name: str
    summary: str
    iterations: int
    links: tuple[str, ...]
    make: Callable[[Link], Solver]


_ADDITIVE = ("additive",)
_ANY = tuple(LINKS)

_METHODS = (
    Method(
        "fourier-admm",
        "direct solver in the Fourier domain; on other than additive displays followed by sweeps",
        10,
        _ANY,
        lambda link: FourierAdmm() if link.is_sum else FourierStart(),
    ),
    Method("gradient", "accelerated projected gradients", 100, _ANY, lambda _: Gradient()),
    Method(
        "nmf", "multiplicative updates of non-negative factors", 100, _ADDITIVE, lambda _: Nmf()
    ),
    Method("sart", "algebraic reconstruction, view by view", 50, _ADDITIVE, lambda _: Sart()),
    Method("sweeps", "accelerated least squares, layer by layer", 10, _ANY, lambda _: Sweeps()),
)
METHODS: dict[str, Method] = {method.name: method for method in _METHODS}


@dataclass(frozen=True)
class SolverSynthesizer:
    """A solver with everything said but the light field and the display.

    Args:
        method: which solver.
        iterations: the most it makes.
        weights: of the views; equal if not given.
        tolerance: stop when no pixel changes by more; 0: never.
        time_limit: seconds after which no iteration is started.
        callback: called with the iteration and the state after each.
        history: record the error of every iteration, outside the clock.
    """

    method: Method
    iterations: int
    weights: Sequence[float] | None = None
    tolerance: float = 0.0
    time_limit: float = math.inf
    callback: Callable[[int, State], None] | None = None
    history: bool = False

    def __call__(
        self, field: LightField, display: Display, /, *, init: Solution | Tensor | None = None
    ) -> Solution:
        """Return layers; see `synthesize`."""
        if display.link.name not in self.method.links:
            raise ValueError(
                f"method '{self.method.name}' serves {' and '.join(self.method.links)} displays, "
                f"'{display.name}' is {display.link.name}; try fourier-admm"
            )
        return solve(
            pose(field, display, self.weights),
            self.method.make(display.link),
            iterations=self.iterations,
            init=init,
            tolerance=self.tolerance,
            time_limit=self.time_limit,
            callback=self.callback,
            history=self.history,
        )


def find_method(name: str) -> Method:
    """Return the method of that name.

    Raises:
        ValueError: no such method, with the nearest name.
    """
    if name not in METHODS:
        raise ValueError(f"unknown method '{name}'{did_you_mean(name, METHODS)}")
    return METHODS[name]


def pose(field: LightField, display: Display, weights: Sequence[float] | None = None) -> Problem:
    """Return the problem of showing a light field on a display.

    Raises:
        ValueError: the views are not those of the display.
    """
    expected = display.geometry.grid
    if expected is not None and field.grid != expected:
        found, wanted = ("{}x{}".format(*grid) for grid in (field.grid, expected))
        raise ValueError(
            f"'{field.name}' has {found} views, display '{display.name}' expects {wanted}; "
            f"choose with --views {wanted} or --step, or change the views of the display"
        )
    return Problem.of(display, field.views, weights)


def synthesize(
    field: LightField,
    display: Display,
    *,
    method: str = "fourier-admm",
    iterations: int | None = None,
    init: Solution | Tensor | None = None,
    weights: Sequence[float] | None = None,
    tolerance: float = 0.0,
    time_limit: float = math.inf,
    callback: Callable[[int, State], None] | None = None,
    history: bool = False,
) -> Solution:
    """Make the layers that show a light field on a display.

    Args:
        field: the views, as many as the display has viewpoints.
        display: what shows them.
        method: one of `METHODS`.
        iterations: the most to make; the method's own number if not given.
        init: layers, or an earlier solution, to start from.
        weights: how much each view counts, at least 0; all alike if not given.
        tolerance: stop when no pixel changes by more in an iteration; 0: never.
        time_limit: start no iteration after this many seconds.
        callback: called with the iteration and the state after each.
        history: record the error of every iteration, outside the clock.

    Raises:
        ValueError: an unknown method, one that does not serve the display, or views that are not
            those of the display.
    """
    found = find_method(method)
    run = SolverSynthesizer(
        found,
        found.iterations if iterations is None else iterations,
        weights,
        tolerance,
        time_limit,
        callback,
        history,
    )
    return run(field, display, init=init)
