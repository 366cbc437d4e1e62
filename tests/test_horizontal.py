"""Displays with horizontal parallax only: rows of pixels do not know of each other."""

import math
from dataclasses import replace

import pytest
import torch

from layerfield import Display, LightField, procedural_light_field, solve
from layerfield.display_constants import DisplayConstants
from layerfield.display_spec import parse_spec
from layerfield.fast import shipped_steps, steps_for, warm_steps
from layerfield.problem import Problem
from layerfield.projection import Projection
from layerfield.solvers.fourier_admm import FourierAdmm
from layerfield.solvers.tiled_admm import TiledAdmm

GRID, SIZE = (1, 5), (25, 300)


def display(
    text: str = "views = [1, 5]\ndisparity = [1, 0, -1]", link: str = "additive"
) -> Display:
    return Display(parse_spec(f'name = "d"\nlink = "{link}"\n{text}', "a test"))


@pytest.fixture(scope="module")
def field() -> LightField:
    return procedural_light_field(grid=GRID, size=SIZE, seed=2)


def solvers(problem: Problem):
    fast = steps_for(problem)
    known = {"fast": fast.solver(4), "fast, one step": fast.solver(1)}
    if problem.link.is_sum:
        known |= {"direct": FourierAdmm(), "tiles": TiledAdmm(size=240), "warm": warm_steps(3)}
    return known


@pytest.mark.parametrize("link", ["additive", "multiplicative"])
def test_every_row_is_solved_by_itself(field, link):
    """Of layers of which every pixel is seen: others start from the mean of all."""
    shown = display("views = [1, 5]\ndisparity = [1, -1]", link)
    views = field.views.double()
    whole, part = (Problem.of(shown, v) for v in (views, views[..., 11:20, :]))
    for name, solver in solvers(whole).items():
        made, alone = (solve(p, solver, iterations=4).layers for p in (whole, part))
        torch.testing.assert_close(made[..., 11:20, :], alone, atol=1e-12, rtol=0, msg=name)


def test_no_rows_are_added_to_those_of_the_views(field):
    gram = Problem.of(display(), field.views).gram
    assert gram.torus == (SIZE[0], 320)
    assert gram.spectral.by_row
    assert gram.spectral.symbol.shape[-2:] == (1, 161)
    coarser = gram.spectral.coarser(4)
    assert (coarser.torus, coarser.pixels) == ((SIZE[0], 80), 4)


@pytest.mark.parametrize(
    "text", ["views = [3, 5]\ndisparity = [1, -1]", "views = [5, 1]\ndisparity = [1, -1]"]
)
def test_vertical_parallax_joins_rows(text):
    views = torch.rand(display(text).view_count, 3, 20, 24)
    gram = Problem.of(display(text), views).gram
    coarser = gram.spectral.coarser(4)
    assert not gram.spectral.by_row
    assert coarser.pixels == math.prod(gram.torus) / math.prod(coarser.torus)


def test_the_optimum_is_that_of_both_directions(field, monkeypatch):
    """Given time enough, transforms along rows and along both directions lead to the same views."""
    solver = FourierAdmm(balance=0)
    problem = Problem.of(display(), field.views)
    by_row = problem.mean_square_error(solve(problem, solver, iterations=300).layers)
    monkeypatch.setattr(Projection, "is_horizontal", False)
    apart, views = replace(problem), field.views
    projection = replace(problem.projection)  # that has not looked whether it is of rows
    posed = projection, problem.weights, SIZE, views.dtype, views.device
    apart.__dict__["constants"] = DisplayConstants(*posed)  # those that are kept are of rows
    assert not apart.gram.spectral.by_row
    both = apart.mean_square_error(solve(apart, solver, iterations=300).layers)
    assert by_row == pytest.approx(both, rel=1e-3)


def test_tiles_of_rows_make_the_layers_of_the_whole(field):
    problem = Problem.of(display(), field.views.double())
    whole, tiled = (
        solve(problem, solver, iterations=6).layers
        for solver in (FourierAdmm(), TiledAdmm(size=240))
    )
    assert (tiled - whole).abs().max() < 1e-3


def test_thin_pictures_have_rows_that_know_of_each_other():
    """Their coarse grid has a single row of frequencies, and is none of rows by themselves."""
    views = torch.rand(9, 3, 4, 96)
    problem = Problem.of(display("views = [3, 3]\ndisparity = [1, -1]"), views)
    assert problem.gram.torus[0] // 4 == 1
    assert not problem.gram.spectral.coarser(4).by_row
    fast = solve(problem, shipped_steps("additive").solver(4), iterations=4)
    direct = solve(problem, FourierAdmm(), iterations=4)
    assert problem.mean_square_error(fast.layers) < problem.mean_square_error(direct.layers)
