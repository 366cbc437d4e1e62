"""Coarse steps in one call: the same as one by one, in double precision."""

import pytest
import torch
from displays import SHOWN

from layerfield import Display
from layerfield.display_spec import parse_spec
from layerfield.fast import shipped_steps
from layerfield.frequencies import low
from layerfield.gram import spectral_of
from layerfield.kernels import small_steps, transforms
from layerfield.kernels.compiled import plain
from layerfield.kernels.small_steps import Coarse, steps_at_once
from layerfield.kernels.transforms import transforms_made
from layerfield.solvers.learned_admm import BALANCE

BOUNDS = (0.1, 0.9)


def known(kind: str, dtype: torch.dtype = torch.float32):
    """A solver, low frequencies of a picture, and the grid they are solved on."""
    display = Display(parse_spec(f'name = "d"\nlink = "additive"\n{SHOWN[kind]}', "a test"))
    weights, like = [1.0] * display.view_count, torch.empty(0, dtype=dtype)
    grid = spectral_of(display.projection, weights, (40, 36), like)
    planes = torch.rand(
        2, 1, len(grid.symbol), 3, 40, 36, generator=torch.Generator().manual_seed(7)
    )
    seen = grid.to_frequencies(planes.to(dtype) * grid.weight * len(grid.symbol))
    return shipped_steps("additive").at_most(4).direct, without_highest(seen, grid), grid


def without_highest(spectrum, grid):
    return low(spectrum, grid.torus, grid.by_row)


@pytest.mark.parametrize("kind", ["three layers", "six layers", "one row"])
@pytest.mark.parametrize("threads", [1, 3])
def test_steps_at_once_are_those_one_by_one(kind, threads):
    torch.set_num_threads(threads)
    solver, seen, grid = known(kind)
    with transforms_made() as made:
        found = solver._solved_coarsely(grid, seen, BOUNDS)
    assert len(made) == 2 * len(solver.coarse) + 2
    with plain():
        _, exact, exact_grid = known(kind, torch.float64)
        expected = without_highest(solver._solved_coarsely(exact_grid, exact, BOUNDS), exact_grid)
    error = (found - expected).abs().max() / expected.abs().max()
    assert error < 3e-5


def test_others_are_made_one_by_one(monkeypatch):
    """Large planes, and where there is no transform to call."""
    solver, seen, grid = known("three layers")
    coarse = Coarse(grid.system(BALANCE, BOUNDS), solver.coarse, grid.pixels)
    expected = solver._solved_coarsely(grid, seen, BOUNDS)
    for where, name, other in (
        (small_steps, "_SMALL", 40 * 36),
        (transforms, "_maker", lambda: None),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(where, name, other)
            assert steps_at_once(seen, coarse) is None
            found = solver._solved_coarsely(grid, seen, BOUNDS)
        assert (found - expected).abs().max() <= 3e-5 * expected.abs().max()
