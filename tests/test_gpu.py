"""Kernels for a GPU: the same as PyTorch's own operations.

Where there is no GPU, Triton's interpreter runs them on the processor.
"""

from collections.abc import Iterator
from dataclasses import replace

import pytest
import torch

from layerfield import Display, Problem
from layerfield.back_projection import back_projected
from layerfield.bench.recorded_road import Pipeline, RecordedRoad, refuse_unrecorded
from layerfield.bench.road import EightBitViews, views_to_panels
from layerfield.bench.throughput import displays
from layerfield.display_spec import parse_spec
from layerfield.fast import shipped_steps, solver_for, takes_sweeps
from layerfield.kept_views import KeptViews
from layerfield.kernels import sweep_passes
from layerfield.kernels.blends import Blend, Shares
from layerfield.kernels.compiled import plain
from layerfield.kernels.gpu import serving
from layerfield.panels import largest_code, quantise
from layerfield.projection import Projection
from layerfield.scenes import procedural_light_field
from layerfield.solve import solve
from layerfield.solvers.newton_admm import NewtonAdmm, NewtonState
from layerfield.solvers.slope import slope
from layerfield.solvers.sweeps import Sweeps, best_layer
from layerfield.synthesizer import SOLVERS
from layerfield.transfer import NONE, Curve, Gamma, Srgb

pytest.importorskip("triton")
from layerfield.kernels.gpu import colour_sweeps
from layerfield.kernels.gpu.cufft import to_planes_

DEVICE = "cuda" if torch.cuda.is_available() else "cpu"
SIZE = (6, 13)
SHOWN = (96, 130)  # what whole methods make layers of
VALUES = KeptViews._values
CURVE = Curve(((0.0, 0.01), (0.5, 0.3), (1.0, 1.0)))


@pytest.fixture(autouse=True)
def _kernels_serve(monkeypatch):
    monkeypatch.setattr(serving, "DEVICES", {DEVICE})


def posed(
    link: str = "additive",
    disparity: str = "[1, 0, -1]",
    views: tuple[int, int] = (3, 3),
    *,
    batch: tuple[int, ...] = (),
    size: tuple[int, int] = SIZE,
    transfer: str = "none",
    weights: list[float] | None = None,
    channels: int = 2,
) -> Problem:
    text = f'name = "d"\nlink = "{link}"\nviews = {list(views)}\ndisparity = {disparity}\n'
    display = Display(parse_spec(f'{text}transfer = "{transfer}"', "a test"))
    shape = (*batch, views[0] * views[1], channels, *size)
    codes = drawn(shape, seed=3).mul(255).to(torch.uint8)
    return Problem.of(display, KeptViews(codes), weights)


def drawn(shape: tuple[int, ...], seed: int = 5) -> torch.Tensor:
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed)).to(DEVICE)


def close(one: torch.Tensor, other: torch.Tensor, atol: float = 2e-5) -> None:
    torch.testing.assert_close(one, other, rtol=0, atol=atol)


WEIGHTS = [None, [1.0, 2.0, 0.0, 1.0, 3.0, 1.0, 1.0, 1.0, 0.5]]


@pytest.mark.parametrize("weights", WEIGHTS)
@pytest.mark.parametrize("transfer", ["none", "srgb"])
@pytest.mark.parametrize("disparity", ["[1, 0, -1]", "[1.5, -0.25]"])
def test_views_are_back_projected(disparity, transfer, weights):
    batch = (2,) if weights else ()
    problem = posed(disparity=disparity, batch=batch, transfer=transfer, weights=weights)
    given = problem.projection, problem.views, problem.weights
    with plain():
        expected = back_projected(*given)
    close(back_projected(*given), expected, 4e-3 if transfer == "srgb" else 2e-5)  # half precision


@pytest.mark.parametrize("law", [None, torch.square])
def test_views_of_16_bits_are_back_projected(law):
    problem = posed(views=(2, 2))
    views = KeptViews((problem.views.stored.to(torch.int32) * 257).to(torch.uint16))
    given = problem.projection, views if law is None else views.then(law), problem.weights
    with plain():
        expected = back_projected(*given)
    close(back_projected(*given), expected)


def test_viewpoints_that_are_no_grid_are_back_projected():
    shifts = tuple(((x, y), (-x, -y)) for x, y in [(1.0, 0.0), (0.0, 1.0), (-1.0, -1.0)])
    projection, views = Projection(shifts, (1, 1)), KeptViews(drawn((3, 2, *SIZE)))
    with plain():
        expected = back_projected(projection, views, (1.0,) * 3)
    close(back_projected(projection, views, (1.0,) * 3), expected)


@pytest.mark.parametrize("weights", WEIGHTS)
@pytest.mark.parametrize("link", ["additive", "multiplicative"])
@pytest.mark.parametrize("disparity", ["[1, 0, -1]", "[1]"])
def test_slopes(disparity, link, weights):
    have_the_same_slopes(posed(link, disparity, batch=(2,), weights=weights))


@pytest.mark.parametrize("link", ["additive", "multiplicative"])
def test_slopes_between_pixels(link):
    have_the_same_slopes(posed(link, "[1.5, -0.25]", (2, 2), size=(3, 9)))


def have_the_same_slopes(problem: Problem) -> None:
    count = problem.layer_shape[:-5]
    layers = drawn(problem.layer_shape)
    found = {}
    for name in ("plain", "kernels"):
        curvature, error = torch.empty_like(layers), layers.new_zeros(*count, 1, 1, 1, 1, 1)
        if name == "plain":
            with plain():
                found[name] = slope(problem, layers, curvature, error), curvature, error
        else:
            found[name] = slope(problem, layers, curvature, error), curvature, error
    for one, other in zip(*found.values(), strict=True):
        close(one, other, 1e-3 if one.numel() < 3 else 2e-5)  # errors are sums over views


def test_the_best_of_a_single_layer():
    problem = posed("multiplicative")
    layers = drawn(problem.layer_shape)
    with plain():
        expected = best_layer(problem, layers, 1)
    close(best_layer(problem, layers, 1), expected)


@pytest.mark.parametrize(
    ("disparity", "views"), [("[1, 0, -1]", (3, 3)), ("[1.5, -1]", (3, 2)), ("[1, -1]", (1, 4))]
)
def test_the_band(disparity, views):
    problem = posed(disparity=disparity, views=views)
    gram = problem.gram
    layers = drawn((1, problem.layer_count, 2, *gram.torus)) * 1.4 - 0.2
    sums = [drawn(tuple(layers.shape), seed=7) for _ in range(2)]
    with plain():
        gram.add_band_(sums[0], layers, 0.7, (0.0, 1.0))
    gram.add_band_(sums[1], layers, 0.7, (0.0, 1.0))
    close(sums[1], sums[0])


@pytest.mark.parametrize("onto", [False, True])
@pytest.mark.parametrize("other", [None, (2, 3, 8, 30)])
@pytest.mark.parametrize("shares", [Shares(0.4, 0.7, -2.0), Shares(0, 0, 1.5)])
def test_blends(shares, other, onto):
    shadow = drawn((2, 3, 12, 32)) * 2 - 0.5
    blend = Blend(shares, shadow, (0.0, 1.0), None if other is None else drawn(other, seed=6))
    under = [drawn((2, 3, 12, 32), seed=8) if onto else None for _ in range(2)]
    with plain():
        expected = blend.planes(under[0])
    close(blend.planes(under[1]), expected)


def test_the_balanced_start():
    problem = posed(batch=(2,))
    with plain():
        expected = problem.even_start(problem.gram.torus)
    close(problem.even_start(problem.gram.torus), expected)


def test_the_rim_of_the_balanced_start_is_all_that_its_band_depends_on():
    problem = posed(views=(3, 3), batch=(2,))
    gram = problem.gram
    start = problem.even_start(gram.torus)
    (height, width), (my, mx) = problem.view_size, problem.projection.margin
    rim = problem.even_start(gram.torus, rim=True)
    inner = slice(2 * my, height), slice(2 * mx, width)
    rim[..., *inner] = start[..., *inner]
    assert torch.equal(rim, start)
    rim[..., *inner] = 7.0
    assert torch.equal(gram.band(rim), gram.band(start))


def test_layers_are_cut_out():
    gram = posed(batch=(2,)).gram
    planes = drawn((2, 1, 3, 2, *gram.torus)) * 2 - 0.5
    assert torch.equal(
        gram.clamped_from_torus(planes, (0.0, 1.0)), gram.from_torus(planes).clamp(0, 1)
    )


@pytest.mark.parametrize("views", [(3, 3), (1, 4)])
def test_frequencies_are_solved(views):
    spectral = posed(views=views).gram.spectral
    spectrum = spectral.to_frequencies(drawn((2, 1, 3, 2, *spectral.torus)))
    given = spectrum, 0.05, 0.003, 1.3, 0.2
    with plain():
        expected = spectral.solved_frequencies(*given)
    close(
        *(torch.view_as_real(each) for each in (spectral.solved_frequencies(*given), expected)),
        atol=2e-4,
    )


@pytest.mark.parametrize("by_row", [False, True])
def test_relief(by_row):
    relief = shipped_steps("additive").steps[3].relief
    assert relief is not None
    shadow = (drawn((2, 1, 2, 1, 2 if by_row else 20, 24)) - 0.3) * 1.6
    size = (2, 21) if by_row else (19, 21)
    with plain():
        expected = relief.relieve_(shadow.clone(), size, (-0.1, 1.0), by_row=by_row)
    close(relief.relieve_(shadow.clone(), size, (-0.1, 1.0), by_row=by_row), expected)


def test_newton_steps():
    """Before the first D is unknown; it is found anew in the first three."""
    problem = posed("multiplicative", "[1, -1]", (2, 2), size=(4, 9))
    for found, expected in newton_steps(problem):
        close(found.shadow, expected.shadow, 1e-4)


def newton_steps(problem: Problem) -> Iterator[tuple[NewtonState, NewtonState]]:
    """Return states behind steps from the same one each: of kernels, and of PyTorch."""
    start = (drawn(problem.layer_shape) * 1.2 - 0.1).clamp(0, 1)  # many are at bounds
    solver = NewtonAdmm()
    state = solver.init(problem, start)
    for _ in range(4):
        with plain():
            expected = solver.step(problem, state)
        state = solver.step(problem, state)
        yield state, expected


@pytest.mark.parametrize(
    ("disparity", "views", "transfer", "weights"),
    [
        ("[1, 0, -1]", (3, 3), "none", None),
        ("[1, 0, -1]", (3, 3), "srgb", WEIGHTS[1]),
        ("[2, -1]", (1, 3), "none", [1.0, 0.0, 2.0]),
    ],
)
def test_sweeps_of_three_colours(disparity, views, transfer, weights):
    """Pixels that shine through others are rounded to ten bits, those that are asked for are not.

    One light field of a batch goes uphill in between.
    """
    batch = (2,) if weights is None else ()
    problem = posed(
        "multiplicative", disparity, views, batch=batch, size=(9, 41), transfer=transfer,
        weights=weights, channels=3,
    )  # fmt: skip
    layers = drawn(problem.layer_shape) * 0.8 + 0.2
    assert sweep_passes.serve_colours(problem.light_paths, layers, problem.bounds)
    solver, counts = Sweeps(), list[torch.Tensor]()
    state = solver.init(problem, layers)
    if batch:
        last = torch.stack([layers[0], 2 * layers[1] - 1])
        state = replace(state, last=last, push=state.push + 1)
    for _ in range(3):
        with plain():
            expected = solver.step(problem, state)
        state = solver.step(problem, state)
        apart = (state.layers - expected.layers).abs()
        assert apart.mean() < 5e-4
        assert apart.max() < 1e-2
        assert torch.equal(state.count, expected.count)
        assert torch.equal(state.push, expected.push)
        counts.append(state.count.flatten())
    assert not batch or len({tuple(each.tolist()) for each in counts}) > 1


def test_pixels_that_nobody_sees_stay_in_sweeps():
    problem = posed("multiplicative", "[3, 0]", (1, 2), size=(4, 33), channels=3)
    layers = drawn(problem.layer_shape)
    unseen = (problem.coverage == 0).expand_as(layers)
    assert unseen.any()
    swept = Sweeps().step(problem, Sweeps().init(problem, layers)).layers
    close(swept[unseen], layers[unseen], 1e-3)


def test_what_colours_do_not_serve():
    grey, between = posed("multiplicative"), posed("multiplicative", "[1.5, -0.25]", channels=3)
    for each in (grey, between):
        assert not colour_sweeps.serves(each.light_paths, each.bounds)
        layers = drawn(each.layer_shape)
        assert not sweep_passes.serve_colours(each.light_paths, layers, each.bounds)
    assert takes_sweeps(grey) == (grey.device.type == "cpu")  # they are quick for any colours there
    assert not takes_sweeps(between)
    many = posed("multiplicative", "[3, 2, 1, 0, -1, -2]", channels=3)  # compiled for minutes
    assert not colour_sweeps.serves(many.light_paths, many.bounds)
    deep = posed("multiplicative", "[3, 2, 1, 0, -1, -2, -3]", (3, 1), channels=3)
    assert not colour_sweeps.serves(deep.light_paths, deep.bounds)  # products beyond all numbers
    colours = posed("multiplicative", channels=3)
    assert takes_sweeps(colours)
    with pytest.raises(ValueError, match="found layers of shape"):
        Sweeps().step(colours, Sweeps().init(colours, drawn((2, *colours.layer_shape))))
    assert not takes_sweeps(replace(colours, subframes=2))
    assert not colour_sweeps.serves(colours.light_paths, (0.0, 0.5))


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("transfer", [NONE, Srgb(), Gamma(2.2), CURVE])
def test_codes(transfer, bits):
    """Of what a power makes, some are so near to a half that they go to the other side of it."""
    light = drawn((3, 5, 700)) * 1.2 - 0.1
    light[0, 0, :4] = torch.tensor([0.5, 1.5, 2.5, 3.5]) / 255  # halves
    with plain():
        expected = quantise(light, bits, transfer)
    made = quantise(light, bits, transfer)
    if transfer in (NONE, CURVE):
        assert torch.equal(made, expected)
    exact = transfer.encode(light.double()).clamp(0, 1) * largest_code(bits)
    assert (made.double() - exact).abs().max() < 0.5 + 2e-7 * largest_code(bits) * 4


@pytest.mark.skipif(DEVICE == "cpu", reason="there is no GPU")
@pytest.mark.parametrize("by_row", [False, True])
def test_cufft_makes_the_same_planes(by_row):
    planes = drawn((2, 3, 24, 40))
    spectrum = torch.fft.rfft(planes) if by_row else torch.fft.rfft2(planes)
    made = to_planes_(spectrum, 40, by_row=by_row)
    assert made is not None
    close(made / (40 if by_row else 24 * 40), planes)


@pytest.mark.skipif(DEVICE == "cpu", reason="the interpreter takes minutes")
@pytest.mark.parametrize("transfer", ["none", "srgb"])
@pytest.mark.parametrize("method", ["fast", "fourier-admm", "sweeps"])
@pytest.mark.parametrize("link", ["additive", "multiplicative"])
@pytest.mark.parametrize("views", [(3, 3), (1, 4)])
def test_methods_make_the_same_layers(views, link, method, transfer, monkeypatch):
    problem, again = (
        posed(link, views=views, batch=(2,), size=SHOWN, transfer=transfer) for _ in range(2)
    )
    solver = solver_for(problem, 3) if method == "fast" else SOLVERS[method].make(problem.link)
    with plain(), monkeypatch.context() as patch:
        patch.setattr(KeptViews, "_values", rounded_values)
        expected = solve(again, solver, iterations=3).layers
    found = solve(problem, solver, iterations=3).layers
    assert (found - expected).abs().mean() < 2e-5
    close(found, expected, 2e-3)


def rounded_values(views: KeptViews, stored: torch.Tensor) -> torch.Tensor:
    """What kernels read where a law says what codes stand for: half precision."""
    if views.table is not None:
        views = replace(views, table=views.table.half().float())
    return VALUES(views, stored)


def test_derivatives_are_left_to_pytorch():
    problem = posed()
    layers = drawn(problem.layer_shape).requires_grad_()
    assert not serving.on_gpu(layers)
    with torch.no_grad():
        assert serving.on_gpu(layers)
    assert not serving.on_gpu(layers.detach().double())
    assert not serving.on_gpu(layers.detach().mT)


@pytest.mark.parametrize("method", ["unet", "fourier-tiles"])
def test_methods_that_ask_the_processor_are_not_recorded(method):
    with pytest.raises(ValueError, match=f"'{method}' asks the processor"):
        refuse_unrecorded(method, displays()[0])


def test_displays_that_ask_the_processor_are_not_recorded():
    text = 'name = "d"\nlink = "multiplicative"\nviews = [3, 3]\ndisparity = [1, -1]\nsubframes = 2'
    with pytest.raises(ValueError, match="'d' has 2 subframes"):
        refuse_unrecorded("fast", Display(parse_spec(text, "a test")))


# The last of all: where a recording fails, so does what follows in the same process.
@pytest.mark.skipif(DEVICE == "cpu", reason="there is no GPU")
@pytest.mark.parametrize("method", ["fast", "fourier-admm"])
@pytest.mark.parametrize("display", displays())
def test_a_recorded_road_is_the_road(display, method):
    """For other views, too; the same views make the same panels again."""
    fields = [procedural_light_field(size=(96, 130), seed=seed) for seed in range(3)]
    views = [EightBitViews.of(field, DEVICE) for field in fields]
    road = RecordedRoad(views[0], display, method, 3)
    for each in (*views, views[0]):
        assert torch.equal(road(each).codes, views_to_panels(each, display, method, 3).codes)
    pipeline = Pipeline(views[0], display, method, 3, at_once=2)
    made = [each.codes.clone() for each in pipeline.run(views)]
    for each, codes in zip(views, made, strict=True):
        assert torch.equal(codes, views_to_panels(each, display, method, 3).codes)
        assert torch.equal(codes, pipeline(each).codes)
    grey = EightBitViews(views[0].codes[:, :1], views[0].grid)
    with pytest.raises(ValueError, match="recorded was"):
        road(grey)
