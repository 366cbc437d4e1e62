"""Eyes anywhere: what they see, and displays for eyes at different distances."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from naive import traced_view

from layerfield import Display, Geometry, PhysicalSpec
from layerfield.links import LINKS
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
    product = display.link.name == "multiplicative"
    scales = display.geometry.scales
    return traced_view(padded[0, :, 0].numpy(), eye, DEPTHS, PITCH, margin, product, scales)


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
    expected = traced_view(padded, (50, 0, 100), (1, 0, -1), 1, (12, 12), False, (1, 1, 1))
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
