"""Three passes over memory: right whatever the display and the size."""

from dataclasses import replace

import pytest
import torch
from displays import SHOWN

from layerfield import Display, procedural_light_field, solve
from layerfield.display_spec import parse_spec
from layerfield.fast import shipped_steps
from layerfield.frequencies import Apart, Spectral
from layerfield.gram import spectral_of
from layerfield.kernels import steps, three_passes
from layerfield.kernels.blends import Blend, Shares
from layerfield.kernels.compiled import plain
from layerfield.kernels.transforms import transforms_made
from layerfield.synthesizer import pose

BOUNDS = (0.0, 1.0)
TERMS = (0.1, 0.003, -1.7, 0.4)
KINDS = [kind for kind in SHOWN if kind not in {"one row", "one layer"}]  # columns count


@pytest.fixture(autouse=True)
def small_ones_too(monkeypatch):
    monkeypatch.setattr(three_passes, "LARGE", 0)


def spectral(kind: str, size: tuple[int, int], dtype: torch.dtype = torch.float32):
    display = Display(parse_spec(f'name = "d"\nlink = "additive"\n{SHOWN[kind]}', "a test"))
    weights = [1.0] * display.view_count
    return spectral_of(display.projection, weights, size, torch.empty(0, dtype=dtype))


def sums(layers: int, size: tuple[int, int], dtype: torch.dtype = torch.float32):
    """What is solved, and what is added to it."""
    generator = torch.Generator().manual_seed(4)
    shape = (2, 1, layers, 2, *size)
    shadow, other = (torch.rand(shape, generator=generator).to(dtype) for _ in range(2))
    right = Blend(Shares(2, -1, 0.3), shadow, BOUNDS, other[..., :-1, :-2])
    return right, Blend(Shares(-1.6, 1, 0.2), shadow, BOUNDS, other)


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("size", [(2, 4), (7, 10), (9, 14), (16, 32), (33, 36), (40, 208)])
def test_layers_are_solved_as_in_double_precision(kind, size, threads):
    torch.set_num_threads(threads)
    known, exact = spectral(kind, size), spectral(kind, size, torch.float64)
    right, added = sums(len(known.symbol), size)
    with transforms_made() as made:
        found = known.solved_pixels(right, *TERMS, added=added)
    pairs = (*right.shadow.shape[:-1], size[1] // 2)
    assert made == [(pairs, False, False), (pairs, False, True)]
    right, added = sums(len(known.symbol), size, torch.float64)
    with plain():
        expected = exact.solved_pixels(right, *TERMS, added=added)
    assert (found - expected).abs().max() <= 1e-5 * expected.abs().max()


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("size", [(20, 24), (33, 36), (40, 208)])
def test_low_frequencies_are_replaced_as_in_double_precision(kind, size, threads):
    """Nothing is added there, and of layers nothing is seen."""
    torch.set_num_threads(threads)
    known, exact = spectral(kind, size), spectral(kind, size, torch.float64)
    right, _ = sums(len(known.symbol), size)
    unseen = torch.full_like(right.shadow, torch.nan)
    nothing = replace(right, shares=Shares(0, 0, 0.3), shadow=unseen)

    def solved(spectral: Spectral, right: Blend) -> torch.Tensor:
        apart = Apart(spectral.coarser(3), lambda part: -3 * part)
        return spectral.solved_pixels(right, *TERMS, apart=apart)

    with transforms_made() as made:
        found = solved(known, nothing)
    assert len(made) == 2
    right, _ = sums(len(known.symbol), size, torch.float64)
    with plain():
        expected = solved(exact, replace(right, shares=Shares(0, 0, 0.3)))
    assert (found - expected).abs().max() <= 1e-5 * expected.abs().max()


@pytest.mark.parametrize("size", [(20, 24), (61, 90)])
def test_the_first_learned_step_is_made_in_three_passes(size, monkeypatch):
    """As by planes one after the other."""
    problem = pose(procedural_light_field(size=size), Display.load("additive-3"))
    step = shipped_steps("additive").solver(1)
    with monkeypatch.context() as patched:
        patched.setattr(three_passes, "LARGE", 1 << 20)
        expected = solve(problem, step, iterations=1).layers
    monkeypatch.setattr(steps, "LARGE", 0)
    found = solve(problem, step, iterations=1).layers
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-4)


def test_solutions_do_not_depend_on_the_threads():
    known = spectral("three layers", (160, 208))
    right, added = sums(3, (160, 208))
    one = known.solved_pixels(right, *TERMS, added=added)
    torch.set_num_threads(3)
    assert torch.equal(known.solved_pixels(right, *TERMS, added=added), one)


def test_other_lengths_and_matrices_are_not_served():
    """Prime factors above 13 are left to others; matrices of another size are refused."""
    known = spectral("three layers", (17, 24))
    right, added = sums(3, (17, 24))
    found = known.solved_pixels(right, *TERMS, added=added)
    with plain():
        expected = known.solved_pixels(right, *TERMS, added=added)
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-5)
    right, added = sums(3, (18, 24))
    with pytest.raises(ValueError, match=r"found matrices .*, expected"):
        known.solved_pixels(right, *TERMS, added=added)
