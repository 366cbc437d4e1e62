"""Every solver on every link it serves: exact targets, brute force, starts, stopping, balance."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch

from layerfield import (
    METHODS,
    DisparitySpec,
    Display,
    LightField,
    Problem,
    Solution,
    layer_figures,
    procedural_light_field,
    psnr,
    reference,
    solve,
    synthesize,
)
from layerfield.links import LINKS
from layerfield.methods import RowsMethod, SolverMethod
from layerfield.panels import dequantise, largest_code, quantise
from layerfield.reference import cached_reference, optimality_gap
from layerfield.scenes import make_scene, render, scenes_for, spot_scene
from layerfield.solvers.fourier_admm import FourierAdmm
from layerfield.solvers.gradient import Gradient
from layerfield.solvers.nmf import Nmf
from layerfield.solvers.rounding import panel_codes
from layerfield.solvers.sweeps import Sweeps
from layerfield.synthesizer import pose

SOLVERS = {  # but for those of rows, see test_row_newton
    m.name: m
    for m in METHODS.values()
    if isinstance(m, SolverMethod) and not isinstance(m, RowsMethod)
}
PAIRS = [(m.name, link) for m in SOLVERS.values() for link in m.links]
PRESETS = {link: f"{link}-3" for link in LINKS}


@pytest.fixture(scope="module")
def scene() -> LightField:
    return procedural_light_field(size=(72, 88), disparity_range=(-1.3, 1.3), seed=5)


def fractional(link: str) -> Display:
    """A display with whole and fractional shifts, and a grid that is not symmetric in depth."""
    return Display(DisparitySpec(link=link, disparity=(1.0, 0.25, -0.6), views=(3, 4)))  # pyright: ignore[reportArgumentType]


def two_layers(link: str) -> Display:
    """With two layers the other one alone is the derivative of a product."""
    return Display(DisparitySpec(link=link, disparity=(1.0, -1.0), views=(3, 3)))  # pyright: ignore[reportArgumentType]


def shown(display: Display, size=(40, 36), seed=1) -> tuple[torch.Tensor, LightField]:
    """Smooth random layers and the views they show: a target that can be met exactly."""
    torch.manual_seed(seed)
    my, mx = display.margin
    shape = (3 * display.layer_count, 1, (size[0] + 2 * my) // 6 + 1, (size[1] + 2 * mx) // 6 + 1)
    coarse = torch.rand(shape)
    fine = torch.nn.functional.interpolate(
        coarse, (size[0] + 2 * my, size[1] + 2 * mx), mode="bilinear"
    )
    layers = fine.unflatten(0, (display.layer_count, 3)).squeeze(2)
    sums = display.link.name != "multiplicative"
    low, high = (0.05, 0.95 / display.layer_count) if sums else (0.4, 0.98)
    layers = low + (high - low) * layers
    views = display(layers[None])
    grid = display.geometry.grid
    assert grid is not None
    return layers[None], LightField(views, grid)


@pytest.mark.parametrize(("method", "link"), PAIRS)
@pytest.mark.parametrize("make", [lambda link: Display.load(PRESETS[link]), fractional])
def test_targets_that_can_be_shown_are_met(method, link, make):
    display = make(link)
    _, field = shown(display)
    floor = {"nmf": 38, "sart": 36, "sweeps": 38}.get(method, 42)
    solution = synthesize(field, display, method=method, iterations=60)
    assert psnr(display(solution.layers), field.views) > floor
    assert 0 <= solution.layers.min() <= solution.layers.max() <= 1


@pytest.mark.parametrize("link", sorted(LINKS))
@pytest.mark.parametrize("make", [lambda link: Display.load(PRESETS[link]), fractional, two_layers])
def test_plain_sweeps_descend_and_keep_an_exact_solution(link, make):
    """The shorter quotient A^T(o L) / A^T(o^2) would blur an exact solution at fractions."""
    display = make(link)
    exact, field = shown(display)
    problem = pose(field, display)
    kept = solve(problem, Sweeps(momentum=0), iterations=3, init=exact)
    assert psnr(display(kept.layers), field.views) > 100
    errors = [
        p.mean_square_error
        for p in solve(problem, Sweeps(momentum=0), iterations=12, history=True).history
    ]
    assert all(after <= before for before, after in pairwise(errors))


def test_additive_solution_equals_dense_least_squares():
    """Box-constrained least squares by coordinate descent on the dense normal equations."""
    display = Display(DisparitySpec(link="additive", disparity=(1.0, -0.5), views=(2, 2)))
    torch.manual_seed(2)
    views = torch.rand(4, 1, 5, 6, dtype=torch.float64) * 1.6  # bounds become active
    problem = Problem.of(display, views)
    shape = problem.back_projected.shape[-5:]
    units = torch.eye(math.prod(shape), dtype=torch.float64).unflatten(-1, shape)
    dense = display.projection.forward(units.squeeze(-5)).flatten(1).T
    dense = dense.numpy()
    normal, right = dense.T @ dense, dense.T @ views.flatten().numpy()
    best = np.full_like(right, 0.3)
    for _ in range(2000):
        for j in range(len(best)):
            if normal[j, j] > 0:
                gradient = normal[j] @ best - right[j]
                best[j] = min(max(best[j] - gradient / normal[j, j], 0.0), 1.0)
    expected = np.square(dense @ best - views.flatten().numpy()).mean()
    found = solve(problem, FourierAdmm(balance=0), iterations=600)
    assert problem.mean_square_error(found.layers) == pytest.approx(expected, rel=1e-4)
    assert optimality_gap(problem, found.layers) < 0.01
    slow = solve(problem, Gradient(), iterations=2000)
    assert problem.mean_square_error(slow.layers) == pytest.approx(expected, rel=1e-3)


def test_gap_bounds_the_distance_to_the_optimum(scene):
    display = Display.load("additive-3")
    problem = pose(scene, display)
    found = reference(problem)
    assert found.kind == "optimum"
    assert found.gap_db is not None and found.gap_db <= 0.01
    for iterations in (3, 10, 100):
        layers = solve(problem, FourierAdmm(), iterations=iterations).layers
        missing = 10 * math.log10(problem.mean_square_error(layers) / found.mean_square_error)
        assert -found.gap_db <= missing <= optimality_gap(problem, layers)


@pytest.mark.parametrize("link", sorted(LINKS))
def test_reference_is_at_least_as_good_as_every_method(scene, link):
    display = Display.load(PRESETS[link])
    scene = replace(scene, stored=scene.views[..., :48, :56])
    problem = pose(scene, display)
    found = reference(problem)
    assert cached_reference(problem) == found
    for method in SOLVERS.values():
        if link in method.links:
            layers = synthesize(scene, display, method=method.name).layers
            assert psnr(display(layers), scene.views) <= found.psnr + 0.01


def test_a_method_that_beats_the_best_known_replaces_it(scene):
    found = reference(pose(scene, Display.load("multiplicative-3")))
    assert found.kind == "best known"
    better = found.improved_by(found.mean_square_error / 2, "a new method")
    assert (better.method, better.mean_square_error) == (
        "a new method",
        found.mean_square_error / 2,
    )
    assert found.improved_by(found.mean_square_error * 2, "a worse one") == found


GOLDEN = {
    ("fourier-admm", "additive"): 32.05,
    ("fast", "additive"): 32.16,
    ("fourier-tiles", "additive"): 32.05,
    ("gradient", "additive"): 30.55,
    ("nmf", "additive"): 29.71,
    ("sart", "additive"): 31.18,
    ("sweeps", "additive"): 31.76,
    ("fourier-admm", "multiplicative"): 34.55,
    ("fast", "multiplicative"): 34.63,
    ("fourier-tiles", "multiplicative"): 34.55,
    ("gradient", "multiplicative"): 29.16,
    ("ntf", "multiplicative"): 33.77,
    ("sweeps", "multiplicative"): 34.30,
    ("fourier-admm", "polarisation"): 33.41,
    ("fourier-tiles", "polarisation"): 33.41,
    ("gradient", "polarisation"): 31.35,
    ("sweeps", "polarisation"): 32.91,
    ("tone", "additive"): 32.14,
    ("tone", "multiplicative"): 34.59,
    ("tone", "polarisation"): 33.46,
}


@pytest.mark.parametrize(("method", "link"), PAIRS)
def test_golden_psnr(scene, method, link):
    display = Display.load(PRESETS[link])
    solution = synthesize(scene, display, method=method, iterations=10)
    assert psnr(display(solution.layers), scene.views) == pytest.approx(
        GOLDEN[method, link], abs=0.02
    )


@pytest.mark.parametrize(("method", "link"), PAIRS)
def test_a_near_point_ends_in_the_front_layer_alone(method, link):
    """PSNR cannot reveal a depth inversion, this does: disparity +1 is layer 0."""
    display = Display.load(PRESETS[link])
    spot = render(spot_scene([((0, 0), 1.0)], size=(48, 48)), display.geometry.slopes)[0]
    views = 1 - 0.8 * spot if link == "multiplicative" else 0.9 * spot
    iterations = 400 if method == "gradient" else 40
    field = LightField(views, (5, 5))
    solution = synthesize(field, display, method=method, iterations=iterations)
    background = 1 if link == "multiplicative" else 0
    light = (solution.layers[0] - background).abs()[..., 12:-12, 12:-12].sum((1, 2, 3))
    assert light[0] > 8 * light[1]
    assert light[0] > 8 * light[2]


# The learned steps of `fast` depend on their number.
@pytest.mark.parametrize(("method", "link"), [p for p in PAIRS if p[0] != "fast"])
def test_starting_again_from_a_solution_goes_on_as_if_never_stopped(scene, method, link):
    display = Display.load(PRESETS[link])
    whole = synthesize(scene, display, method=method, iterations=7)
    first = synthesize(scene, display, method=method, iterations=4)
    second = synthesize(scene, display, method=method, iterations=3, init=first)
    torch.testing.assert_close(second.layers, whole.layers, atol=1e-6, rtol=0)


@pytest.mark.parametrize(("method", "link"), PAIRS)
def test_layers_of_another_method_are_a_start(scene, method, link):
    display = Display.load(PRESETS[link])
    good = synthesize(scene, display, iterations=20)
    more = synthesize(scene, display, method=method, iterations=1, init=good.layers)
    # sart corrects one view after the other and ends a pass in favour of the last ones
    loss = 1.0 if method == "sart" else 0.05
    before, after = (psnr(display(s.layers), scene.views) for s in (good, more))
    assert after > before - loss


def test_a_start_of_the_wrong_shape_is_refused(scene):
    with pytest.raises(ValueError, match=r"shape \(1, 3, 3, 72, 88\), expected"):
        synthesize(scene, Display.load("additive-3"), init=torch.zeros(1, 3, 3, 72, 88))


@pytest.mark.parametrize(("method", "link"), PAIRS)
def test_same_input_same_output_and_batches_equal_singles(scene, method, link):
    display = Display.load(PRESETS[link])
    solver = SOLVERS[method].make(display.link)
    both = torch.stack([scene.views, scene.views.flip(-1) * 0.7])
    batch = solve(Problem.of(display, both), solver, iterations=3).layers
    for b in range(2):
        single = [solve(Problem.of(display, both[b]), solver, iterations=3) for _ in range(2)]
        assert torch.equal(single[0].layers, single[1].layers)
        torch.testing.assert_close(display(batch[b]), display(single[0].layers), atol=1e-5, rtol=0)
        if method != "sweeps":  # it divides by what comes through other layers, however little
            torch.testing.assert_close(batch[b], single[0].layers, atol=1e-5, rtol=0)


@pytest.mark.parametrize(("method", "link"), PAIRS)
def test_solvers_run_in_inference_mode(scene, method, link):
    display, solver = Display.load(PRESETS[link]), SOLVERS[method].make(LINKS[link])
    layers = solve(Problem.of(display, scene.views), solver, iterations=2).layers
    with torch.inference_mode():
        views = scene.views * 1.0
        again = solve(Problem.of(display, views), solver, iterations=2).layers
    torch.testing.assert_close(again, layers, atol=1e-6, rtol=0)


def test_history_callback_and_stopping(scene):
    display = Display.load("additive-3")
    seen: list[int] = []
    solution = synthesize(
        scene, display, iterations=6, history=True, callback=lambda k, _: seen.append(k)
    )
    assert seen == [1, 2, 3, 4, 5, 6] == [p.iteration for p in solution.history]
    assert solution.status == "stopped after the 6 iterations asked for"
    final = solution.history[-1].mean_square_error
    assert final == pytest.approx(10 ** (-psnr(display(solution.layers), scene.views) / 10))
    early = synthesize(scene, display, iterations=400, tolerance=1e-2)
    assert early.iterations < 400
    assert early.status.startswith("converged: no pixel changed by more than 0.01")
    hasty = synthesize(scene, display, iterations=10**6, time_limit=0.05)
    assert hasty.status == "stopped at the time limit of 0.05 s"


def test_zero_iterations_return_the_start(scene):
    solution = synthesize(scene, Display.load("additive-3"), method="nmf", iterations=0)
    mean = scene.views.mean() / 3
    torch.testing.assert_close(solution.layers, mean.expand_as(solution.layers))


@pytest.mark.parametrize(("method", "link"), PAIRS)
def test_weights_favour_views(scene, method, link):
    display = Display.load(PRESETS[link])
    weights = [1.0] * 25
    weights[0] = 50.0
    even = synthesize(scene, display, method=method, iterations=20)
    favoured = synthesize(scene, display, method=method, iterations=20, weights=weights)
    before, after = (psnr(display(s.layers)[0], scene.views[0]) for s in (even, favoured))
    assert after > before + 1


def test_weights_that_make_no_sense_are_refused(scene):
    for weights in ([1.0] * 24, [-1.0] + [1.0] * 24, [0.0] * 25, [math.nan] * 25):
        with pytest.raises(ValueError, match="expected 25 view weights"):
            synthesize(scene, Display.load("additive-3"), weights=weights)


@pytest.mark.parametrize("method", [m for m, link in PAIRS if link == "additive"])
def test_light_without_detail_is_shared_evenly(method):
    display = Display.load("additive-3")
    grey = LightField(torch.full((25, 1, 20, 24), 0.6), (5, 5))
    layers = synthesize(grey, display, method=method, iterations=20).layers
    torch.testing.assert_close(layers, torch.full_like(layers, 0.2), atol=2e-3, rtol=0)


def test_balance_evens_out_the_layers_at_hardly_any_cost(scene):
    """The optimum itself leans on few layers; near it, light can be shared more evenly."""
    display = Display.load("additive-3")
    problem = pose(scene, display)
    shares, errors = [], []
    for balance in (0.0, FourierAdmm().balance):
        layers = solve(problem, FourierAdmm(balance=balance), iterations=100).layers
        means = [figure.mean for figure in layer_figures(layers[0])]
        shares.append(max(means) / min(means))
        errors.append(problem.mean_square_error(layers))
    assert shares[1] < 0.8 * shares[0]
    assert errors[1] < 1.01 * errors[0]  # 0.04 dB


def test_balance_keeps_peaks_low():
    """A slanted, textured plane is shared; nothing is piled up in one layer."""
    torch.manual_seed(3)
    plane = 0.5 + 0.2 * torch.rand(1, 3, 128, 128)
    scene = make_scene(plane, [0.0], size=(64, 64), gradients=[(0.02, 0.0)])
    display = Display.load("additive-3")
    views = render(scene, display.geometry.slopes)[0]
    layers = synthesize(LightField(views, (5, 5)), display).layers
    assert layers.max() < 0.6


def test_rounding_together_is_no_worse_than_pixel_by_pixel(scene):
    for link, preset in PRESETS.items():
        display = Display.load(preset)
        problem = pose(scene, display)
        layers = synthesize(scene, display).layers
        errors = {
            rounding: problem.mean_square_error(
                dequantise(panel_codes(problem, layers, bits=8, rounding=rounding))
            )
            for rounding in ("joint", "nearest")
        }
        assert errors["joint"] <= errors["nearest"], link


def test_codes_go_there_and_back():
    for bits in (8, 16):
        layers = torch.rand(3, 1, 5, 6)
        codes = quantise(layers, bits)
        assert (dequantise(codes) - layers).abs().max() <= 0.5001 / largest_code(bits)
        assert torch.equal(quantise(dequantise(codes), bits), codes)
    with pytest.raises(ValueError, match="found 10 bits, expected 8 or 16"):
        largest_code(10)


def test_perspective_scene_is_solved():
    """A scene rendered for viewpoints at a finite distance, fractional shifts throughout."""
    display = Display.load("perspective-3")
    views = render(scenes_for(display.geometry, 1, size=(64, 72), seed=9), display.geometry.slopes)
    field = LightField(views[0], (5, 5))
    ten, many = (synthesize(field, display, iterations=n).layers for n in (10, 300))
    assert psnr(display(many), field.views) - psnr(display(ten), field.views) < 0.3


def test_nmf_in_double_precision_equals_its_plain_form(scene):
    display = Display.load("additive-3")
    problem = pose(replace(scene, stored=scene.views[..., :24, :24].double()), display)
    layers = problem.flat_start()
    for _ in range(5):
        shown_views = display.projection.forward(layers.squeeze(-5))
        below = display.projection.adjoint(shown_views)
        ratio = torch.where(problem.coverage > 0, problem.back_projected[0] / below, 1)
        layers = (layers * ratio).clamp(0, 1)
    found = solve(problem, Nmf(), iterations=5)
    torch.testing.assert_close(found.layers, layers, atol=1e-9, rtol=0)


def test_solutions_say_what_made_them(scene):
    solution = synthesize(scene, Display.load("multiplicative-3"), iterations=2)
    assert isinstance(solution, Solution)
    assert solution.iterations == 2
    assert solution.layers.shape == (1, 3, 3, 76, 92)
    assert solution.seconds > 0


@pytest.mark.parametrize("method", ["fourier-admm", "fast", "fourier-tiles"])
def test_a_state_is_not_taken_to_another_problem(method):
    """The state of even weights knows their Gram matrix; other weights go on from the layers."""
    field, display = procedural_light_field(size=(40, 48), seed=4), Display.load("additive-3")
    even = synthesize(field, display, method=method, iterations=10)
    weights = [3.0 if i == 12 else 0.2 for i in range(25)]
    onward, again = (
        synthesize(field, display, method=method, iterations=10, weights=weights, init=init)
        for init in (even, even.layers)
    )
    assert torch.equal(onward.layers, again.layers)


def test_half_precision_views_are_taken_as_floats():
    views = torch.rand(25, 3, 20, 24).half()
    problem = Problem.of(Display.load("additive-3"), views)
    assert solve(problem, FourierAdmm(), iterations=2).layers.dtype == torch.float32


def test_the_balanced_start_does_not_depend_on_the_scale_of_weights():
    views, display = torch.rand(25, 3, 20, 24), Display.load("additive-3")
    one, tiny = (Problem.of(display, views, [w] * 25).even_start() for w in (1.0, 1e-8))
    torch.testing.assert_close(one, tiny)
