"""Eyes between the viewpoints: their views, their figures, and layers that are made for them."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from layerfield import Display, FieldOptions, LightField, load_light_field, psnr, synthesize
from layerfield.between import given_between, interpolated_between, parse_targets
from layerfield.evaluate import evaluate
from layerfield.eyes import judge_eyes
from layerfield.geometry import grid_points
from layerfield.io import load_eye_views
from layerfield.light_field import EyeViews
from layerfield.panels import dequantise
from layerfield.report.eye_map import write_eye_map
from layerfield.result import make_result
from layerfield.scenes import random_scenes, render
from layerfield.synthesizer import pose

EYES = grid_points((9, 9), (0.5, 0.5))


@pytest.fixture(scope="module")
def around() -> EyeViews:
    """A scene that reaches past the display, seen from every half step."""
    scene = random_scenes(1, size=(48, 56), disparity_range=(-2.0, 1.5), reach=2, seed=4)
    return EyeViews(render(scene, EYES)[0], EYES)


@pytest.fixture(scope="module")
def field(around) -> LightField:
    whole = around.chosen(lambda eye: eye[0].is_integer() and eye[1].is_integer())
    return LightField(whole.views, (5, 5), name="scene")


@pytest.fixture
def stored(around, tmp_path):
    path = tmp_path / "scene.npy"
    np.save(path, around.views.unflatten(0, (9, 9)).movedim(2, -1).numpy())
    return path


def pooled(layers: torch.Tensor, display: Display, eyes: EyeViews) -> float:
    seen = [display.look(layers, display.geometry.slope_at(eye)) for eye in eyes.positions]
    return psnr(torch.stack(seen), eyes.views)


def test_eyes_of_a_stored_field(stored, around):
    found = load_eye_views(stored, FieldOptions(step=2))
    assert found.positions == EYES
    assert torch.equal(found.views, around.views)
    inner = load_eye_views(stored, FieldOptions(step=2, views=(3, 3)))
    assert len(inner.positions) == 49
    assert max(x for x, _ in inner.positions) == 1.5
    assert len(load_eye_views(stored, FieldOptions(step=2, views=(1, 3))).positions) == 7


@pytest.mark.parametrize("shift", [0.0, 0.7, -1.0, 2.0])
@pytest.mark.parametrize("views", [(5, 5), (3, 4), (2, 2)])
def test_eyes_at_viewpoints_see_the_views_however_they_are_cut(stored, shift, views):
    """Also where a shift cuts the views to what they have in common."""
    options = FieldOptions(step=2, views=views, shift=shift, scale=0.5)
    field, found = load_light_field(stored, options), load_eye_views(stored, options)
    assert found.views.shape[1:] == field.views.shape[1:]
    for view, place in zip(field.views, grid_points(views), strict=True):
        assert torch.equal(found.views[found.positions.index(place)], view)
    assert len(given_between(found, field).positions) > 0


def test_figures_between_are_those_of_the_eyes(field, around, quick_references):
    display = Display.load("additive-3")
    rows = evaluate([field], [display], [("fourier-admm", 5)], around=[around])
    found = rows[0].eyes
    assert found is not None
    layers = synthesize(field, display, iterations=5).layers
    between = given_between(around, field)
    assert len(between.positions) == 56
    assert found.psnr_between == pytest.approx(pooled(layers, display, between), abs=1e-2)
    assert [(eye.x, eye.y) for eye in found.by_eye] == list(EYES)
    record = rows[0].as_record()
    assert record["psnr_between"] == found.psnr_between
    assert record["eyes"][0] == {"x": -2.0, "y": -2.0, "psnr": found.by_eye[0].psnr}


def test_an_exact_eye_has_no_figure(around):
    display = Display.load("additive-3")
    layers = torch.rand(1, 3, 3, 52, 60)
    views = torch.stack([display.look(layers, eye) for eye in EYES])
    assert judge_eyes(layers, display, replace(around, views=views)).psnr_between is None


@pytest.mark.parametrize("preset", ["additive-3", "multiplicative-3"])
@pytest.mark.parametrize("method", ["fourier-admm", "sweeps"])
def test_targets_between_serve_eyes_between(field, around, preset, method):
    display, between = Display.load(preset), given_between(around, field)
    gains = {}
    plain = synthesize(field, display, method=method, iterations=20).layers
    for name, eyes, weight in (
        ("given", between, 0.5),
        ("interpolated", interpolated_between(field), 1.0),
    ):
        asked = replace(field, between=replace(eyes, weight=weight))
        layers = synthesize(asked, display, method=method, iterations=20).layers
        cost = psnr(display(plain), field.views) - psnr(display(layers), field.views)
        gains[name] = pooled(layers, display, between) - pooled(plain, display, between)
        assert cost < 0.3
    assert gains["given"] > gains["interpolated"] > 0.05


def test_targets_between_outlive_rounding(field, around):
    """Rounding to 8 bits is against all targets, too."""
    display, between = Display.load("additive-3"), given_between(around, field)
    asked = replace(field, between=replace(between, weight=0.5))
    solution = synthesize(asked, display)
    codes = make_result(asked, display, solution, method="fourier-admm", bits=8).codes
    exact, rounded = (
        pooled(layers, display, between)
        for layers in (solution.layers, dequantise(codes).reshape(solution.layers.shape))
    )
    assert rounded == pytest.approx(exact, abs=0.05)


def test_interpolation_is_exact_for_parabolas():
    y, x = torch.meshgrid(torch.arange(5.0), torch.arange(4.0), indexing="ij")
    views = (0.1 + 0.02 * y**2 + 0.03 * x**2 - 0.01 * x * y).reshape(20, 1, 1, 1)
    found = interpolated_between(LightField(views, (5, 4)))
    assert len(found.positions) == 9 * 7 - 20
    for (px, py), view in zip(found.positions, found.views, strict=True):
        row, column = py + 2, px + 1.5
        expected = 0.1 + 0.02 * row**2 + 0.03 * column**2 - 0.01 * row * column
        assert view.item() == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize(("grid", "count"), [((1, 2), 1), ((1, 3), 2), ((2, 2), 5)])
def test_interpolation_of_few_views(grid, count):
    views = torch.rand(grid[0] * grid[1], 1, 3, 3)
    found = interpolated_between(LightField(views, grid))
    assert len(found.positions) == count
    if grid == (1, 2):
        torch.testing.assert_close(found.views[0], views.mean(0))


def test_problem_with_eyes_is_that_of_a_denser_grid(field, around):
    """As many light paths as a 9x9 display of half the disparity has."""
    display = Display.load("additive-3")
    problem = pose(replace(field, between=given_between(around, field)), display)
    layers = torch.rand(1, 3, 3, 52, 60)
    expected = {eye: display.look(layers, eye) for eye in EYES}
    paths = (*grid_points((5, 5)), *given_between(around, field).positions)
    for i, eye in enumerate(paths):
        torch.testing.assert_close(problem.view(layers, i), expected[eye])


def test_eyes_between_count_as_the_viewpoints_around_them(field, around):
    display, between = Display.load("additive-3"), given_between(around, field)
    fields = replace(field, between=between)
    weights = tuple(float(n) for n in range(25))
    posed = pose(fields, display, weights).weights
    by_eye = dict(zip(between.positions, posed[25:], strict=True))
    assert by_eye[-1.5, -2.0] == pytest.approx(between.weight * 0.5)  # between 0 and 1
    assert by_eye[2.0, 1.5] == pytest.approx(between.weight * 21.5)  # between 19 and 24
    assert by_eye[0.5, 0.5] == pytest.approx(between.weight * 15.0)  # amid 12, 13, 17, 18
    same = [pose(fields, display, [w] * 25) for w in (1.0, 100.0)]
    assert same[1].weights == pytest.approx([100 * w for w in same[0].weights])


def test_networks_ignore_targets_between_and_what_follows_them_does_not(field):
    display = Display.load("additive-3")
    asked = replace(field, between=interpolated_between(field))
    for method, alike in (("stacked-cnn", True), ("stacked-cnn+sweeps", False)):
        plain, served = (synthesize(f, display, method=method).layers for f in (field, asked))
        assert torch.equal(plain, served) is alike


def test_nothing_between(field):
    with pytest.raises(ValueError, match=r"no views between .*--step 2"):
        given_between(EyeViews(field.views, grid_points((5, 5))), field)
    with pytest.raises(ValueError, match="has one view"):
        interpolated_between(LightField(field.views[:1], (1, 1)))


@pytest.mark.parametrize(
    "text", ["", "giving", "given:", "given:0", "given:nan", "interpolated:-1"]
)
def test_targets_that_make_no_sense(text):
    with pytest.raises(ValueError, match="expected given or interpolated"):
        parse_targets(text)


def test_map(field, around, tmp_path, quick_references):
    display = Display.load("additive-3")
    rows = evaluate([field], [display], [("fourier-admm", 2), ("nmf", 2)], around=[around])
    write_eye_map(tmp_path / "map.png", rows)
    assert (tmp_path / "map.png").stat().st_size > 5000
