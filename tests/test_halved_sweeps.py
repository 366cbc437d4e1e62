"""Sweeps at half size, then at whole size: what they are worth, and how they go on."""

from dataclasses import replace
from itertools import pairwise

import pytest
import torch

from layerfield import Display, LightField, Problem, procedural_light_field, solve
from layerfield.display_spec import parse_spec
from layerfield.fast import shipped_steps, solver_for
from layerfield.half_size import Half, HalfState, at_half_size, at_whole_size_of_products, half_of
from layerfield.kept_views import KeptViews
from layerfield.kernels.compiled import plain
from layerfield.solvers.fourier_start import FourierStart
from layerfield.solvers.halved_sweeps import HalvedSweeps, _sets_of
from layerfield.solvers.newton_admm import FourierNewton
from layerfield.solvers.sweeps import Sweeps, SweepsState
from layerfield.synthesizer import pose


def display(text: str) -> Display:
    return Display(parse_spec(f'name = "d"\nlink = "multiplicative"\n{text}', "a test"))


FIVE = "views = [5, 5]\ndisparity = [1, 0, -1]"


def posed(text: str = FIVE, seed: int = 5, size: tuple[int, int] = (96, 120)) -> Problem:
    shown = display(text)
    grid = (9, 9) if "[9, 9]" in text else (3, 3) if "[3, 3]" in text else (5, 5)
    field = procedural_light_field(grid=grid, size=size, disparity_range=(-2, 2), seed=seed)
    return pose(field, shown)


def halved(problem: Problem) -> tuple[Half, Problem]:
    half = half_of(problem)
    assert half is not None
    return half, at_half_size(problem, half)


def test_a_display_has_the_solver_that_serves_it():
    cases = {
        FIVE: HalvedSweeps,
        'views = [5, 5]\ndisparity = [1, 0, -1]\ntransfer = "srgb"': HalvedSweeps,
        "views = [5, 5]\ndisparity = [1, -1]\nsubframes = 2": FourierStart,
        "views = [5, 5]\ndisparity = [1, 0, -0.5]": FourierNewton,
        "views = [3, 3]\ndisparity = [1, -1]": FourierStart,
        "views = [3, 3]\ndisparity = [2, -2]": HalvedSweeps,
    }
    for text, kind in cases.items():
        assert type(solver_for(posed(text, size=(40, 40)), 3)) is kind
    small = solver_for(posed(size=(24, 40)), 3)  # half size has no use for so few pixels
    assert isinstance(small, FourierStart)
    assert small.refine.sweeps == 2


def test_what_displays_need_at_half_size_is_kept_with_them():
    """Three displays by turns find theirs again."""
    texts = FIVE, "views = [5, 5]\ndisparity = [1, -1]", "views = [3, 3]\ndisparity = [2, -2]"
    first, again = ([halved(posed(text))[1].constants for text in texts] for _ in range(2))
    assert all(one is other for one, other in zip(first, again, strict=True))


@pytest.mark.parametrize(
    "transfer, dtype, half_a_code",
    [("", torch.uint8, 2e-3), ('transfer = "srgb"', torch.uint16, 8e-6)],
)
def test_eight_bit_views_of_half_size_are_codes(transfer, dtype, half_a_code):
    """Of 8 bits again; light of 16, as that of dark pixels is little."""
    seen = procedural_light_field(size=(96, 120), disparity_range=(-2, 2), seed=5).views
    codes = LightField((255 * seen).round().to(torch.uint8), (5, 5))
    problem = pose(codes, display(f"{FIVE}\n{transfer}"))
    _, small = halved(problem)
    with plain():
        _, expected = halved(problem)
    assert small.views.stored.dtype == dtype
    assert (small.views.all() - expected.views.all()).abs().max() < half_a_code


@pytest.mark.parametrize(
    "text", [FIVE, "views = [5, 5]\ndisparity = [1, -1]", "views = [9, 9]\ndisparity = [1, 0, -1]"]
)
def test_each_iteration_is_better_than_twice_as_many_newton_steps(text):
    problem = posed(text)
    errors = {
        n: problem.mean_square_error(solve(problem, solver_for(problem, n), iterations=n).layers)
        for n in (1, 2, 4, 8, 12)
    }
    for before, after in pairwise(errors.values()):
        assert after < 1.001 * before  # two layers have little to gain behind the second
    steps = shipped_steps("multiplicative")
    for n in (1, 2, 4):
        newton = solve(problem, steps.solver(2 * n), iterations=2 * n).layers
        assert errors[n] < problem.mean_square_error(newton)


def test_sets_of_views_have_none_side_by_side():
    for rows, columns in ((5, 5), (9, 9), (7, 3)):
        text = f"views = [{rows}, {columns}]\ndisparity = [1, 0, -1]"
        sets = _sets_of(display(text).projection)
        assert sorted(n for each in sets for n in each) == [*range(rows * columns)]
        for each in sets:
            assert len(each) >= rows * columns // 3
            for n in each:
                y, x = divmod(n, columns)
                beside = {(y, x + 1), (y + 1, x)}
                assert not any(divmod(other, columns) in beside for other in each)


@pytest.mark.parametrize("kind", ["codes", "light", "values"])
@pytest.mark.parametrize("size", [(40, 44), (41, 45)])
def test_the_way_back_is_what_pytorch_makes(kind, size):
    field = procedural_light_field(size=size, seed=3)
    codes = KeptViews((field.views * 255).round().to(torch.uint8))
    kept = {
        "codes": codes,
        "light": codes.then(lambda values: values**2.2),
        "values": KeptViews(field.views),
    }[kind]
    problem = replace(posed(size=size), views=kept)
    half, small = halved(problem)
    layers = torch.rand(small.layer_shape, generator=torch.Generator().manual_seed(1))
    made = at_whole_size_of_products(problem, half, layers, small)
    with plain():
        expected = at_whole_size_of_products(replace(problem), half, layers, replace(small))
    assert made.shape == problem.layer_shape
    # A level of light between two of the table is taken for either.
    torch.testing.assert_close(made, expected, atol=5e-3, rtol=5e-3)


def test_layers_that_are_smooth_are_found_again():
    """Views of smooth layers, shown at half size: what comes back shows them."""
    problem = posed()
    ys, xs = (torch.linspace(0, 3, n) for n in problem.layer_shape[-2:])
    smooth = 0.6 + 0.2 * torch.sin(ys)[:, None] * torch.cos(xs)
    layers = smooth.expand(problem.layer_shape)
    views = torch.stack([problem.view(layers, n) for n in range(25)])
    known = replace(problem, views=KeptViews(views))
    half, small = halved(known)
    found = layers[..., ::2, ::2] * 0.5 + layers[..., 1::2, 1::2] * 0.5
    made = at_whole_size_of_products(known, half, found, small)
    assert known.mean_square_error(made) < 1e-5


@pytest.mark.parametrize("text", [FIVE, "views = [5, 5]\ndisparity = [2, 0, -2]"])
def test_half_size_is_better_than_twice_as_many_sweeps(text):
    problem = posed(text)
    start = shipped_steps("multiplicative").start(1)
    for n in (2, 4):
        halved, plain_sweeps = (
            problem.mean_square_error(solve(problem, solver, iterations=n).layers)
            for solver in (HalvedSweeps(start), replace(start, refine=Sweeps(sweeps=2)))
        )
        assert halved < plain_sweeps


def test_iterations_one_by_one_are_those_made_at_once():
    problem = posed(size=(48, 56))
    solver = solver_for(problem, 10)
    at_once = solve(problem, solver, iterations=10).layers
    seen = list[int]()
    watched = solve(problem, solver, iterations=10, callback=lambda n, _: seen.append(n)).layers
    assert seen == [*range(1, 11)]
    torch.testing.assert_close(watched, at_once, atol=1e-6, rtol=0)


def test_given_layers_are_swept_on():
    problem = posed(size=(48, 56))
    solver = solver_for(problem, 9)
    first = solve(problem, solver, iterations=9)
    assert isinstance(first.state, SweepsState)
    second = solve(problem, solver, iterations=2, init=first).layers
    torch.testing.assert_close(
        second, solve(problem, solver, iterations=11).layers, atol=1e-6, rtol=0
    )
    early = solve(problem, solver, iterations=2)
    assert isinstance(early.state, HalfState)
    other = replace(problem, views=KeptViews(problem.views.all() * 0.9))
    gone_on = solve(other, solver, iterations=1, init=early).layers
    assert other.mean_square_error(gone_on) < other.mean_square_error(early.layers)


def test_no_iteration_is_a_start():
    problem = posed(size=(48, 56))
    start = solve(problem, solver_for(problem, 1), iterations=0).layers
    assert problem.mean_square_error(start) < problem.mean_square_error(problem.flat_start())


def test_half_size_is_refused_where_there_is_none():
    between = posed("views = [5, 5]\ndisparity = [1, 0, -0.5]", size=(40, 40))
    with pytest.raises(ValueError, match="half size"):
        solve(between, HalvedSweeps(shipped_steps("multiplicative").start(1)), iterations=1)
