"""Eyes anywhere: what they see, and displays for eyes at different distances."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from naive import traced_view

from layerfield import (
    METHODS,
    Display,
    Geometry,
    LightField,
    PhysicalSpec,
    psnr,
    reference,
    solve,
    synthesize,
)
from layerfield.display_spec import format_spec, parse_spec
from layerfield.links import LINKS
from layerfield.scenes import render, scenes_for, spot_scene
from layerfield.solvers.fourier_admm import FourierAdmm
from layerfield.synthesizer import pose
from layerfield.warped_projection import WarpedProjection, projection_of

PRESETS = ["additive-3", "multiplicative-3", "perspective-3"]
DEPTHS, PITCH = (0.02, 0.004, -0.013), 0.5e-3


def bench(link: str, **keys) -> Display:
    """A physical display with three layers at uneven depths."""
    depths = tuple(z * 1e3 for z in DEPTHS)
    return Display(PhysicalSpec(link=link, depth_mm=depths, pitch_um=PITCH * 1e6, **keys))  # pyright: ignore[reportArgumentType]


def random_layers(display: Display, size=(9, 8), channels=1) -> torch.Tensor:
    torch.manual_seed(0)
    (my, mx), (y, x) = display.margin, size
    shape = (1, display.layer_count, channels, y + 2 * my, x + 2 * mx)
    return torch.rand(shape, dtype=torch.float64)


def traced(display: Display, layers: torch.Tensor, eye: tuple[float, float, float], wider=40):
    """What an eye at (X, Y, Z) metres sees, one ray at a time, the surroundings included."""
    padded = display.surround(layers, tuple(m + wider for m in display.margin), display.margin)  # pyright: ignore[reportArgumentType]
    margin = [m + wider for m in display.margin]
    scales = display.geometry.scales
    return traced_view(
        padded[0, :, 0].numpy(), eye, DEPTHS, PITCH, margin, display.link.name, scales
    )


@pytest.mark.parametrize("preset", PRESETS)
def test_an_eye_at_a_viewpoint_sees_exactly_that_view(preset):
    display = Display.load(preset)
    layers = random_layers(display).float()
    views = display(layers)
    for i, slope in enumerate(display.geometry.slopes):
        assert torch.equal(display.look(layers, slope), views[i])
        assert torch.equal(display.look(layers, slope, display.geometry.distances[i]), views[i])


@pytest.mark.parametrize("link", sorted(LINKS))
@pytest.mark.parametrize("eye", [(-0.03, 0.01, 0.8), (0.05, -0.02, 0.2), (0.3, 0.0, 0.4)])
def test_an_eye_at_any_distance_sees_traced_rays(link, eye):
    display = bench(link, viewing_distance_mm=400.0, viewing_angle_deg=8.0, views=(3, 3))
    layers = random_layers(display, (7, 11))
    seen = display.look(layers, (eye[0] / eye[2], eye[1] / eye[2]), eye[2])
    np.testing.assert_allclose(seen[0].numpy(), traced(display, layers, eye), atol=1e-9)


def test_distance_of_a_display_in_pixel_disparities():
    """At 100 px from viewpoint to viewpoint, an eye 50 px to the side is half a step away."""
    display = Display.load("additive-3")
    layers = random_layers(display, (7, 9))
    padded = display.surround(layers, (12, 12), display.margin)[0, :, 0].numpy()
    expected = traced_view(padded, (50, 0, 100), (1, 0, -1), 1, (12, 12), "additive", (1, 1, 1))
    np.testing.assert_allclose(display.look(layers, (0.5, 0.0), 100)[0].numpy(), expected)


@pytest.mark.parametrize("distance", [None, 0.03, 0.5, 30.0])
def test_an_eye_however_far_out_sees_surroundings(distance):
    for link, neutral in (("additive", 0.0), ("multiplicative", 1.0)):
        display = bench(link, viewing_distance_mm=400.0, viewing_angle_deg=8.0, views=(3, 3))
        seen = display.look(random_layers(display), (1e9, -1e7), distance)
        torch.testing.assert_close(seen, torch.full_like(seen, neutral))


def test_looking_is_differentiable():
    display = bench(
        "multiplicative", viewing_distance_mm=400.0, viewing_angle_deg=8.0, views=(1, 2)
    )
    layers = random_layers(display, (3, 4)).requires_grad_()
    torch.autograd.gradcheck(lambda p: display.look(p, (0.1, 0.0), 0.9), layers)


@pytest.mark.parametrize("distance", [0.02, 0.0, -1.0, math.nan])
def test_an_eye_at_or_behind_a_layer_is_refused(distance):
    display = bench("additive", viewing_distance_mm=400.0, viewing_angle_deg=8.0, views=(3, 3))
    with pytest.raises(ValueError, match="at or behind the viewer"):
        display.look(random_layers(display), (0.0, 0.0), distance)


# Viewpoints at different distances

points = st.tuples(st.floats(-2.5, 2.5, width=32), st.floats(-2.5, 2.5, width=32))
depths = st.lists(st.floats(-2, 2, width=32), min_size=1, max_size=5, unique=True).map(
    lambda z: tuple(sorted(z, reverse=True))
)
viewpoints = st.lists(st.tuples(points, st.floats(2.5, 20)), min_size=1, max_size=5)


@st.composite
def geometries(draw) -> Geometry:
    slopes, distances = zip(*draw(viewpoints), strict=True)
    return Geometry(slopes=slopes, depths=draw(depths), distance=distances)


@settings(max_examples=80, deadline=None)
@given(geometries(), st.tuples(st.integers(1, 40), st.integers(1, 40)))
def test_adjoint_is_exact_for_any_distances(geometry, size):
    projection = projection_of(geometry)
    (my, mx), count = geometry.margin, len(geometry.depths)
    torch.manual_seed(0)
    layers = torch.rand(count, 2, size[0] + 2 * my, size[1] + 2 * mx, dtype=torch.float64)
    views = torch.rand(len(geometry.slopes), 2, *size, dtype=torch.float64)
    left = (projection.forward(layers) * views).sum()
    right = (layers * projection.adjoint(views)).sum()
    assert abs(left - right) <= 1e-10 * max(abs(left), 1e-3)
    layers.requires_grad_()
    (derivative,) = torch.autograd.grad((projection.forward(layers) * views).sum(), layers)
    torch.testing.assert_close(derivative, projection.adjoint(views))


def test_magnified_by_one_is_a_shift():
    geometry = Geometry(slopes=((-0.7, 0.3), (1.0, -2.5)), depths=(1.0, 0.3, -1.2))
    plain = projection_of(geometry)
    warped = WarpedProjection(plain.shifts, plain.margin, geometry.magnifications)
    layers = torch.rand(3, 1, 5 + 2 * plain.margin[0], 6 + 2 * plain.margin[1], dtype=torch.float64)
    torch.testing.assert_close(warped.forward(layers), plain.forward(layers))


TRACKED = ((-32.0, 1.0, 500.0), (30.0, 0.0, 560.0))  # two eyes of a turned head, mm


def tracked(link: str, viewpoints=TRACKED) -> Display:
    return bench(link, viewpoints_mm=viewpoints)


def shown_to(display: Display, seed=0, size=(96, 128)) -> LightField:
    """A random scene in the depth of a display, seen from its viewpoints."""
    geometry = display.geometry
    scene = scenes_for(geometry, 1, size=size, seed=seed)
    views = render(scene, geometry.slopes, geometry.approaches)[0]
    return LightField(views, geometry.grid or (1, len(views)))


@pytest.mark.parametrize("link", sorted(LINKS))
def test_views_from_different_distances_are_traced_rays(link):
    viewpoints = ((-32.0, 1.0, 300.0), (30.0, 0.0, 560.0), (0.0, 9.0, 900.0))
    display = tracked(link, viewpoints)
    layers = random_layers(display, (7, 60))
    for view, eye in zip(display(layers), viewpoints, strict=True):
        metres = (1e-3 * eye[0], 1e-3 * eye[1], 1e-3 * eye[2])
        np.testing.assert_allclose(view[0], traced(display, layers, metres, wider=0), atol=1e-9)
        slope = (metres[0] / metres[2], metres[1] / metres[2])
        torch.testing.assert_close(display.look(layers, slope, metres[2]), view)


def test_no_light_path_leaves_the_layers():
    """Layers have the grid of the eye that sees most of them, so the margin is that of shifts."""
    geometry = tracked("additive", ((0.0, 0.0, 100.0), (0.0, 0.0, 2000.0))).geometry
    assert max(m for view in geometry.magnifications for m in view) == 1
    assert geometry.margin == (0, 0)
    projection_of(geometry).forward(torch.rand(3, 1, 700, 900))


def test_distances_that_are_alike_are_one_distance():
    point = (5.0, -3.0)
    alike = tracked("additive", ((*point, 500.0), (0.0, 0.0, 500.0)))
    one = bench("additive", viewing_distance_mm=500.0, viewpoints_mm=(point, (0.0, 0.0)))
    assert alike.geometry == one.geometry
    assert alike.geometry.is_regular
    assert not isinstance(alike.projection, WarpedProjection)


def test_scenes_seen_from_different_distances():
    """A disc in space is where its light path to the eye meets the display plane."""
    geometry = tracked("additive").geometry
    here = 1 / np.mean([1 / distance for distance in geometry.distances])
    disparity, centre = 20.0, (25.0, -12.0)  # as an eye at slope 0 sees it, from there
    scene = spot_scene([(centre, disparity)], size=(81, 121), radius=4)
    depth = 1 / (1 / (disparity * PITCH) + 1 / here)
    views = render(scene, geometry.slopes, geometry.approaches)[0, :, 0]
    for view, slope, distance in zip(views, geometry.slopes, geometry.distances, strict=True):
        for axis, size, found in ((0, 121, view.sum(0)), (1, 81, view.sum(1))):
            place = centre[axis] * PITCH * (1 - depth / here)
            expected = (place - slope[axis] * depth) / (1 - depth / distance) / PITCH
            pixels = torch.arange(size) - (size - 1) / 2
            assert (found * pixels).sum() / found.sum() == pytest.approx(expected, abs=0.05)


@pytest.mark.parametrize("link", sorted(LINKS))
@pytest.mark.parametrize("method", ["fourier-admm", "sweeps", "gradient", "sart"])
def test_solvers_serve_different_distances(link, method):
    display = tracked(link)
    if link not in METHODS[method].links:
        return
    field = shown_to(display)
    few, many = (synthesize(field, display, method=method, iterations=n) for n in (1, 30))
    first, last = (psnr(display(s.layers), field.views) for s in (few, many))
    assert last > max(first, 36)
    again = synthesize(field, display, method=method, iterations=1, init=many)
    assert psnr(display(again.layers), field.views) > last - 0.5


def test_two_tracked_eyes_see_far_more_than_a_grid():
    grid = bench("additive", viewing_distance_mm=530.0, viewing_angle_deg=8.0, views=(5, 5))
    for seed in (0, 1):
        figures = []
        for display in (grid, tracked("additive")):
            field = shown_to(display, seed)
            figures.append(psnr(display(synthesize(field, display).layers), field.views))
        assert figures[1] > figures[0] + 10


def test_yardstick_for_different_distances():
    display = tracked("additive")
    field = shown_to(display, size=(24, 32))
    found = reference(pose(field, display))
    assert found.kind == "best known"
    for method in ("fourier-admm", "sweeps", "gradient"):
        layers = synthesize(field, display, method=method).layers
        assert psnr(display(layers), field.views) <= found.psnr + 0.01


def test_what_needs_one_distance_says_so():
    display = tracked("additive")
    field = shown_to(display, size=(24, 32))
    with pytest.raises(ValueError, match="'nmf' needs viewpoints at one distance"):
        synthesize(field, display, method="nmf")
    with pytest.raises(ValueError, match="no Fourier solution"):
        solve(pose(field, display), FourierAdmm(), iterations=1)
    with pytest.raises(ValueError, match="say how far the eye is"):
        display.look(random_layers(display), (0.0, 0.0))
    with pytest.raises(ValueError, match="found 2 distances, expected one for each of 1"):
        Geometry(slopes=((0.0, 0.0),), depths=(1.0,), distance=(3.0, 4.0))


def test_displays_for_different_distances_go_through_toml():
    spec = tracked("multiplicative").spec
    assert parse_spec(format_spec(spec), "again") == spec
