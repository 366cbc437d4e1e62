"""The ways to make layers: a solver, a trained network, a network followed by a solver.

A method knows its name, the displays it serves, and how to run itself on a problem.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.clock import Clock
from layerfield.display import Display
from layerfield.links import LINKS, Link
from layerfield.networks import Network
from layerfield.networks.frame import tiled_pixels
from layerfield.problem import Problem
from layerfield.row_system import serves_products, serves_rows
from layerfield.shipped import Entry, find_shipped, load_shipped
from layerfield.solve import Solution, Solver, State, solve
from layerfield.solvers.sweeps import Sweeps
from layerfield.tone import on_values
from layerfield.weights import TrainedNetwork, kept_weights

CHAIN_ITERATIONS = 3  # of a solver behind a network
_BEFORE_TONE = 10  # of the solver in light


@dataclass(frozen=True)
class RunOptions:
    """Everything that may be said of a run but the method, the light field and the display.

    Args:
        iterations: the most to make.
        init: layers, or an earlier solution, to start from.
        weights: how much each view counts; all alike if not given.
        tolerance: stop when no pixel changes by more in an iteration; 0: never.
        time_limit: start no iteration after this many seconds.
        callback: called with the iteration and the state after each.
        history: record the error of every iteration, outside the clock.
    """

    iterations: int
    init: Solution | Tensor | None = None
    weights: Sequence[float] | None = None
    tolerance: float = 0.0
    time_limit: float = math.inf
    callback: Callable[[int, State], None] | None = None
    history: bool = False


@dataclass(frozen=True)
class Method:
    """One way to make layers.

    Args:
        name: what the command line calls it.
        summary: one sentence.
        iterations: how many it makes unless told otherwise.
        links: the displays it serves.
    """

    name: str
    summary: str
    iterations: int
    links: tuple[str, ...]

    @property
    def title(self) -> str:
        """The name in tables and results; of a weight file's path only the end."""
        return self.name

    @property
    def file(self) -> Path | None:
        """The weight file that it reads, if its name is that of one."""
        return None

    def count(self, asked: int | None) -> int:
        """Return the iterations to make: those asked for, or its own number.

        Raises:
            ValueError: it makes none.
        """
        return self.iterations if asked is None else asked

    def refuse_unserved(self, display: Display) -> None:
        """Refuse a display that it cannot make layers for.

        Raises:
            ValueError: the link is another one; or there are no weights for the display.
        """
        if display.link.name not in self.links:
            raise ValueError(
                f"method '{self.name}' serves {' and '.join(self.links)} displays, "
                f"'{display.name}' is {display.link.name}; take fourier-admm, or another display"
            )

    def run(self, problem: Problem, display: Display, options: RunOptions) -> Solution:
        """Return layers.

        Args:
            problem: of showing views on the display.
            display: one that it serves.
            options: how.
        """
        raise NotImplementedError


@dataclass(frozen=True)
class SolverMethod(Method):
    """An iterative or direct solver.

    Args:
        make: the solver for a link.
        apart: the same where viewpoints lie at different distances; None if it serves none.
    """

    make: Callable[[Link], Solver]
    apart: Callable[[Link], Solver] | None = None

    def refuse_unserved(self, display: Display) -> None:
        super().refuse_unserved(display)
        if not display.geometry.is_regular and self.apart is None:
            raise ValueError(
                f"method '{self.name}' needs viewpoints at one distance, those of "
                f"'{display.name}' differ; take fourier-admm"
            )

    def run(self, problem: Problem, display: Display, options: RunOptions) -> Solution:
        make = self.make if display.geometry.is_regular or self.apart is None else self.apart
        return solve(
            problem,
            make(display.link),
            iterations=options.iterations,
            init=options.init,
            tolerance=options.tolerance,
            time_limit=options.time_limit,
            callback=options.callback,
            history=options.history,
        )


@dataclass(frozen=True)
class RowsMethod(SolverMethod):
    """A solver of rows of pixels by themselves: for displays whose views stand in a row."""

    def refuse_unserved(self, display: Display) -> None:
        super().refuse_unserved(display)
        if not serves_rows(display.projection):
            grid = display.geometry.grid
            found = "viewpoints of its own" if grid is None else "{}x{} views".format(*grid)
            raise ValueError(
                f"method '{self.name}' needs views in a single row and layers that are only "
                f"shifted, '{display.name}' has {found}; take fourier-admm"
            )
        if not display.link.is_sum and not serves_products(display.projection):
            raise ValueError(
                f"where light is multiplied, method '{self.name}' needs layers that are shifted by "
                f"whole pixels, those of '{display.name}' are not; take fast"
            )
        if display.subframes > 1:
            raise ValueError(
                f"method '{self.name}' solves for a single subframe, '{display.name}' has "
                f"{display.subframes}; take fast"
            )


@dataclass(frozen=True)
class ToneMethod(SolverMethod):
    """A solver in light, then sweeps whose errors are those of encoded values; see `tone`."""

    def refuse_unserved(self, display: Display) -> None:
        super().refuse_unserved(display)
        if display.subframes > 1:
            raise ValueError(
                f"method '{self.name}' encodes what one subframe shows, '{display.name}' has "
                f"{display.subframes}, whose light is seen together; take fourier-admm"
            )

    def run(self, problem: Problem, display: Display, options: RunOptions) -> Solution:
        start = options.init
        if start is None:
            start = solve(problem, self.make(display.link), iterations=_BEFORE_TONE)
        spent = start.seconds if isinstance(start, Solution) and options.init is None else 0.0
        values = on_values(problem, display.transfer)
        later = replace(options, init=start, time_limit=options.time_limit - spent)
        sweeps = SolverMethod(self.name, self.summary, 0, self.links, lambda _: Sweeps())
        end = sweeps.run(values, display, later)
        history = tuple(p._replace(seconds=p.seconds + spent) for p in end.history)
        return replace(end, seconds=end.seconds + spent, history=history, problem=values)


@dataclass(frozen=True)
class NetworkMethod(Method):
    """A trained network: one forward pass.

    Args:
        find: its weights for a display; an error if there are none.
        path: of the weight file, if the name is that of one.
    """

    find: Callable[[Display], TrainedNetwork]
    path: Path | None = None

    @classmethod
    def shipped(cls, network: str, summary: str) -> "NetworkMethod":
        """Return the method that takes the weights that come with the package."""

        def find(display: Display) -> TrainedNetwork:
            return load_shipped(find_shipped(network, display))

        return cls(network, summary, 0, tuple(LINKS), find)

    @classmethod
    def of_entry(cls, entry: Entry) -> "NetworkMethod":
        """Return the method that takes certain weights of those that come with the package."""
        return cls._of(entry.name, f"the {entry.network} {entry.name}", lambda: load_shipped(entry))

    @classmethod
    def of_file(cls, name: str) -> "NetworkMethod":
        """Return the method that takes the weights of a file, which is read when needed."""
        summary = "the network of a weight file"
        return replace(cls._of(name, summary, lambda: kept_weights(name)), path=Path(name))

    @classmethod
    def _of(cls, name: str, summary: str, load: Callable[[], TrainedNetwork]) -> "NetworkMethod":
        """Return the method that takes the same weights for every display."""

        def find(display: Display) -> TrainedNetwork:
            trained = load()
            trained.refuse_other(display)
            return trained

        return cls(name, summary, 0, tuple(LINKS), find)

    @property
    def title(self) -> str:
        return self.name if self.path is None else "/".join(self.path.parts[-2:])

    @property
    def file(self) -> Path | None:
        return self.path

    def count(self, asked: int | None) -> int:
        if asked:
            raise ValueError(
                f"method '{self.name}' is a network and makes no iterations, found {asked}; leave "
                f"them out, or let a solver make them: {self.name}+fourier-admm"
            )
        return 0

    def refuse_unserved(self, display: Display) -> None:
        super().refuse_unserved(display)
        self.find(display)

    def run(self, problem: Problem, display: Display, options: RunOptions) -> Solution:
        self.count(options.iterations)
        for what, given in (("init", options.init), ("view weights", options.weights)):
            if given is not None:
                raise ValueError(
                    f"method '{self.name}' is a network and takes no {what}; leave them out, or "
                    "take a solver"
                )
        views = problem.target[..., : display.view_count, :, :, :]  # eyes between come after
        return forward(self.find(display), views, display.margin)


def forward(
    trained: TrainedNetwork, views: Float[Tensor, "*batch view c y x"], margin: tuple[int, int]
) -> Solution:
    """Return the layers that a network makes of views, on their device and in their precision.

    Args:
        trained: which.
        views: values, 0 to 1; float32 or bfloat16.
        margin: pixels (y, x) by which layers exceed the views on each side.

    Returns:
        Layers in float32, clamped to 0..1. The details name the weights, and the share of pixels
        that were above 1.
    """
    network, clock = trained.on(views.device, views.dtype), Clock(views.device)
    with torch.no_grad(), clock:
        pixels = _pixels(network, views, margin)
        layers = pixels.clamp(0, 1).to(torch.promote_types(pixels.dtype, torch.float32))
    details = {
        "weights": trained.name,
        "sha256": trained.sha256,
        "clamped": (pixels > 1).double().mean().item(),
    }
    return Solution(layers, 0, clock.seconds, "one forward pass", details=details)


def _pixels(
    network: Network, views: Float[Tensor, "*batch view c y x"], margin: tuple[int, int]
) -> Float[Tensor, "*batch 1 layer c ly lx"]:
    """Return what a network says of light fields before the closing ReLU, margin included.

    Args:
        network: on the device and in the precision of the views.
        views: any batch and number of colour channels, each of which the network sees by itself.
        margin: pixels (y, x) by which layers exceed the views on each side.
    """
    by_channel = views.movedim(-4, -3)
    fields = by_channel.reshape(-1, *by_channel.shape[-4:])
    made = torch.stack([tiled_pixels(network, field, margin) for field in fields])
    layers = made.transpose(1, 2)
    return layers.reshape(*views.shape[:-4], 1, *layers.shape[1:])


@dataclass(frozen=True)
class ChainMethod(Method):
    """A network, followed by a solver that starts from its layers.

    Args:
        network: goes first.
        solver: follows.
    """

    network: NetworkMethod
    solver: SolverMethod

    @classmethod
    def of(cls, network: NetworkMethod, solver: SolverMethod) -> "ChainMethod":
        """Return the two one after the other."""
        name = f"{network.name}+{solver.name}"
        summary = f"{network.name}, followed by {solver.name}"
        return cls(name, summary, CHAIN_ITERATIONS, solver.links, network, solver)

    @property
    def title(self) -> str:
        return f"{self.network.title}+{self.solver.title}"

    @property
    def file(self) -> Path | None:
        return self.network.file

    def refuse_unserved(self, display: Display) -> None:
        super().refuse_unserved(display)
        self.network.refuse_unserved(display)

    def run(self, problem: Problem, display: Display, options: RunOptions) -> Solution:
        if options.init is not None:
            raise ValueError(
                f"method '{self.name}' starts from the layers of its network, found others; leave "
                f"out init, or take {self.solver.name} alone"
            )
        start = self.network.run(problem, display, RunOptions(0))
        exact = replace(problem, views=problem.views.then(lambda v: v.to(start.layers.dtype)))
        rest = replace(options, init=start, time_limit=options.time_limit - start.seconds)
        return _behind(start, self.solver.run(exact, display, rest))


def _behind(start: Solution, end: Solution) -> Solution:
    """Return what a solver ended with, as the end of what began with a network."""
    later = (p._replace(seconds=p.seconds + start.seconds) for p in end.history)
    return replace(
        end,
        seconds=start.seconds + end.seconds,
        status=f"{start.status}, then {end.status}",
        history=tuple(later),
        details=start.details,
    )
