"""The network on cells between two steps: compiled or not, for training, in files."""

import math
from dataclasses import replace

import pytest
import torch

from layerfield import DisparitySpec, Display
from layerfield.fast import Learned, LearnedCard, read_learned, write_learned
from layerfield.kernels.cells import SIGNS, told
from layerfield.kernels.compiled import plain
from layerfield.links import Multiplicative
from layerfield.problem import Problem
from layerfield.solve import solve
from layerfield.solvers.learned_admm import LearnedState
from layerfield.solvers.relief import Relief, signs
from layerfield.training.learned_steps import LearnedSteps
from layerfield.training.steps import learn, lessons, problems
from layerfield.training.steps_recipe import StepsRecipe, read_steps_recipe

BOUNDS = (0.1, 0.9)
OF_LOGARITHMS = (-math.inf, 0.0)
of_both = pytest.mark.parametrize("logarithms", [False, True])
each_grid = pytest.mark.parametrize("grid", [(5, 5), (1, 7)])  # there each row is by itself


def network(channels: int = 3) -> Relief:
    generator = torch.Generator().manual_seed(0)
    shapes = []
    for given in (SIGNS, channels):
        shapes += [(channels, given, 3, 3)] * 2 + [(channels,)]
    made = [0.2 * torch.randn(each, generator=generator) for each in (*shapes, (1, channels, 3, 3))]
    return Relief.of(made)


def learned(steps: int) -> LearnedSteps:
    model = LearnedSteps(steps, 2, relief=3)
    with torch.no_grad():
        generator = torch.Generator().manual_seed(1)
        for rows in model.parameters():
            rows.add_(0.1 * torch.randn(rows.shape, generator=generator))
    return model


@pytest.mark.parametrize("by_row", [False, True])
@pytest.mark.parametrize("size", [(40, 57), (16, 24), (3, 64), (1, 1)])
@pytest.mark.parametrize("bounds", [BOUNDS, OF_LOGARITHMS])
def test_compiled_loops_do_what_the_formula_says(size, by_row, bounds):
    torus = size[0] + 3, size[1] + 5
    shadow = bounds[1] - 0.4 + 0.5 * torch.randn(2, 1, 3, 2, *torus)
    found = network().relieve_(shadow.clone(), size, bounds, by_row=by_row)
    low, high = told(bounds)
    with plain():
        expected = network().relieve_(shadow, size, bounds, by_row=by_row)
    torch.testing.assert_close(found, expected, atol=2.5e-5 * (high - low), rtol=0)


def test_logarithms_have_a_least_for_the_network():
    shadow = torch.randn(1, 3, 2, 24, 32) - 2
    found = (
        network().relieve_(shadow.clone(), (24, 32), each) for each in (OF_LOGARITHMS, (-3.0, 0.0))
    )
    assert torch.equal(*found)


def test_the_layers_together_show_the_same_light():
    shadow = 0.5 + 0.5 * torch.randn(1, 3, 3, 50, 60)
    change = network().relieve_(shadow.clone(), (44, 51), BOUNDS) - shadow
    assert change[..., :44, :51].abs().max() > 0.01
    assert change.sum(dim=1).abs().max() < 1e-5
    assert not change[..., 44:, :].any()
    assert not change[..., 51:].any()


def test_signs_are_those_of_the_pixels_of_four_windows():
    shadow = torch.full((1, 1, 1, 10, 12), 0.5)
    shadow[..., 1, 1], shadow[..., 3, 4] = -0.06, 1.54
    shadow[..., 9, 11] = 0.3  # beyond the edge it is as it is there
    known = signs(shadow, (10, 12), (-0.1, 1.5))[0, 0, 0]
    # The least is in the window whose middle is further up and to the left, and in no other one.
    expected = torch.tensor([0.04, -0.04, 0.04 / 64, 0.0, 0.0, 0.04]) / 1.6
    expected[0], expected[1] = (0.04 + 3 * 0.6) / 4 / 1.6, 0.0
    expected[2:] *= 10
    torch.testing.assert_close(known[:, 0, 0], expected, atol=1e-6, rtol=0)
    assert known.shape == (SIGNS, 2, 2)
    torch.testing.assert_close(known[:2, 1, 1], torch.tensor([0.4, 1.0]) / 1.6)


def shown(views: tuple[int, int]) -> tuple[Display, torch.Tensor]:
    known = {"name": "mine", "link": "additive", "disparity": [1.0, 0.0, -1.0], "views": views}
    display = Display(DisparitySpec.model_validate(known))
    return display, torch.rand(math.prod(views), 2, 40, 57, dtype=torch.float64)


def posed(display: Display, views: torch.Tensor, *, logarithms: bool) -> Problem:
    problem = Problem.of(display, views)
    if not logarithms:
        return problem
    return replace(problem, link=Multiplicative(darkest=0.05)).in_sum_domain()


@each_grid
@of_both
def test_what_runs_is_what_is_trained(grid, logarithms):
    problem, model = posed(*shown(grid), logarithms=logarithms), learned(3)
    with torch.no_grad():
        made = solve(problem, model.rows().direct, iterations=3).layers
        without = solve(problem, replace(model.rows(), relief=None).direct, iterations=3).layers
        torch.testing.assert_close(made, model(problem), atol=1e-6, rtol=0)
        assert (made - without).abs().max() > 0.01  # what it says counts


@each_grid
@of_both
def test_light_of_double_precision_has_its_network(grid, logarithms):
    (display, views), solver = shown(grid), learned(3).rows().direct
    made, fine = (
        solve(posed(display, each, logarithms=logarithms), solver, iterations=3).layers
        for each in (views.float(), views)
    )
    assert fine.dtype == torch.float64
    # What single precision rounds away: up to 2e-5 in forty draws, of logarithms 4e-5.
    atol = 1e-4 if logarithms else 5e-5
    torch.testing.assert_close(made.double(), fine, atol=atol, rtol=0)


def test_steps_one_by_one_are_those_made_at_once():
    problem = Problem.of(Display.load("additive-3"), torch.rand(25, 1, 40, 57))
    solver = learned(3).rows().direct
    state = solver.init(problem, None)
    for _ in range(3):
        state = solver.step(problem, state)
    first = solver.steps(problem, solver.init(problem, None), 1)
    known = solver.layers(problem, first).clone()
    solver.steps(problem, first, 2)
    assert torch.equal(solver.layers(problem, first), known)  # a state stays as it is
    at_once = solver.steps(problem, solver.init(problem, None), 3)
    assert isinstance(state, LearnedState)
    assert isinstance(at_once, LearnedState)
    torch.testing.assert_close(state.shadow, at_once.shadow, atol=1e-5, rtol=0)


def test_derivatives_reach_the_network():
    problem = Problem.of(Display.load("additive-3"), torch.rand(25, 1, 24, 40))
    model = learned(2)
    model(problem).square().mean().backward()
    assert all(each.grad is not None and each.grad.abs().sum() > 0 for each in model.relief)
    assert len(LearnedSteps(1, 2, relief=3).relief) == 0  # nothing is behind a single step


def test_a_file_holds_the_network(tmp_path):
    card = LearnedCard("fast", "additive", 0.1, "mine", {})
    write_learned(tmp_path / "mine.safetensors", Learned({2: learned(2).rows()}, card))
    found, known = read_learned(tmp_path / "mine.safetensors").steps[2], learned(2).rows()
    assert found.relief is not None
    assert known.relief is not None
    pairs = zip(found.relief.tensors, known.relief.tensors, strict=True)
    assert all(torch.equal(*pair) for pair in pairs)


def test_recipes_with_a_network_are_for_single_pictures():
    known = read_steps_recipe("fast-additive").model_dump(mode="json")
    with pytest.raises(ValueError, match="'relief' is 4, expected 0"):
        StepsRecipe.model_validate(known | {"coarse": 0, "frames": 3})


def test_videos_are_not_learned_from_in_batches():
    known = read_steps_recipe("fast-additive-warm").model_dump(mode="json")
    with pytest.raises(ValueError, match="'batch' is 2, expected none"):
        StepsRecipe.model_validate(known | {"batch": 2})


def test_constants_come_first_and_scenes_in_batches():
    """The network is learned in the last stage; until then it does nothing."""
    stage = {"size": 48, "scenes": 5, "batch": 2, "iterations": 3, "rate": 0.01}
    facts = read_steps_recipe("fast-additive").model_dump(mode="json")
    grids = facts["displays"][1:3]
    facts |= {"size": 48, "scenes": 1, "iterations": 3, "displays": grids, "then": [stage]}
    first, last = StepsRecipe.model_validate(facts).stages
    model = LearnedSteps(*last.rows(2))
    given = problems(last, "training")
    assert [len(each.back_projected) for each in given] == [2, 2, 2, 2, 1, 1]
    assert [len(each.weights) for each in given[:2]] == [25, 9]
    before = [each.detach().clone() for each in model.relief]
    learn(first, model, lessons(first, given), lambda _: None)
    assert all(map(torch.equal, before, model.relief))
    learn(last, model, lessons(last, given), lambda _: None)
    assert not any(map(torch.equal, before, model.relief))
