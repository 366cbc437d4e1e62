"""The yardstick of a light field on a display: the optimum, or the best that is known.

Additive displays pose a convex problem. Around any point X, in the box or not, with
g = A^T W (A X - L), layers Q in the box obey f(Q) >= f(X) + g . (Q - X), hence

    f* >= f(X) - g . X + sum min(0, g)

bounds how far layers are from the optimum. The x of ADMM, before the box, gives the best bound.

Other links have local optima; there the reference is the best of several starts and algorithms run
until they stagnate, and a method that beats it replaces it.
"""

import hashlib
import json
import math
import os
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from jaxtyping import Float
from torch import Tensor

from layerfield.io.safe_output import whole_file
from layerfield.metrics import EXACT, decibels
from layerfield.problem import Problem
from layerfield.solve import Solver, solve
from layerfield.solvers.fourier_admm import FourierAdmm
from layerfield.solvers.fourier_start import FourierStart
from layerfield.solvers.gradient import Gradient
from layerfield.solvers.nearest_shifts import NearestShifts
from layerfield.solvers.sweeps import Sweeps
from layerfield.warped_projection import WarpedProjection

GAP_DB = 0.01  # an optimum is certified to this
_REVISION = 5  # of this file's algorithm; part of the cache key
_MOST_ROUNDS = 60
_ROUND = 25  # iterations between two looks at the error
_STAGNATION = 2e-4  # relative gain of a round below which a run has stagnated


@dataclass(frozen=True)
class Reference:
    """The error that methods are compared with.

    Args:
        mean_square_error: over the whole views.
        kind: "optimum" (certified to 0.01 dB, or exact) or "best known".
        method: what reached it.
        gap_db: the optimum is at most this much better; None where no bound is known.
    """

    mean_square_error: float
    kind: str
    method: str
    gap_db: float | None = None

    @property
    def psnr(self) -> float:
        """The error in dB."""
        return decibels(self.mean_square_error)

    def improved_by(self, mean_square_error: float, method: str) -> "Reference":
        """Return the better of this reference and what a method reached.

        An optimum stays: a method can only beat it within its certified gap.
        """
        if self.kind == "optimum" or mean_square_error >= self.mean_square_error:
            return self
        return replace(self, mean_square_error=mean_square_error, method=method)


def reference(problem: Problem, *, tick: Callable[[str], None] | None = None) -> Reference:
    """Return the reference of a problem, from the cache if it was computed before.

    Args:
        problem: a light field on a display.
        tick: called with a word on what is being computed, for progress displays.
    """
    cached = cached_reference(problem)
    if cached is not None:
        return cached
    direct = problem.link.is_sum and not isinstance(problem.projection, WarpedProjection)
    found = _optimum(problem, tick) if direct else _best_known(problem, tick)
    store_reference(problem, found)
    return found


def cached_reference(problem: Problem) -> Reference | None:
    """Return the stored reference of a problem, or None."""
    try:
        return Reference(**json.loads(_cache_file(problem).read_text("utf-8")))
    except (OSError, ValueError, TypeError, RuntimeError):  # RuntimeError: there is no home
        return None


def store_reference(problem: Problem, found: Reference) -> None:
    """Store a reference for later runs; a cache that cannot be written is no error."""
    try:
        path = _cache_file(problem)
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path, force=True) as temporary:
            temporary.write_text(json.dumps(asdict(found)), encoding="utf-8")
    except (OSError, ValueError, RuntimeError):
        return


def optimality_gap(
    problem: Problem,
    layers: Float[Tensor, "*batch 1 layer c ly lx"],
    around: Float[Tensor, "*batch 1 layer c ly lx"] | None = None,
) -> float:
    """Return how many dB better than these layers an additive display can be at the most.

    Args:
        problem: additive, with layers from 0 to 1.
        layers: what is judged.
        around: the point X of the bound; the layers themselves if not given.
    """
    error, _ = _error_and_slope(problem, layers)
    point = layers if around is None else around
    value, slope = _error_and_slope(problem, point)
    bound = value - (slope * point).sum().item() + slope.clamp(max=0).sum().item()
    if error == 0:
        return 0.0
    return 10 * math.log10(error / bound) if bound > 0 else math.inf


def _error_and_slope(problem: Problem, layers: Tensor) -> tuple[float, Tensor]:
    """Return f = 1/2 ||A P - L||^2_W and its gradient, in double precision."""
    residual = problem.projection.forward(layers.double().squeeze(-5)) - problem.target.double()
    slope = problem.projection.adjoint(residual, problem.weights).unsqueeze(-5)
    weights = residual.new_tensor(problem.weights)[:, None, None, None]
    return 0.5 * (weights * residual.square()).sum().item(), slope


def _optimum(problem: Problem, tick: Callable[[str], None] | None) -> Reference:
    """Run the direct solver, then the same in double precision, until the gap is certified."""
    solver = FourierAdmm(penalty=0.003, warm_penalty=0.003, balance=0)
    run = solve(problem, solver, iterations=4 * _ROUND)
    exact = replace(problem, views=problem.views.then(Tensor.double))
    iterations, gap, init = run.iterations, math.inf, run.layers.double()
    error = math.inf
    for _ in range(_MOST_ROUNDS):
        if tick is not None:
            tick(f"optimum, gap {gap:.3f} dB")
        run = solve(exact, solver, iterations=_ROUND, init=init)
        iterations, init = iterations + run.iterations, run
        gap = optimality_gap(exact, run.layers, solver.unbounded(exact, run.state))
        error = exact.mean_square_error(run.layers)
        if gap <= GAP_DB or error <= EXACT:
            break
    certified = gap <= GAP_DB or error <= EXACT
    return Reference(
        error,
        "optimum" if certified else "best known",
        f"fourier-admm, {iterations} iterations",
        gap if math.isfinite(gap) else None,
    )


def _best_known(problem: Problem, tick: Callable[[str], None] | None) -> Reference:
    """Sweep from three starts to stagnation, then try gradients from the best of them."""
    starts = {
        "log start": solve(
            problem, NearestShifts(FourierStart.suited(problem.link)), iterations=0
        ).layers,
        "even start": _even_start(problem),
        "flat start": problem.flat_start(),
    }
    best, best_layers = Reference(math.inf, "best known", "none"), problem.flat_start()
    for name, start in starts.items():
        if tick is not None:
            tick(f"best known: sweeps from {name}")
        error, layers = _stagnate(problem, Sweeps(exact=True), start)
        if error < best.mean_square_error:
            best, best_layers = best.improved_by(error, f"sweeps from {name}"), layers
    if tick is not None:
        tick("best known: gradient from the best")
    error, _ = _stagnate(problem, Gradient(), best_layers)
    return best.improved_by(error, f"{best.method}, then gradient")


def _even_start(problem: Problem) -> Tensor:
    """Layers that share evenly, in the domain where the link is a sum, what viewers see."""
    start = problem.in_sum_domain().even_start()
    return problem.in_subframes(problem.link.from_sum(start).clamp(*problem.bounds))


def _stagnate(problem: Problem, solver: Solver, start: Tensor) -> tuple[float, Tensor]:
    run = solve(problem, solver, iterations=_ROUND, init=start)
    error = problem.mean_square_error(run.layers)
    for _ in range(_MOST_ROUNDS):
        run = solve(problem, solver, iterations=_ROUND, init=run)
        before, error = error, problem.mean_square_error(run.layers)
        if error > before * (1 - _STAGNATION):
            break
    return error, run.layers


def _cache_file(problem: Problem) -> Path:
    return cache_folder() / f"reference-{_fingerprint(problem)}.json"


def cache_folder() -> Path:
    """Return the folder of stored references: LAYERFIELD_CACHE, or the user's cache folder."""
    chosen = os.environ.get("LAYERFIELD_CACHE")
    if chosen:
        return Path(chosen)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "layerfield"


def _fingerprint(problem: Problem) -> str:
    facts = (
        _REVISION,
        problem.link,
        problem.projection.shifts,
        problem.weights,
        problem.bounds,
        problem.subframes,
        tuple(problem.views.stored.shape),
    )
    if isinstance(problem.projection, WarpedProjection):
        facts = (*facts, problem.projection.magnifications)
    digest = hashlib.sha256(repr(facts).encode())
    for view in problem.views:
        digest.update(view.float().cpu().contiguous().numpy().tobytes())
    return digest.hexdigest()[:32]
