"""Rows whose light is multiplied: their matrices, compiled loops, the way down, what is refused."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch
from torch import Tensor

from layerfield import (
    Display,
    LightField,
    procedural_light_field,
    solve,
    synthesize,
    synthesize_frames,
)
from layerfield.display_spec import parse_spec
from layerfield.fast import steps_for, takes_rows
from layerfield.kept_views import KeptViews
from layerfield.kernels.compiled import plain
from layerfield.problem import Problem
from layerfield.scenes import animated
from layerfield.solvers.row_gauss_newton import RowGaussNewton, _Rows
from layerfield.solvers.row_newton import to_rows
from layerfield.solvers.sweeps import Sweeps

SIZE = (21, 60)  # no multiple of the eight rows that go together


def display(
    views: str = "[1, 5]", disparity: str = "[1, 0, -1]", more: str = 'transfer = "none"'
) -> Display:
    text = f'name = "d"\nlink = "multiplicative"\nviews = {views}\ndisparity = {disparity}\n{more}'
    return Display(parse_spec(text, "a test"))


@pytest.fixture(scope="module")
def field() -> LightField:
    made = procedural_light_field(grid=(1, 5), size=SIZE, disparity_range=(-1.3, 1.3), seed=2)
    return replace(made, stored=(1.3 * made.stored - 0.15).clamp(0, 1))  # bounds become active


@pytest.mark.parametrize("disparity", ["[1, 0, -1]", "[1, -1]", "[2, 1, 0, -1]"])
def test_equations_are_those_of_what_is_shown(disparity):
    """The fall is that of the error, the matrix J^T W J of what views show."""
    shown = display("[1, 3]", disparity)
    weights, width = [1.0, 0.5, 2.0], 9
    views = torch.rand(3, 1, 1, width, dtype=torch.float64)
    problem = Problem.of(shown, views, weights)
    paths = problem.constants.row_paths
    rows = _Rows.of(
        paths, problem.target.movedim(-4, -2).flatten(-2).unsqueeze(-4), 0.5, (0.0, 1.0)
    )
    layers = torch.rand(problem.layer_shape, dtype=torch.float64)
    x = to_rows(layers)[0, 0, 0]
    assert torch.equal(x.view(-1, problem.layer_count).T, layers[0, :, 0, 0])

    shares = torch.tensor(weights).double().repeat_interleave(width).sqrt()

    def seen(row: Tensor) -> Tensor:
        made = row.view(1, 1, 1, -1, problem.layer_count).permute(0, 4, 1, 2, 3)
        each = torch.stack([problem.view(made, i) for i in range(3)])
        return each.flatten() * shares

    target = problem.target.flatten() * shares
    error = 0.5 * (seen(x) - target).square().sum()
    assert rows.energy(x[None, None, None]).item() == pytest.approx(error.item())
    jacobian = torch.autograd.functional.jacobian(seen, x)
    assert isinstance(jacobian, Tensor)
    dense, slope = jacobian.T @ jacobian, jacobian.T @ (seen(x) - target)
    step = torch.linalg.solve(dense + torch.diag(0.1 * (dense.diagonal() + 0.5)), -slope)
    free = replace(rows, bounds=(-1e9, 1e9))
    prox = torch.full((1, 1, 1, 1), 0.1, dtype=torch.float64)
    made = free.stepped(x[None, None, None], prox)[0, 0, 0]
    torch.testing.assert_close(made, x + step)


@pytest.mark.parametrize(
    ("views", "disparity"),
    [("[1, 5]", "[1, 0, -1]"), ("[1, 5]", "[1, -1]"), ("[1, 5]", "[2, 1, 0, -1]")],
)
@pytest.mark.parametrize("law", ["codes", "linear light", "values"])
def test_compiled_loops_do_what_pytorch_does(field, views, disparity, law):
    """But for a row or two, where rounding decides which pixels stay at bounds."""
    codes = KeptViews((255 * field.views).round().to(torch.uint8))
    given = {"codes": codes, "linear light": codes.then(torch.square), "values": field.views}
    problem = Problem.of(display(views, disparity), given[law], [1, 2, 0.5, 0, 3])
    for count in (1, 3):
        made = solve(problem, RowGaussNewton(), iterations=count)
        with plain():
            expected = solve(problem, RowGaussNewton(), iterations=count)
        if count == 1:
            apart = (made.layers - expected.layers).abs().amax(dim=(-1, -4))
            assert (apart > 5e-4).sum() <= 2  # of 63
        errors = [problem.mean_square_error(each.layers) for each in (made, expected)]
        assert errors[0] == pytest.approx(errors[1], rel=1e-3)


def test_a_few_steps_lead_further_than_many_sweeps(field):
    problem = Problem.of(display(), field.views)
    start = solve(problem, steps_for(problem).solver(6), iterations=6).layers
    many = problem.mean_square_error(solve(problem, Sweeps(), iterations=60, init=start).layers)
    errors = [problem.mean_square_error(solve(problem, RowGaussNewton(), iterations=0).layers)]
    made = solve(problem, RowGaussNewton(), iterations=10, history=True)
    errors += [each.mean_square_error for each in made.history]
    assert all(after <= before * (1 + 1e-6) for before, after in pairwise(errors))
    assert errors[3] < 1.01 * many
    assert errors[10] < many
    assert 0 <= made.layers.min() <= made.layers.max() <= 1


def test_a_row_whose_error_grows_is_taken_back(field):
    """Without sweeps and with next to no penalty the first step goes much too far."""
    problem = Problem.of(display(), field.views)
    bold = RowGaussNewton(sweeps=0, penalty=1e-7)
    start = solve(problem, RowGaussNewton(), iterations=1).layers
    for is_plain in (False, True):
        state, errors = bold.init(problem, start), [problem.mean_square_error(start)]
        for _ in range(4):
            if is_plain:
                with plain():
                    state = bold.step(problem, state)
            else:
                state = bold.step(problem, state)
            errors.append(problem.mean_square_error(state.layers))
        assert all(after <= before * (1 + 1e-5) for before, after in pairwise(errors))
        assert state.factors.max() > 1


def test_pixels_that_no_light_reaches_stay_numbers():
    dark = Problem.of(display("[1, 3]", "[1, 0, -1]"), torch.zeros(3, 3, *SIZE))
    for init in (torch.zeros(dark.layer_shape), torch.ones(dark.layer_shape)):
        made = solve(dark, RowGaussNewton(), iterations=3, init=init).layers
        assert np.isfinite(made.numpy()).all()
        assert dark.mean_square_error(made) < 1e-8


def test_fast_takes_rows_of_whole_pixels(field):
    shown = display()
    assert takes_rows(Problem.of(shown, field.views))
    for other in (display(disparity="[1, 0.5, -1]"), display(disparity="[3, 2, 0, -3]")):
        assert not takes_rows(Problem.of(other, field.views))
    several = display(more="subframes = 2")
    assert not takes_rows(Problem.of(several, field.views))
    fast = synthesize(field, shown, method="fast", iterations=2)
    rows = synthesize(field, shown, method="row-newton", iterations=2)
    assert torch.equal(fast.layers, rows.layers)


@pytest.mark.parametrize("method", ["fast", "row-newton"])
def test_frames_of_a_video(method):
    shown = display()
    views = animated(shown.geometry, 3.0, 4, size=(24, 96), seed=4).clamp(0, 1)
    frames = [LightField(each, (1, 5)) for each in views]
    made = [*synthesize_frames(frames, shown, method=method, iterations=3)]
    for field, solution in zip(frames, made, strict=True):
        best = synthesize(field, shown, method="row-newton", iterations=20)
        assert best.problem is not None
        least = best.problem.mean_square_error(best.layers)
        assert best.problem.mean_square_error(solution.layers) < 1.1 * least


def test_other_displays_are_refused(field):
    square = procedural_light_field(grid=(5, 5), size=(20, 24), seed=1)
    with pytest.raises(ValueError, match=r"in a single row .*'multiplicative-3' has 5x5"):
        synthesize(square, Display.load("multiplicative-3"), method="row-newton")
    with pytest.raises(ValueError, match="shifted by whole pixels, those of 'd' are not"):
        synthesize(field, display(disparity="[1, 0.5, -1]"), method="row-newton")
    with pytest.raises(ValueError, match="single subframe, 'd' has 2; take fast"):
        synthesize(field, display(more="subframes = 2"), method="row-newton")
    sums = Problem.of(display(), field.views).in_sum_domain()
    with pytest.raises(ValueError, match="needs views in a single row"):
        solve(sums, RowGaussNewton(), iterations=1)
