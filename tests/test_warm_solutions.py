"""Solves that begin with a solution: of the same views, of others, of another number of them."""

from dataclasses import dataclass, field, replace

import pytest
import torch
from torch import Tensor

from layerfield import METHODS, Display, LightField, Problem, procedural_light_field, synthesize
from layerfield.display_spec import parse_spec
from layerfield.fast import solver_for
from layerfield.kept_views import KeptViews
from layerfield.methods import SolverMethod
from layerfield.solve import solve
from layerfield.solvers.fourier_admm import FourierAdmm
from layerfield.solvers.sweeps import Sweeps, SweepsState
from layerfield.synthesizer import pose

GRID = "views = [5, 5]\ndisparity = [1, 0, -1]"
ROW = "views = [1, 5]\ndisparity = [1, 0, -1]"
BETWEEN = "views = [5, 5]\ndisparity = [0.7, 0, -1.3]"


def display(link: str, text: str = GRID) -> Display:
    return Display(parse_spec(f'name = "d"\nlink = "{link}"\n{text}', "a test"))


def scene(shown: Display, seed: int = 5, size: tuple[int, int] = (48, 56)) -> LightField:
    grid = (shown.view_count // 5, 5)
    return procedural_light_field(grid=grid, size=size, disparity_range=(-2, 2), seed=seed)


def served() -> list[tuple[str, str, str]]:
    """Return methods, links and displays that go together."""
    found = []
    for name, method in METHODS.items():
        for link in ("additive", "multiplicative"):
            text = ROW if name == "row-newton" else GRID
            if isinstance(method, SolverMethod) and link in method.links:
                found.append((name, link, text))
    return found


@pytest.mark.parametrize(("name", "link", "text"), served())
def test_a_solution_is_where_it_was_left(name, link, text):
    """No iteration more changes nothing, of views that are the same ones or as good as those."""
    shown = display(link, text)
    light = scene(shown)
    known = synthesize(light, shown, method=name, iterations=3)
    again = replace(light, stored=light.stored.clone())
    for each in (light, again):
        found = synthesize(each, shown, method=name, iterations=0, init=known).layers
        torch.testing.assert_close(found, known.layers, atol=1e-6, rtol=0)


@pytest.mark.parametrize(("name", "link", "text"), served())
def test_a_start_of_another_number_of_light_fields_is_refused(name, link, text):
    shown = display(link, text)
    light = scene(shown, size=(36, 40))
    several = replace(light, stored=torch.stack([light.stored] * 3))
    pair = replace(light, stored=several.stored[:2])
    known = synthesize(pair, shown, method=name, iterations=2)
    for start in (known, known.layers):
        for other in (several, light):
            with pytest.raises(ValueError, match="layers to start from have shape"):
                synthesize(other, shown, method=name, iterations=1, init=start)


@pytest.mark.parametrize("name", ["fast", "sweeps", "fourier-admm", "gradient"])
@pytest.mark.parametrize("link", ["additive", "multiplicative"])
def test_given_layers_are_clamped(name, link):
    shown = display(link)
    light = scene(shown)
    given = 3 * torch.rand(pose(light, shown).layer_shape, generator=torch.Generator()) - 1
    made = synthesize(light, shown, method=name, iterations=0, init=given.double()).layers
    torch.testing.assert_close(made, given.clamp(0, 1), atol=1e-6, rtol=0)


@pytest.mark.parametrize("text", [GRID, BETWEEN, ROW])
@pytest.mark.parametrize("link", ["additive", "multiplicative"])
def test_what_was_known_of_other_views_does_no_harm(text, link):
    """Slopes, errors and momentum of one scene are not taken for those of another."""
    shown = display(link, text)
    first, second = (pose(scene(shown, seed), shown) for seed in (5, 6))
    known = solve(first, solver_for(first, 6), iterations=6)
    errors = [
        second.mean_square_error(
            solve(second, solver_for(second, 4), iterations=4, init=each).layers
        )
        for each in (known, known.layers)
    ]
    assert errors[0] < 1.01 * errors[1]


def test_the_direct_solver_goes_on_with_what_bounds_it():
    """Its dual, which is known at the optimum, serves views that are a little darker."""
    shown = display("additive")
    problem = pose(scene(shown), shown)
    other = replace(problem, views=KeptViews(problem.views.all() * 0.98))
    known = solve(problem, FourierAdmm(), iterations=60)
    errors = [
        other.mean_square_error(solve(other, FourierAdmm(), iterations=2, init=each).layers)
        for each in (known, None)
    ]
    assert errors[0] < 0.9 * errors[1]


@dataclass(frozen=True)
class Counted(Sweeps):
    """Sweeps that count how often their layers are asked for."""

    asked: list[int] = field(default_factory=list)

    def layers(self, problem: Problem, state: SweepsState) -> Tensor:
        self.asked.append(int(state.count.max()))
        return super().layers(problem, state)


def test_a_tolerance_asks_for_layers_once_an_iteration():
    problem = pose(scene(display("additive")), display("additive"))
    solver = Counted()
    solve(problem, solver, iterations=4, tolerance=1e-9)
    assert len(solver.asked) == 1 + 4 + 1


@pytest.mark.parametrize("link", ["additive", "multiplicative"])
@pytest.mark.parametrize("name", ["fast", "sweeps", "fourier-admm"])
def test_pytorchs_own_precision_makes_no_difference(name, link):
    shown = display(link)
    light = replace(scene(shown), stored=(scene(shown).stored * 255).to(torch.uint8))
    known = synthesize(light, shown, method=name, iterations=3).layers
    torch.set_default_dtype(torch.float64)
    try:
        found = synthesize(light, shown, method=name, iterations=3).layers
    finally:
        torch.set_default_dtype(torch.float32)
    torch.testing.assert_close(found, known, atol=1e-5, rtol=0)
