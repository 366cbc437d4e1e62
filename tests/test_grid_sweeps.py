"""Views in a grid: their normal equations, and sweeps that go by them instead of by the views."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest
import torch
from displays import SHOWN

from layerfield import Display, Problem
from layerfield.display_spec import parse_spec
from layerfield.grid_system import grid_system
from layerfield.kept_views import KeptViews
from layerfield.kernels import grid_sweeps
from layerfield.kernels.compiled import plain
from layerfield.solve import Solver, solve
from layerfield.solvers.gradient import Gradient
from layerfield.solvers.sweeps import Sweeps, best_layer

KINDS = {name: text for name, text in SHOWN.items() if name != "one layer"} | {
    "one layer": "views = [2, 2]\ndisparity = [1]",
    "far apart": "views = [5, 3]\ndisparity = [9, -8]",  # no column that all views see
    "one view": "views = [1, 1]\ndisparity = [1, 0]",
    "one column": "views = [4, 1]\ndisparity = [1, -0.5]",
}


def posed(kind: str, size: tuple[int, int] = (75, 20), batch: tuple[int, ...] = ()) -> Problem:
    shown = Display(parse_spec(f'name = "d"\nlink = "additive"\n{KINDS[kind]}', "a test"))
    generator = torch.Generator().manual_seed(5)
    codes = torch.rand(*batch, shown.view_count, 2, *size, generator=generator) * 255
    return Problem.of(shown, KeptViews(codes.to(torch.uint8)), [0.5] * shown.view_count)


def by_the_views(problem: Problem) -> Problem:
    """Return the same in double precision, which no normal equations serve."""
    return replace(problem, views=KeptViews(problem.views.all().double()))


def some_layers(problem: Problem, seed: int = 3) -> torch.Tensor:
    return torch.rand(problem.layer_shape, generator=torch.Generator().manual_seed(seed))


def close(found: torch.Tensor, expected: torch.Tensor) -> bool:
    return torch.allclose(found.double(), expected.double(), atol=3e-6)


def steps_beside_the_views(problem: Problem, solver: Solver, state: Any) -> Iterator[tuple]:
    """Yield states of four steps and those by the views, where compiled and plain layers agree."""
    exact, plainly = by_the_views(problem), state
    expected = type(state)(*(each.double() for each in vars(state).values()))
    for _ in range(4):
        state, expected = solver.step(problem, state), solver.step(exact, expected)
        with plain():
            plainly = solver.step(problem, plainly)
        assert close(state.layers, expected.layers)
        assert close(plainly.layers, expected.layers)
        yield state, expected


@pytest.mark.parametrize("kind", KINDS)
def test_rows_times_columns_are_the_normal_equations(kind):
    problem = posed(kind, (5, 6))
    system, layers = problem.constants.grid, some_layers(problem).double()
    assert system is not None
    expected = torch.zeros_like(layers)
    for i, weight in enumerate(problem.weights):
        view = weight * torch.stack([*problem.projection.windows(layers, i)]).sum(dim=0)
        for k, layer in enumerate(expected.unbind(dim=-4)):
            problem.projection.scatter_(layer, view, i, k)
    for k in range(problem.layer_count):
        total = system.brought(layers, k)
        if system.alone[k]:
            total += layers[..., k, :, :, :] * problem.coverage[k]
        assert torch.allclose(total, expected[..., k, :, :, :], atol=1e-6)
        seen = problem.coverage[k] > 0
        assert torch.allclose(system.gains(k)[None][seen], 1 / problem.coverage[k][seen])
        assert (system.gains(k)[None][~seen] == 0).all()


def test_views_that_are_no_grid_have_none():
    problem = posed("three layers")
    given = problem.projection, problem.weights, problem.view_size
    assert grid_system(*given) is not None
    shifts, weights = problem.projection.shifts, problem.weights
    assert grid_system(given[0], (*weights[:-1], 0.25), given[2]) is None
    fewer = replace(problem.projection, shifts=shifts[:-1])
    assert grid_system(fewer, weights[:-1], given[2]) is None
    twice = replace(problem.projection, shifts=(*shifts[:-1], shifts[0]))
    assert grid_system(twice, weights, given[2]) is None
    all_alike = replace(problem.projection, shifts=shifts[:1] * len(shifts))
    assert grid_system(all_alike, weights, given[2]) is None


@pytest.mark.parametrize("size", [(75, 20), (3, 150), (200, 1)])
@pytest.mark.parametrize("kind", KINDS)
def test_sweeps_are_those_of_the_views(kind, size):
    """Momentum, restarts and pixels that nobody sees included; several parts, and one."""
    problem = posed(kind, size, batch=(2,))
    exact, layers, solver = by_the_views(problem), some_layers(problem), Sweeps()
    begun = replace(solver.init(problem, layers), last=some_layers(problem, 4))
    begun = replace(begun, push=begun.push + 0.9)
    for state, expected in steps_beside_the_views(problem, solver, begun):
        if size[1] > 1:  # of a single column, the direction is soon that of rounding
            assert torch.equal(state.count, expected.count.float())
    for index in range(problem.layer_count):
        known = best_layer(exact, layers.double(), index)
        assert close(best_layer(problem, layers, index), known)
        with plain():
            assert close(best_layer(problem, layers, index), known)


def test_every_pixel_has_a_say_in_whether_it_goes_uphill():
    """Most of a row leads up, its end far down; or the other way round."""
    problem = posed("three layers", (40, 100))
    system, ahead = problem.constants.grid, some_layers(problem)
    assert system is not None
    given = system, problem.back_projected, ahead.clone()
    made, _ = grid_sweeps.swept_(*given, some_layers(problem), (0, 1))
    for sign in (1.0, -1.0):
        way = torch.full_like(made, sign)
        way[..., 70:] = -sign
        last = made - way * (ahead - made)  # so (A - P) (P - last P) has the sign of the way
        expected = ((ahead - made) * (made - last)).sum() > 0
        _, uphill = grid_sweeps.swept_(*given[:2], ahead.clone(), last, (0, 1))
        assert bool(uphill) == bool(expected) == (sign > 0)


@pytest.mark.parametrize("size", [(75, 20), (3, 150), (200, 1)])
@pytest.mark.parametrize("kind", KINDS)
def test_gradients_are_those_of_the_views(kind, size):
    """Steps, momentum and pixels that nobody sees included; several parts, and one."""
    problem, solver = posed(kind, size, batch=(2,)), Gradient()
    begun = solver.init(problem, some_layers(problem))
    begun = replace(begun, ahead=some_layers(problem, 4) * 2 - 0.5)
    for state, expected in steps_beside_the_views(problem, solver, begun):
        if size[1] > 1:  # as above
            assert close(state.momentum, expected.momentum)


@pytest.mark.parametrize("kind", ["three layers", "two layers, fractions"])
def test_threads_change_nothing_and_states_stay(kind):
    problem = posed(kind, (300, 40))
    layers, made = some_layers(problem), list[torch.Tensor]()
    before = layers.clone()
    for threads in (1, 3):
        torch.set_num_threads(threads)
        made.append(solve(problem, Sweeps(), iterations=4, init=layers).layers)
    assert torch.equal(*made)
    assert torch.equal(layers, before)


def test_layers_of_another_display_are_refused():
    problem, other = posed("three layers"), posed("three layers", (60, 20))
    system = other.constants.grid
    assert system is not None
    layers = some_layers(problem)
    with pytest.raises(ValueError, match=r"found layers of shape .*, expected"):
        grid_sweeps.swept_(system, problem.back_projected, layers, layers, (0, 1))
    with pytest.raises(ValueError, match=r"found layers of shape .*, expected"):
        grid_sweeps.moved(system, problem.back_projected, layers, layers, (0, 1))
