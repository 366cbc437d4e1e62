"""A, its adjoint and its Gram matrix: exact for every geometry."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from naive import traced_view, view

from layerfield import DisparitySpec, Display, Geometry, PhysicalSpec
from layerfield.band import GridBand, ViewsBand, band_of
from layerfield.composition import compose_views
from layerfield.frequencies import interleaved, inverse, multiply
from layerfield.geometry import grid_points
from layerfield.gram import Gram
from layerfield.lengths import fast_length, fast_width
from layerfield.links import LINKS
from layerfield.projection import Projection

slopes = st.lists(
    st.tuples(st.floats(-2.5, 2.5, width=32), st.floats(-2.5, 2.5, width=32)),
    min_size=1,
    max_size=6,
)
depths = st.lists(st.floats(-2, 2, width=32), min_size=1, max_size=8, unique=True).map(
    lambda z: tuple(sorted(z, reverse=True))
)
distances = st.sampled_from([math.inf, 10.0, 2.5])
geometries = st.builds(
    lambda s, z, d: Geometry(slopes=tuple(s), depths=z, distance=d), slopes, depths, distances
)
sizes = st.tuples(st.integers(1, 9), st.integers(1, 9))


def projection_of(geometry: Geometry) -> Projection:
    return Projection(geometry.shifts, geometry.margin)


def random_layers(geometry: Geometry, size, seed=0, *, batch=(), channels=2):
    torch.manual_seed(seed)
    (my, mx), (y, x) = geometry.margin, size
    shape = (*batch, len(geometry.depths), channels, y + 2 * my, x + 2 * mx)
    return torch.rand(shape, dtype=torch.float64)


@settings(max_examples=60, deadline=None)
@given(geometries, sizes)
def test_adjoint_is_exact(geometry, size):
    projection = projection_of(geometry)
    layers = random_layers(geometry, size)
    views = torch.rand(len(geometry.slopes), 2, *size, dtype=torch.float64)
    left = (projection.forward(layers) * views).sum()
    right = (layers * projection.adjoint(views)).sum()
    assert abs(left - right) <= 1e-10 * max(abs(left), 1e-3)


@settings(max_examples=25, deadline=None)
@given(geometries, sizes)
def test_adjoint_is_the_derivative(geometry, size):
    projection = projection_of(geometry)
    layers = random_layers(geometry, size).requires_grad_()
    views = torch.rand(len(geometry.slopes), 2, *size, dtype=torch.float64)
    (derivative,) = torch.autograd.grad((projection.forward(layers) * views).sum(), layers)
    torch.testing.assert_close(derivative, projection.adjoint(views))


@settings(max_examples=25, deadline=None)
@given(geometries, st.tuples(st.integers(1, 4), st.integers(1, 4)), st.sampled_from(sorted(LINKS)))
def test_views_equal_plain_loops(geometry, size, link):
    layers = random_layers(geometry, size, channels=1)
    views = compose_views(layers[None], projection_of(geometry), LINKS[link])
    for i, shifts in enumerate(geometry.shifts):
        expected = view(layers[:, 0].numpy(), shifts, geometry.margin, link)
        np.testing.assert_allclose(views[i, 0].numpy(), expected, atol=1e-6)


@pytest.mark.parametrize("name", sorted(LINKS))
def test_links_have_the_derivatives_and_bounds_they_name(name):
    link = LINKS[name]
    pixels = [torch.rand(2000, dtype=torch.float64, requires_grad=True) for _ in range(3)]
    (slope,) = torch.autograd.grad(link.compose(pixels).sum(), pixels[1], create_graph=True)
    torch.testing.assert_close(link.derivative(pixels, 1), slope)
    assert slope.abs().max() <= link.steepest
    if link.bend:
        (bend,) = torch.autograd.grad(slope.sum(), pixels[1])
        assert 0.9 * link.bend < bend.abs().max() <= link.bend
    light = torch.rand(100, dtype=torch.float64) * 0.9 + 0.1
    shared = link.from_sum(link.to_sum(light) / 3)
    torch.testing.assert_close(link.compose([shared] * 3), light)


@pytest.mark.parametrize("link", sorted(LINKS))
@pytest.mark.parametrize("depth", [(0.02, 0.004, -0.013), (0.03,), (-0.01, -0.02)])
def test_perspective_equals_traced_rays(link, depth):
    distance, pitch = 0.4, 0.5e-3
    viewpoints = [(-0.03, 0.01), (0.0, 0.0), (0.021, -0.017)]
    spec = PhysicalSpec(
        link=link,  # pyright: ignore[reportArgumentType]
        depth_mm=tuple(z * 1e3 for z in depth),
        pitch_um=pitch * 1e6,
        viewing_distance_mm=distance * 1e3,
        viewpoints_mm=tuple((x * 1e3, y * 1e3) for x, y in viewpoints),
    )
    display = Display(spec)
    layers = random_layers(display.geometry, (5, 7), channels=1)
    views = display(layers[None])
    for i, (x, y) in enumerate(viewpoints):
        expected = traced_view(
            layers[:, 0].numpy(), (x, y, distance), depth, pitch, display.margin, link
        )
        np.testing.assert_allclose(views[i, 0].numpy(), expected, atol=1e-9)


@pytest.mark.parametrize("link", sorted(LINKS))
def test_written_out_derivative_equals_finite_differences(link):
    geometry = Geometry(slopes=((-0.7, 0.3), (0.0, 0.0), (1.0, -0.5)), depths=(1.0, 0.3, -1.2))
    projection, law = projection_of(geometry), LINKS[link]
    layers = random_layers(geometry, (3, 4), channels=1).expand(2, -1, -1, -1, -1).clone()
    layers.requires_grad_()
    torch.autograd.gradcheck(lambda p: compose_views(p, projection, law), layers)


def test_dense_matrix_of_a_tiny_problem():
    """A, A^T and A^T W A as dense matrices, from their action on unit vectors."""
    geometry = Geometry(slopes=((0.5, 0.0), (-1.0, 0.25)), depths=(1.0, -0.5))
    projection = projection_of(geometry)
    shape = random_layers(geometry, (2, 3), channels=1).shape
    units = torch.eye(math.prod(shape), dtype=torch.float64).unflatten(-1, shape)
    dense = projection.forward(units).flatten(1).T
    back = projection.adjoint(
        torch.eye(len(dense), dtype=torch.float64).unflatten(-1, (2, 1, 2, 3)), (0.3, 2.0)
    )
    weights = torch.tensor([0.3, 2.0], dtype=torch.float64).repeat_interleave(6)
    torch.testing.assert_close(back.flatten(1).T, dense.T * weights)
    gram = Gram(projection, (0.3, 2.0), (2, 3), units)
    applied = gram.from_torus(gram(gram.to_torus(units))).flatten(1).T
    torch.testing.assert_close(applied, dense.T @ (weights[:, None] * dense), atol=1e-9, rtol=0)


@settings(max_examples=30, deadline=None)
@given(geometries, st.tuples(st.integers(1, 12), st.integers(1, 12)))
def test_gram_with_band_is_exact(geometry, size):
    """A^T M W A through the Fourier domain equals the two steps through the views."""
    projection = projection_of(geometry)
    layers = random_layers(geometry, size, batch=(2,))
    weights = [1 + 0.5 * i for i in range(len(geometry.slopes))]
    gram = Gram(projection, weights, size, layers)
    found = gram.from_torus(gram(gram.to_torus(layers)))
    expected = projection.adjoint(projection.forward(layers), weights)
    torch.testing.assert_close(found, expected, atol=1e-9, rtol=1e-9)


@settings(max_examples=30, deadline=None)
@given(
    st.tuples(st.integers(2, 5), st.integers(2, 4)),
    st.lists(st.sampled_from([2.0, 1.0, 0.7, 0.25]), min_size=1, max_size=3, unique=True),
    st.tuples(st.integers(1, 14), st.integers(1, 14)),
)
def test_the_band_of_a_grid_is_that_of_its_views(grid, depths, size):
    geometry = Geometry(slopes=grid_points(grid), depths=tuple(sorted(depths, reverse=True)))
    projection, weights = projection_of(geometry), (0.5,) * math.prod(grid)
    layers = random_layers(geometry, size, batch=(2,))
    gram = Gram(projection, weights, size, layers)
    wide = torch.rand(*layers.shape[:-2], *gram.torus, dtype=torch.float64)
    quick = band_of(projection, weights, size, gram.torus)
    assert isinstance(quick, GridBand)
    found, expected = torch.ones_like(wide), torch.ones_like(wide)
    quick.add_(found, wide, 0.3)
    ViewsBand(projection, weights, size, gram.torus).add_(expected, wide, 0.3)
    torch.testing.assert_close(found, expected, atol=1e-12, rtol=1e-12)


@pytest.mark.parametrize("grid", [(2, 2), (3, 4)])
@pytest.mark.parametrize("size", [(1, 2), (9, 14), (130, 90)])
@pytest.mark.parametrize("depths", [(1.0, 0.0, -1.0), (0.6, -0.25), (0.0,)])
def test_the_compiled_band_is_that_of_pytorch(grid, size, depths):
    torch.set_num_threads(3)
    geometry = Geometry(slopes=grid_points(grid), depths=depths)
    projection, weights = projection_of(geometry), (0.5,) * math.prod(grid)
    layers = random_layers(geometry, size, batch=(2,)).float()
    gram = Gram(projection, weights, size, layers)
    wide = torch.randn(*layers.shape[:-2], *gram.torus)
    found, expected = torch.ones_like(wide), torch.ones_like(wide, dtype=torch.float64)
    gram.add_band_(found, wide, 0.3, (-0.5, 0.8))
    gram.add_band_(expected, wide.double(), 0.3, (-0.5, 0.8))
    torch.testing.assert_close(found.double(), expected, atol=1e-4, rtol=1e-5)
    beside = torch.ones_like(wide).mT.contiguous().mT
    gram.add_band_(beside, wide.mT.contiguous().mT, 0.3, (-0.5, 0.8))
    torch.testing.assert_close(beside, found, atol=1e-4, rtol=1e-5)


def test_symbol_is_real_for_symmetric_viewpoints_only():
    grid = Geometry(slopes=grid_points((3, 3)), depths=(1.0, -0.5))
    assert not projection_of(grid).symbol((8, 8), [1.0] * 9).is_complex()
    lopsided = Geometry(slopes=((0.0, 0.0), (1.0, 0.5)), depths=(1.0, -0.5))
    assert projection_of(lopsided).symbol((8, 8), [1.0] * 2).is_complex()


def test_inverse_of_every_frequency():
    geometry = Geometry(slopes=((0.0, 0.0), (1.0, 0.5), (-0.5, 2.0)), depths=(1.0, 0.2, -0.5))
    symbol = projection_of(geometry).symbol((6, 8), [1.0] * 3)
    symbol = symbol + 0.1 * torch.eye(3, dtype=torch.complex128)[:, :, None, None]
    product = torch.einsum("klyx,lmyx->kmyx", symbol, inverse(symbol))
    identity = torch.eye(3, dtype=torch.complex128)[:, :, None, None].expand_as(product)
    torch.testing.assert_close(product, identity, atol=1e-9, rtol=0)


@pytest.mark.parametrize("grid", [(3, 3), (1, 2)])
def test_multiply_equals_einsum(grid):
    points = grid_points(grid) if grid == (3, 3) else ((0.0, 0.0), (1.0, 0.5))
    geometry = Geometry(slopes=points, depths=(1.0, -0.5))
    symbol = projection_of(geometry).symbol((6, 8), [1.0] * len(points))
    spectrum = torch.fft.rfft2(torch.rand(4, 2, 3, 6, 8, dtype=torch.float64))
    expected = torch.einsum("klyx,blcyx->bkcyx", symbol.to(spectrum.dtype), spectrum)
    torch.testing.assert_close(multiply(interleaved(symbol), spectrum), expected)


def test_fast_lengths():
    assert [fast_length(n) for n in (1, 7, 11, 404, 844)] == [1, 7, 12, 405, 845]
    assert fast_length(1029) == 1040  # 3 * 7 * 7 * 7 is slow
    assert [fast_width(n) for n in (1, 7, 11, 404, 1028)] == [2, 8, 12, 416, 1040]


# Symmetries


def test_layer_in_the_display_plane_looks_the_same_from_everywhere():
    display = Display(DisparitySpec(link="additive", disparity=(0.0,), views=(3, 5)))
    views = display(torch.rand(1, 1, 3, 8, 9))
    assert (views == views[0]).all()


def test_shifting_the_viewpoints_shears_the_layers():
    """An eye one step to the right sees each layer moved left by its disparity."""
    layers = torch.rand(1, 2, 1, 30, 30, dtype=torch.float64)
    here = Display(DisparitySpec(link="additive", disparity=(2.0, -1.0), viewpoints=((0.0, 0.0),)))
    sheared = torch.stack([layers[0, 0].roll(-2, -1), layers[0, 1].roll(1, -1)])[None]
    right = here.look(here.surround(layers, (0, 0)), (1.0, 0.0))
    plain = here.look(sheared, (0.0, 0.0))
    torch.testing.assert_close(right[:, 3:-3, 3:-3], plain[:, 3:-3, 3:-3])


@pytest.mark.parametrize("link", sorted(LINKS))
def test_order_of_layers_does_not_matter_to_the_light(link):
    geometry = Geometry(slopes=grid_points((2, 2)), depths=(1.0, 0.25, -1.0))
    layers = random_layers(geometry, (4, 5))
    projection = projection_of(geometry)
    turned = Projection(tuple(s[::-1] for s in projection.shifts), projection.margin)
    torch.testing.assert_close(
        compose_views(layers[None], projection, LINKS[link]),
        compose_views(layers.flip(0)[None], turned, LINKS[link]),
    )


@pytest.mark.parametrize("preset", ["additive-3", "multiplicative-3", "perspective-3"])
def test_an_eye_at_a_viewpoint_sees_that_view(preset):
    display = Display.load(preset)
    layers = random_layers(display.geometry, (9, 8))[None]
    views = display(layers)
    for i in (0, 7, 24):
        torch.testing.assert_close(display.look(layers, display.geometry.slopes[i]), views[i])


def test_an_eye_far_out_sees_neutral_surroundings():
    for name, neutral in (("additive-3", 0.0), ("multiplicative-3", 1.0)):
        display = Display.load(name)
        layers = torch.full((1, 3, 1, 12, 12), 0.5)
        seen = display.look(layers, (50.0, 0.0))
        expected = 0.5 + 2 * neutral if name == "additive-3" else 0.5
        torch.testing.assert_close(seen, torch.full_like(seen, expected))


def test_subframes_are_averaged():
    display = Display.load("multiplicative-3")
    layers = torch.rand(2, 3, 1, 12, 12)
    average = (display(layers[:1]) + display(layers[1:])) / 2
    torch.testing.assert_close(display(layers), average)


@pytest.mark.parametrize("shape", [(1, 2, 3, 20, 24), (1, 4, 3, 20, 24)])
def test_layers_of_another_display_are_refused(shape):
    display, layers = Display.load("additive-3"), torch.zeros(shape)
    looks = (
        display,
        lambda given: display.view(given, 0),
        lambda given: display.look(given, (0, 0)),
    )
    for show in looks:
        with pytest.raises(ValueError, match="subframes, 3 layers"):
            show(layers)


@pytest.mark.parametrize(
    ("disparities", "order"),
    [
        ((1, 0, -1), (1, 0, 2)),
        ((2, 1, 0, -1), (1, 2, 0, 3)),
        ((1.5, 0.5, -0.5, -1.5), (1, 2, 0, 3)),
        ((3, 1, -2, -3), (1, 2, 0, 3)),
        ((1, -1), (0, 1)),
        ((0.3,), (0,)),
    ],
)
def test_layers_between_others_come_first(disparities, order):
    """Whatever side of the screen plane they are on, and how far floats tell them apart."""
    positions = [(x, y) for y in (-1.1, 0, 1.1) for x in (-2.2, 0, 2.2)]
    shifts = tuple(tuple((d * x, d * y) for d in disparities) for x, y in positions)
    assert Projection(shifts, (8, 8)).inner_first == order
