"""The direct solver in tiles makes the layers of the whole picture."""

from dataclasses import replace

import pytest
import torch

from layerfield import Display, LightField, procedural_light_field, psnr, solve, synthesize
from layerfield.kernels.transforms import transforms_made
from layerfield.problem import Problem
from layerfield.solvers.fourier_admm import AdmmState, FourierAdmm
from layerfield.solvers.fourier_start import FourierStart
from layerfield.solvers.tiled_admm import TiledAdmm, TiledState
from layerfield.synthesizer import pose

CODE = 1 / 255


@pytest.fixture(scope="module")
def field():
    return procedural_light_field(size=(150, 300), seed=3)


def both(problem, iterations):
    """Return the layers of the whole, and those made in tiles."""
    whole, tiled = (
        solve(problem, solver, iterations=iterations)
        for solver in (FourierAdmm(), TiledAdmm(size=210))
    )
    assert (type(whole.state), type(tiled.state)) == (AdmmState, TiledState)
    return whole.layers, tiled.layers


@pytest.mark.parametrize("iterations", [1, 10, 40])
def test_tiles_make_the_layers_of_the_whole(field, iterations):
    display = Display.load("additive-3")
    problem = pose(field, display)
    whole, tiled = both(problem, iterations)
    assert (tiled - whole).abs().max() < CODE / 2
    difference = psnr(display(tiled), field.views) - psnr(display(whole), field.views)
    assert abs(difference) < 0.001


@pytest.mark.parametrize("link", ["multiplicative", "polarisation"])
def test_tiles_serve_other_links(field, link):
    problem = pose(field, Display.load(f"{link}-3"))
    whole = FourierStart(FourierAdmm(), direct_iterations=10)
    tiled = replace(whole, direct=TiledAdmm(size=210))
    made = [solve(problem, each, iterations=1).layers for each in (whole, tiled)]
    assert (made[1] - made[0]).abs().max() < CODE / 2


def test_no_transform_is_larger_than_a_tile(field):
    problem = pose(field, Display.load("additive-3"))
    with transforms_made() as transforms:
        solve(problem, TiledAdmm(size=210), iterations=3)
    width = problem.gram.torus[1]
    assert {2 * each.shape[-1] for each in transforms} == {210} != {width}


def test_no_seam_shows_where_a_dark_half_meets_a_bright_one(field):
    """Light of low frequency, that lies just beyond a seam."""
    views = field.views * 0.2
    views[..., 105:] += 0.8
    display = Display.load("additive-3")
    problem = Problem.of(display, views)
    whole, tiled = (
        solve(problem, solver, iterations=10).layers
        for solver in (FourierAdmm(), TiledAdmm(size=210))
    )
    assert (tiled - whole).abs().max() < CODE / 2
    assert (display(tiled) - display(whole)).abs().max() < CODE / 2


def test_layers_may_be_the_start(field):
    problem = pose(field, Display.load("additive-3"))
    optimum = solve(problem, FourierAdmm(), iterations=60).layers
    again = solve(problem, TiledAdmm(size=210), iterations=3, init=optimum).layers
    ratio = problem.mean_square_error(again) / problem.mean_square_error(optimum)
    assert ratio < 1.02


def test_a_picture_that_fits_is_one_tile(field):
    """In double precision: how single precision is rounded depends on the processor."""
    display = Display.load("additive-3")
    whole, tiled = (
        synthesize(replace(field, stored=field.views.double()), display, method=method).layers
        for method in ("fourier-admm", "fourier-tiles")
    )
    assert tiled.dtype == torch.float64
    torch.testing.assert_close(tiled, whole, rtol=0, atol=1e-12)


def test_tiles_that_are_all_overlap_are_refused(field):
    problem = pose(field, Display.load("additive-3"))
    with pytest.raises(ValueError, match=r"tiles of \d+ px are too small.* take tiles of \d+ px"):
        solve(problem, TiledAdmm(size=100), iterations=1)


def test_tiles_of_a_single_line_of_views():
    line = procedural_light_field(grid=(1, 5), size=(40, 300), seed=1)
    display = Display.load("additive-3")
    row = Display(display.spec.model_copy(update={"views": (1, 5)}))
    problem = pose(LightField(line.views, (1, 5)), row)
    whole, tiled = (
        solve(problem, solver, iterations=5).layers
        for solver in (FourierAdmm(), TiledAdmm(size=210))
    )
    assert (tiled - whole).abs().max() < CODE / 2
