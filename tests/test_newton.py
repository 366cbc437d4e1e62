"""Newton steps where light is multiplied: slope, curvature, formula, and what they are worth."""

import pytest
import torch

from layerfield import Display, Problem, procedural_light_field, solve, synthesize
from layerfield.display_spec import parse_spec
from layerfield.fast import shipped_steps, steps_for
from layerfield.solvers.newton_admm import NewtonAdmm, scale_of
from layerfield.solvers.slope import slope
from layerfield.solvers.sweeps import Sweeps
from layerfield.synthesizer import pose
from layerfield.training.learned_steps import LearnedSteps, squares

SHOWN = {
    "three layers": "views = [3, 3]\ndisparity = [1, 0, -1]",
    "two layers, fractions": "views = [1, 4]\ndisparity = [0.7, -0.4]",
    "one layer": "views = [2, 2]\ndisparity = [0.0]",
    "six layers": "views = [2, 3]\ndisparity = [2, 1, 0.5, 0, -1, -2]",
}


def display(text: str, link: str = "multiplicative") -> Display:
    return Display(parse_spec(f'name = "d"\nlink = "{link}"\n{text}', "a test"))


def posed(
    kind: str, link: str = "multiplicative", channels: int = 2
) -> tuple[Problem, torch.Tensor]:
    """Return a problem with weights of its own and layers within bounds, in double precision."""
    shown = display(SHOWN[kind], link)
    generator = torch.Generator().manual_seed(3)
    views = torch.rand(shown.view_count, channels, 9, 11, generator=generator).double()
    problem = Problem.of(shown, views, [1.0 + n % 3 for n in range(shown.view_count)])
    layers = torch.rand(problem.layer_shape, generator=generator).double()
    return problem, layers


@pytest.mark.parametrize("link", ["multiplicative", "polarisation"])
@pytest.mark.parametrize("kind", SHOWN)
def test_the_slope_is_the_derivative_of_the_error(kind, link):
    problem, layers = posed(kind, link)
    layers.requires_grad_()
    residuals = [problem.view(layers, i) - problem.light(i) for i in range(len(problem.weights))]
    squares_of = torch.stack([residual.square().sum() for residual in residuals])
    error = (squares_of * torch.tensor(problem.weights)).sum() / 2
    (expected,) = torch.autograd.grad(error, layers)
    curvature = torch.zeros_like(layers)
    assert torch.allclose(slope(problem, layers.detach(), curvature), expected)
    assert torch.allclose(slope(problem, layers.detach()), expected)


@pytest.mark.parametrize("kind", ["three layers", "one layer"])
def test_the_curvature_is_that_of_every_pixel_by_itself(kind):
    """Shifts of whole pixels: the slope along a pixel is linear, for so is what a path shows."""
    problem, layers = posed(kind, channels=1)
    found = torch.zeros_like(layers)
    slope(problem, layers, found)
    for place in [(0, 0, 0, 4, 5), (0, len(problem.projection.shifts[0]) - 1, 0, 3, 2)]:
        step = torch.zeros_like(layers)
        step[place] = 0.25
        rise = slope(problem, layers + step)[place] - slope(problem, layers - step)[place]
        assert torch.isclose(found[place], rise / 0.5)


def test_the_scale_is_a_tenth_where_nobody_looks():
    found = scale_of(torch.tensor([0.0, 9.0, 36.0]).view(1, 1, 1, 1, 3), 9.0)
    assert found.flatten().tolist() == pytest.approx([0.1, 1.0, 2.0])


@pytest.mark.parametrize("kind", SHOWN)
def test_the_newton_steps_are_those_of_the_formula(kind):
    """What runs equals what is trained, and with it its derivatives, by central differences."""
    problem, layers = posed(kind)
    torch.manual_seed(0)
    model = LearnedSteps(1, 0, 3).double()
    with torch.no_grad():
        model.newton.add_(torch.randn_like(model.newton), alpha=0.1)

    def loss() -> torch.Tensor:
        return squares(problem, model.behind(problem, layers)[None]).log().sum()

    made = solve(problem, NewtonAdmm(model.rows().newton), iterations=3, init=layers)
    assert torch.allclose(made.layers, model.behind(problem, layers))
    loss().backward()
    assert model.newton.grad is not None
    for place in ((0, 0), (0, 2), (1, 0), (1, 1), (2, 3), (2, 4)):
        slopes = []
        with torch.no_grad():
            for move in (1e-5, -2e-5):
                model.newton[place] += move
                slopes.append(loss())
            model.newton[place] += 1e-5
        found = (slopes[0] - slopes[1]) / 2e-5
        assert torch.isclose(found, model.newton.grad[place], rtol=1e-4, atol=1e-8)


@pytest.mark.parametrize("kind", ["three layers", "two layers, fractions"])
def test_layers_that_show_the_views_exactly_stay(kind):
    shown = display(SHOWN[kind])
    known = torch.rand(1, len(shown.projection.shifts[0]), 1, 40, 44) * 0.8 + 0.2
    problem = Problem.of(shown, shown(known))
    known = known[..., : problem.layer_shape[-2], : problem.layer_shape[-1]]
    after = solve(problem, NewtonAdmm(), iterations=3, init=known).layers
    assert (after - known).abs().max() < 1e-5


@pytest.mark.parametrize("exponent", [1, 3])
def test_dark_scenes_are_reached_from_bright_layers(exponent):
    """All begin alike, many end dark; with D of the start alone, errors are 9 to 800 times."""
    shown = display("views = [1, 5]\ndisparity = [1, 0, -1]")
    field = procedural_light_field(grid=(1, 5), size=(64, 96), seed=7)
    problem = Problem.of(shown, field.views**exponent)
    best = problem.mean_square_error(solve(problem, Sweeps(), iterations=60).layers)
    found = solve(problem, NewtonAdmm(), iterations=12)
    assert problem.mean_square_error(found.layers) < 1.5 * best


def test_converged_layers_are_not_left():
    """The dual that holds pixels at their bounds is told from the slope."""
    field = procedural_light_field(size=(64, 72), disparity_range=(-1.5, 1.5), seed=4)
    problem = pose(field, Display.load("multiplicative-3"))
    known = solve(problem, Sweeps(), iterations=80).layers
    after = solve(problem, NewtonAdmm(), iterations=3, init=known).layers
    assert problem.mean_square_error(after) < problem.mean_square_error(known) * 1.002


def test_more_newton_steps_are_better_and_more_than_learned_go_on():
    shown = display("views = [5, 5]\ndisparity = [1, 0, -0.5]")
    field = procedural_light_field(size=(96, 120), disparity_range=(-2, 2), seed=3)
    problem = pose(field, shown)
    errors = {
        n: problem.mean_square_error(synthesize(field, shown, method="fast", iterations=n).layers)
        for n in (0, 1, 2, 4, 8, 20)
    }
    assert list(errors.values()) == sorted(errors.values(), reverse=True)
    assert max(shipped_steps("multiplicative").steps) < 20


def test_steps_of_many_layers_do_not_go_astray():
    """Each goes as if the others stayed; with whole steps thirty were no better than none."""
    shown = display("views = [3, 3]\ndisparity = [3, 2.5, 2, 1, 0, -1, -2, -3]")
    field = procedural_light_field(grid=(3, 3), size=(48, 60), seed=2)
    problem = Problem.of(shown, field.views**4)
    errors = []
    for n in (0, 3, 10, 30):
        solver = steps_for(problem).solver(n)
        errors.append(problem.mean_square_error(solve(problem, solver, iterations=n).layers))
    assert errors == sorted(errors, reverse=True)


def test_steps_that_raise_the_error_become_shorter():
    """All layers on one side of the display plane; steps as bold as at first lost 0.6 dB.

    Six learned steps look to the error behind the sixth: the second may raise it.
    """
    shown = display("views = [1, 9]\ndisparity = [-0.5, -1, -1.5, -2]\ntransfer = 'srgb'")
    problem = pose(procedural_light_field(size=(64, 96), grid=(1, 9), seed=2005), shown)
    errors, solver = [], steps_for(problem).solver(6)
    for n in (1, 4, 6, 12, 20):
        errors.append(problem.mean_square_error(solve(problem, solver, iterations=n).layers))
    assert errors == sorted(errors, reverse=True)
    assert solve(problem, solver, iterations=12).state.boldness.item() < 1


def test_behind_the_learned_steps_a_solution_goes_on_as_if_never_stopped():
    shown = display("views = [5, 5]\ndisparity = [1, 0, -0.5]")
    field = procedural_light_field(size=(48, 56), seed=2)
    most = max(shipped_steps("multiplicative").steps)
    whole = synthesize(field, shown, method="fast", iterations=most + 3)
    first = synthesize(field, shown, method="fast", iterations=most)
    second = synthesize(field, shown, method="fast", iterations=3, init=first)
    torch.testing.assert_close(second.layers, whole.layers, atol=1e-6, rtol=0)


def test_subframes_are_left_to_sweeps():
    """Newton steps know one subframe only; the learned start serves both."""
    text = 'name = "d"\nlink = "multiplicative"\nviews = [3, 3]\ndisparity = [1, -1]\nsubframes = 2'
    shown = Display(parse_spec(text, "a test"))
    field = procedural_light_field(grid=(3, 3), size=(40, 40), seed=3)
    made = synthesize(field, shown, method="fast", iterations=2)
    assert made.layers.shape[-5] == 2
    problem = pose(field, shown)
    start = synthesize(field, shown, method="fast", iterations=0).layers
    assert problem.mean_square_error(made.layers) < problem.mean_square_error(start)


def test_solutions_of_other_solvers_are_taken_up():
    shown = Display.load("multiplicative-3")
    field = procedural_light_field(size=(48, 48), seed=1)
    problem = pose(field, shown)
    known = synthesize(field, shown, iterations=20)
    for method, init in (
        ("fast", known),
        ("fourier-admm", synthesize(field, shown, method="fast")),
    ):
        after = synthesize(field, shown, method=method, iterations=2, init=init)
        assert problem.mean_square_error(after.layers) <= 1.01 * problem.mean_square_error(
            init.layers
        )
