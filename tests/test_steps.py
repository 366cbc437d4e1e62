"""Several steps in one call: the same as one by one."""

import os
import subprocess
import sys
from dataclasses import replace
from importlib import import_module
from inspect import isclass
from pathlib import Path
from pkgutil import iter_modules
from unittest.mock import Mock

import pytest
import torch
from displays import SHOWN

from layerfield import Display, solvers
from layerfield.display_spec import parse_spec
from layerfield.fast import shipped_steps, warm_steps
from layerfield.kernels import compiled, small_steps, steps, transforms
from layerfield.kernels.compiled import plain
from layerfield.kernels.small_steps import Coarse, steps_at_once
from layerfield.kernels.steps import BalancedStart, steps_in_one_call
from layerfield.kernels.transforms import transforms_made
from layerfield.problem import Problem
from layerfield.solve import MultiStep, solve
from layerfield.solvers import admm_steps, learned_admm
from layerfield.solvers.fourier_admm import FourierAdmm

TWO = shipped_steps("additive").at_most(2).direct
SOLVERS = {
    "direct": FourierAdmm(),
    "learned": shipped_steps("additive").at_most(5).direct,
    "eased": replace(TWO, full=TWO.full[:1]),
    "warm": warm_steps(4),
}


def posed(kind: str, batch: tuple[int, ...] = (), weights=None) -> Problem:
    display = Display(parse_spec(f'name = "d"\nlink = "additive"\n{SHOWN[kind]}', "a test"))
    views = torch.rand(*batch, display.view_count, 3, 33, 46, generator=seeded(3))
    return Problem.of(display, views, weights)


def seeded(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def one_by_one(solver, problem: Problem, state, count: int):
    for _ in range(count):
        state = solver.step(problem, state)
    return state


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("kind", ["three layers", "six layers", "one row"])
@pytest.mark.parametrize(("count", "threads"), [(1, 3), (2, 1), (4, 3), (9, 3)])
def test_several_steps_are_those_one_by_one(monkeypatch, solver, kind, count, threads):
    monkeypatch.setattr(compiled, "FEW", 0)
    torch.set_num_threads(threads)
    made, problem = SOLVERS[solver], posed(kind, (2,))
    assert isinstance(made, MultiStep)
    start = made.init(problem, None)
    expected = one_by_one(made, problem, start, count)
    seen = made.layers(problem, start)
    found = made.steps(problem, start, count)
    assert torch.equal(made.layers(problem, start), seen), "a state is a value"
    assert torch.equal(found.shadow, expected.shadow)
    before = getattr(expected, "before", None)
    if before is not None:
        assert torch.equal(found.before, before)
        assert found.count == expected.count


@pytest.mark.parametrize("solver", SOLVERS)
def test_several_steps_are_those_of_pytorch(solver):
    made, problem = SOLVERS[solver], posed("three layers", (2,))
    count = 1 if solver == "eased" else 7  # sweeps follow
    found = made.steps(problem, made.init(problem, None), count)
    with plain():
        problem = posed("three layers", (2,))
        expected = made.steps(problem, made.init(problem, None), count)
    assert (found.shadow - expected.shadow).abs().max() < 2e-4


def test_who_compiles_computes_as_who_reads_what_was_kept(tmp_path):
    """Copies of a loop do not round alike; a process must not take now this one, now another."""
    code = (
        "import hashlib, torch, test_steps\n"
        "torch.set_num_threads(1)\n"
        "problem, direct = test_steps.posed('three layers'), test_steps.SOLVERS['direct']\n"
        "made = direct.steps(problem, direct.init(problem, None), 3).shadow\n"
        "print(hashlib.sha256(made.numpy().tobytes()).hexdigest())\n"
    )
    known = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    given = {"cwd": Path(__file__).parent, "env": known, "text": True}
    made = [subprocess.check_output([sys.executable, "-c", code], **given) for _ in range(2)]
    assert made[0] == made[1]
    assert list(tmp_path.rglob("*.nbi")), "nothing was kept"


@pytest.mark.parametrize("solver", SOLVERS)
def test_whoever_goes_on_goes_on_alike(solver):
    made, problem = SOLVERS[solver], posed("three layers")
    start = made.init(problem, None)
    once = made.steps(problem, start, 7)
    twice = made.steps(problem, made.steps(problem, start, 3), 4)
    assert torch.equal(once.shadow, twice.shadow)
    assert torch.equal(made.steps(problem, once, 0).shadow, once.shadow)


def test_many_iterations_are_made_at_once_where_nobody_looks(monkeypatch):
    problem, direct = posed("three layers"), FourierAdmm()
    counts = []

    def counted(*given):
        made = steps_in_one_call(*given)
        assert made is not None
        counts.append(len(given[-1]))
        return made

    monkeypatch.setattr(admm_steps, "steps_in_one_call", counted)
    with transforms_made() as transforms:
        found = solve(problem, direct, iterations=23)
    assert (found.iterations, len(transforms), counts) == (23, 46, [10, 10, 3])
    seen = []
    watched = solve(problem, direct, iterations=23, callback=lambda n, _: seen.append(n))
    assert seen == list(range(1, 24))
    assert counts[3:] == [1] * 23
    assert torch.equal(found.layers, watched.layers)


def test_the_first_of_learned_steps_begins_the_call(monkeypatch):
    """From the balanced start to the last learned step nothing else is called."""
    problem, learned = posed("three layers", (2,)), SOLVERS["learned"]
    calls = []

    def counted(*given):
        calls.append(given)
        return steps_in_one_call(*given)

    monkeypatch.setattr(learned_admm, "steps_in_one_call", counted)
    monkeypatch.setattr(admm_steps, "steps_in_one_call", None)
    with transforms_made() as transforms:
        found = learned.steps(problem, learned.init(problem, None), len(learned.full))
    assert len(calls) == 1
    assert isinstance(calls[0][0], BalancedStart)
    assert len(transforms) == 2 * len(learned.full) + 2 * (len(learned.coarse) + 1)
    assert found.before is not None


@pytest.mark.parametrize(
    ("where", "name", "other"),
    [(small_steps, "_SMALL", 1), (steps, "LARGE", 1), (learned_admm, "COARSE", 16)],
)
def test_otherwise_the_first_of_learned_steps_is_made_by_itself(monkeypatch, where, name, other):
    """Large planes, on either grid; and pictures too small for larger pixels."""
    problem, learned = posed("three layers"), SOLVERS["learned"]
    monkeypatch.setattr(where, name, other)
    found = learned.steps(problem, learned.init(problem, None), 4)
    assert found.count == 4
    with plain():
        problem = posed("three layers")
        expected = learned.steps(problem, learned.init(problem, None), 4)
    assert (found.shadow - expected.shadow).abs().max() < 2e-4


def test_layers_of_no_step_are_the_balanced_start():
    problem, learned = posed("three layers", (2,)), SOLVERS["learned"]
    found = solve(problem, learned, iterations=0)
    assert found.layers.equal(problem.even_start().clamp(0, 1))
    assert solve(problem, learned, iterations=3, init=found).iterations == 3


def test_who_makes_steps_of_its_own_makes_several_of_them():
    """A solver that inherits `steps` and has another `step` would make those of its parent."""
    modules = [
        import_module(f"layerfield.solvers.{each.name}") for each in iter_modules(solvers.__path__)
    ]
    known = {each for module in modules for each in vars(module).values() if isclass(each)}
    several = [each for each in known if hasattr(each, "steps")]
    assert len(several) >= 4
    for each in several:
        first = next(kind for kind in each.__mro__ if {"step", "steps"} & vars(kind).keys())
        assert "steps" in vars(first), each


def test_others_are_made_one_by_one(monkeypatch):
    """Large planes, where nothing calls threads, views that count apart, and PyTorch alone."""
    direct = FourierAdmm()
    uneven = posed(
        "three layers", weights=[1.0 + n for n in range(len(posed("three layers").weights))]
    )
    problem = posed("three layers")
    expected = one_by_one(direct, problem, direct.init(problem, None), 3).shadow
    for where, name, other in (
        (steps, "LARGE", 1),
        (steps, "parallel_address", lambda: None),
        (transforms, "_maker", lambda: None),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(where, name, other)
            patch.setattr(steps, "_make_steps", None)
            found = direct.steps(problem, direct.init(problem, None), 3).shadow
        assert (found - expected).abs().max() < 5e-5
    monkeypatch.setattr(steps, "_make_steps", None)
    direct.steps(uneven, direct.init(uneven, None), 2)
    with plain():
        found = direct.steps(problem, direct.init(problem, None), 3).shadow
    assert (found - expected).abs().max() < 5e-5


def test_matrices_of_another_size_are_refused():
    problem = posed("three layers")
    shadow, system = problem.even_start(problem.gram.torus), problem.gram.spectral.system(0, (0, 1))
    narrow = system.symbol._replace(across=system.symbol.across[..., 1:])
    other = system._replace(symbol=narrow)
    with pytest.raises(ValueError, match="found matrices"):
        in_one_call(problem, system=other)
    with pytest.raises(ValueError, match="found matrices"):
        steps_at_once(torch.fft.rfft2(shadow), Coarse(other, [(0.1, 1, 1, 1, 0)], 1.0))
    with pytest.raises(ValueError, match="found planes"):
        in_one_call(problem, data=torch.nn.functional.pad(shadow, (0, 1)))


def test_memory_that_is_short_is_an_error(monkeypatch):
    monkeypatch.setattr(steps._make_steps, "region", Mock(return_value=True))
    with pytest.raises(MemoryError, match="compiled loop"):
        in_one_call(posed("three layers"))


def in_one_call(problem: Problem, *, data=None, system=None):
    gram, row = problem.gram, (0.1, 1, 1, 1, 0)
    shadow = problem.even_start(gram.torus)
    data = problem.back_projected if data is None else data
    known = system or gram.spectral.system(0.0, problem.bounds)
    assert gram.sides is not None
    return steps.steps_in_one_call(shadow, None, data, known, gram.sides, [row])
