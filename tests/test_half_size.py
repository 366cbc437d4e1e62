"""Problems at half size: which displays have them, what they ask for, and the way back."""

from dataclasses import replace

import pytest
import torch

from layerfield import Display, Problem, procedural_light_field, solve, synthesize
from layerfield.display_spec import parse_spec
from layerfield.fast import solver_for
from layerfield.half_size import at_half_size, at_whole_size, half_of
from layerfield.kept_views import KeptViews
from layerfield.kernels.compiled import plain
from layerfield.solvers.learned_sweeps import HalfState, LearnedSweeps, SweptState
from layerfield.synthesizer import pose

SIZES = [(64, 96), (65, 97), (50, 33)]


def display(text: str) -> Display:
    return Display(parse_spec(f'name = "d"\nlink = "additive"\n{text}', "a test"))


FIVE = display("views = [5, 5]\ndisparity = [1, 0, -1]")


def noise(*shape: int) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(1))


@pytest.mark.parametrize(
    ("text", "views", "before"),
    [
        ("views = [5, 5]\ndisparity = [1, 0, -1]", 9, (0, 0)),
        ("views = [5, 5]\ndisparity = [2, 1]", 9, (0, 0)),
        ("views = [7, 3]\ndisparity = [2, 0, -2]", 21, (0, 0)),
        ("views = [7, 7]\ndisparity = [1, 0]", 9, (1, 1)),
        ("views = [5, 1]\ndisparity = [1, 0, -1]", 3, (0, 0)),
        ("views = [3, 3]\ndisparity = [1, 0, -1]", None, None),
        ("views = [4, 4]\ndisparity = [1, -1]", None, None),
        ("views = [5, 5]\ndisparity = [1.5, 0]", None, None),
    ],
)
def test_views_are_those_whose_paths_move_by_even_numbers(text, views, before):
    half = half_of(display(text).projection, (64, 64))
    assert (None if half is None else len(half.views)) == views
    if half is not None:
        assert half.before == before
        assert half.projection.is_whole
    assert half_of(display(text).projection, (31, 64)) is None


@pytest.mark.parametrize("kind", ["codes", "long codes", "light", "values"])
@pytest.mark.parametrize("size", SIZES)
def test_means_of_pixels_and_the_way_back_are_what_pytorch_makes(kind, size):
    views = noise(2, 25, 3, *size)
    kept = {
        "codes": KeptViews((views * 255).to(torch.uint8)),
        "long codes": KeptViews((views * 65535).to(torch.uint16)),
        "light": KeptViews((views * 255).to(torch.uint8)).then(lambda codes: codes**2.2),
        "values": KeptViews(views),
    }[kind]
    problem = Problem.of(FIVE, kept)
    half = half_of(problem.projection, problem.view_size)
    assert half is not None
    small = at_half_size(problem, half)
    change = noise(*small.layer_shape) - 0.5
    found = at_whole_size(problem, half, change)
    with plain():
        known = at_half_size(problem, half)
        expected = at_whole_size(problem, half, change)
    torch.testing.assert_close(small.views.all(), known.views.all())
    torch.testing.assert_close(found, expected)
    assert found.shape == problem.layer_shape


def test_layers_of_half_size_lie_where_those_of_whole_size_do():
    """A ramp shows the same at both sizes, wherever layers begin."""
    for shown in (FIVE, display("views = [7, 7]\ndisparity = [1, 0]")):
        height, width = 40, 56
        ramp = torch.linspace(0.2, 0.8, width).expand(shown.view_count, 1, height, width)
        problem = Problem.of(shown, ramp.contiguous())
        half = half_of(problem.projection, problem.view_size)
        assert half is not None
        small = at_half_size(problem, half)
        change = torch.arange(small.layer_shape[-1]).expand(small.layer_shape).float().contiguous()
        made = at_whole_size(problem, half, change) - problem.even_start()
        inside = made[..., 10, 8:-8]
        places = (torch.arange(made.shape[-1]) + half.before[1] + 0.5) / 2 - 0.5
        torch.testing.assert_close(inside, places[8:-8].expand_as(inside), atol=1e-4, rtol=0)


@pytest.mark.parametrize("views", [5, 9])
def test_half_size_is_a_better_start_than_steps_of_whole_size(views, monkeypatch):
    shown = display(f"views = [{views}, {views}]\ndisparity = [1, 0, -1]")
    field = procedural_light_field(
        grid=(views, views), size=(128, 160), disparity_range=(-1.5, 1.5), seed=4
    )
    field = replace(field, stored=(1.3 * field.stored - 0.15).clamp(0, 1))
    problem = pose(field, shown)
    best = problem.mean_square_error(solve(problem, solver_for(problem, 60), iterations=60).layers)
    found = problem.mean_square_error(synthesize(field, shown, method="fast", iterations=2).layers)
    monkeypatch.setattr("layerfield.solvers.learned_sweeps.half_of", lambda *_: None)
    known = problem.mean_square_error(synthesize(field, shown, method="fast", iterations=2).layers)
    assert found < 1.02 * best
    assert found - best < 0.6 * (known - best)


def test_states_at_half_size_serve_other_views():
    field = procedural_light_field(size=(96, 100), seed=4)
    problem = pose(field, FIVE)
    solver = solver_for(problem, 2)
    assert isinstance(solver, LearnedSweeps)
    begun = solver.init(problem, None)
    assert isinstance(begun, HalfState)
    torch.testing.assert_close(solver.layers(problem, begun), problem.even_start().clamp(0, 1))
    state = solver.steps(problem, begun, 2)
    other = pose(replace(field, stored=0.5 * field.stored), FIVE)
    start = solver.init(other, state)
    assert isinstance(start, SweptState)
    cold = solver.layers(other, solver.steps(other, solver.init(other, None), 2))
    gone_on = solver.layers(other, solver.steps(other, start, 3))
    best = solve(other, solver, iterations=40).layers
    errors = [other.mean_square_error(each) for each in (best, gone_on, cold)]
    assert errors[1] < 1.1 * errors[0]
    assert errors[2] < 1.1 * errors[0]
