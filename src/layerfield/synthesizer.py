"""Method name to synthesizer: one call for every way to make layers from a light field.

NAME                 a solver, or a network with the weights that come with the package
WEIGHTS              the network of certain weights of those, by their name
FILE.safetensors     the network of a weight file
NETWORK+SOLVER       a network, then iterations of a solver that start from its layers
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Protocol, runtime_checkable

from torch import Tensor

from layerfield.between import with_eyes
from layerfield.display import Display
from layerfield.fast import FastMethod
from layerfield.light_field import LightField
from layerfield.links import LINKS, Link
from layerfield.memory import keep_large_blocks
from layerfield.methods import (
    ChainMethod,
    Method,
    NetworkMethod,
    RowsMethod,
    RunOptions,
    SolverMethod,
    ToneMethod,
)
from layerfield.nearest import did_you_mean
from layerfield.problem import Problem
from layerfield.shipped import shipped
from layerfield.solve import Solution, Solver, State
from layerfield.solvers.fourier_admm import FourierAdmm
from layerfield.solvers.fourier_start import FourierStart
from layerfield.solvers.gradient import Gradient
from layerfield.solvers.nearest_shifts import NearestShifts
from layerfield.solvers.nmf import Nmf
from layerfield.solvers.ntf import Ntf
from layerfield.solvers.row_gauss_newton import RowGaussNewton
from layerfield.solvers.row_newton import RowNewton
from layerfield.solvers.sart import Sart
from layerfield.solvers.sweeps import Sweeps
from layerfield.solvers.tiled_admm import TiledAdmm
from layerfield.weights import PICKLE_SUFFIXES, WEIGHT_SUFFIX


@runtime_checkable
class Synthesizer(Protocol):
    """Anything that makes layers from a light field."""

    def __call__(self, field: LightField, display: Display, /) -> Solution:
        """Return layers for a display."""
        ...


_ADDITIVE = ("additive",)
_ANY = tuple(LINKS)


def _any_distance(
    name: str, summary: str, iterations: int, links: tuple[str, ...], solver: Solver
) -> SolverMethod:
    return SolverMethod(name, summary, iterations, links, lambda _: solver, lambda _: solver)


def _in_tiles(link: Link) -> Solver:
    if link.is_sum:
        return TiledAdmm()
    start = FourierStart.suited(link)
    assert isinstance(start.direct, FourierAdmm)
    return replace(start, direct=TiledAdmm(penalty=start.direct.penalty))


_SOLVERS = (
    SolverMethod(
        "fourier-admm",
        "direct solver in the Fourier domain; on other than additive displays followed by sweeps",
        10,
        _ANY,
        lambda link: FourierAdmm() if link.is_sum else FourierStart.suited(link),
        lambda _: NearestShifts(),
    ),
    FastMethod.shipped(),
    SolverMethod(
        "fourier-tiles",
        "fourier-admm in tiles: the same layers in less memory, for large pictures",
        10,
        _ANY,
        _in_tiles,
        lambda _: NearestShifts(FourierStart(TiledAdmm(), direct_iterations=4)),
    ),
    RowsMethod(
        "row-newton",
        "projected Newton steps, row by row: soon at the optimum where views stand in a row",
        5,
        ("additive", "multiplicative"),
        lambda link: RowNewton() if link.is_sum else RowGaussNewton(),
    ),
    _any_distance("gradient", "accelerated projected gradients", 100, _ANY, Gradient()),
    SolverMethod(
        "nmf", "multiplicative updates of non-negative factors", 100, _ADDITIVE, lambda _: Nmf()
    ),
    _any_distance(
        "ntf", "multiplicative updates of tensor displays", 100, ("multiplicative",), Ntf()
    ),
    _any_distance("sart", "algebraic reconstruction, view by view", 50, _ADDITIVE, Sart()),
    _any_distance("sweeps", "accelerated least squares, layer by layer", 10, _ANY, Sweeps()),
    ToneMethod(
        "tone",
        "fourier-admm, then sweeps that judge encoded values, where a display has a transfer",
        5,
        _ANY,
        lambda link: FourierAdmm() if link.is_sum else FourierStart.suited(link),
    ),
)
_NETWORKS = (
    NetworkMethod.shipped("stacked-cnn", "trained stack of convolutions; see `weights`"),
    NetworkMethod.shipped("unet", "trained U-Net; see `weights`"),
)
SOLVERS: dict[str, SolverMethod] = {method.name: method for method in _SOLVERS}
METHODS: dict[str, Method] = {method.name: method for method in (*_SOLVERS, *_NETWORKS)}
_CHAIN = "expected NETWORK+SOLVER, as unet+fourier-admm"


def find_method(name: str) -> Method:
    """Return the method of that name, shipped weights, weight file or chain.

    Raises:
        ValueError: no such method, with the nearest name; or a chain that is not a network
            followed by a solver.

    >>> find_method("unet+fourier-admm").iterations
    3
    """
    first, plus, last = name.rpartition("+")
    if name in METHODS:
        return METHODS[name]
    if plus and not _is_file(name):
        return ChainMethod.of(_network(first, name), _solver(last, name))
    if _is_file(name):
        return NetworkMethod.of_file(name)
    entries = {entry.name: entry for entry in shipped()}
    if name in entries:
        return NetworkMethod.of_entry(entries[name])
    raise ValueError(f"unknown method '{name}'{did_you_mean(name, [*METHODS, *entries])}")


def _is_file(name: str) -> bool:
    """A folder may have a + in its name; what a method's name and a + come before is a chain."""
    ends = name.lower().endswith((WEIGHT_SUFFIX, *PICKLE_SUFFIXES))
    return ends and name.partition("+")[0] not in METHODS


def _network(name: str, chain: str) -> NetworkMethod:
    if name in SOLVERS:
        raise ValueError(f"'{name}' in '{chain}' is a solver; {_CHAIN}")
    known = [method.name for method in _NETWORKS] + [entry.name for entry in shipped()]
    if name in known or _is_file(name):
        found = find_method(name)
        assert isinstance(found, NetworkMethod)
        return found
    raise ValueError(f"unknown network '{name}' in '{chain}'{did_you_mean(name, known)}")


def _solver(name: str, chain: str) -> SolverMethod:
    if name in SOLVERS:
        return SOLVERS[name]
    if name in METHODS or _is_file(name):
        raise ValueError(f"'{name}' in '{chain}' is a network; {_CHAIN}")
    raise ValueError(f"unknown solver '{name}' in '{chain}'{did_you_mean(name, SOLVERS)}")


def spelled(title: str, iterations: int) -> str:
    """Return a method and its iterations as `evaluate` takes them.

    >>> spelled("nmf", 10), spelled("unet", 0), spelled("unet+nmf", 3)
    ('nmf:10', 'unet', 'unet+nmf:3')
    """
    return f"{title}:{iterations}" if title.rpartition("+")[2] in SOLVERS else title


def pose(field: LightField, display: Display, weights: Sequence[float] | None = None) -> Problem:
    """Return the problem of showing a light field on a display.

    Eyes between the viewpoints, if the light field has any, are further light paths.

    Raises:
        ValueError: the views are not those of the display, or hold what is no number.
    """
    if field.stored.is_floating_point() and not field.stored.isfinite().all():
        raise ValueError(f"'{field.name}' has pixels that are no numbers, expected values 0 to 1")
    expected = display.geometry.grid
    if expected is not None and field.grid != expected:
        found, wanted = ("{}x{}".format(*grid) for grid in (field.grid, expected))
        raise ValueError(
            f"'{field.name}' has {found} views, display '{display.name}' expects {wanted}; "
            f"choose with --views {wanted} or --step, or change the views of the display"
        )
    problem = Problem.of(display, field.kept, weights)
    return problem if field.between is None else with_eyes(problem, display, field.between)


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
        method: one of `METHODS`, a weight file, or NETWORK+SOLVER.
        iterations: the most to make; the method's own number if not given.
        init: layers, or an earlier solution, to start from; for solvers.
        weights: how much each view counts, at least 0; all alike if not given. For solvers.
        tolerance: stop when no pixel changes by more in an iteration; 0: never.
        time_limit: start no iteration after this many seconds.
        callback: called with the iteration and the state after each.
        history: record the error of every iteration, outside the clock.

    Raises:
        ValueError: an unknown method, one that does not serve the display, or views that are not
            those of the display.
    """
    keep_large_blocks()
    found = find_method(method)
    count = found.count(iterations)
    problem = pose(field, display, weights)
    found.refuse_unserved(display)
    options = RunOptions(count, init, weights, tolerance, time_limit, callback, history)
    solution = found.run(problem, display, options)
    return replace(solution, problem=solution.problem or problem)
