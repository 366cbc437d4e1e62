"""G(f) for compiled loops: two rows of numbers where it is their product, or all of it."""

import pytest
import torch
from displays import SHOWN

from layerfield import Display
from layerfield.display_spec import parse_spec
from layerfield.frequencies import Spectral
from layerfield.gram import spectral_of
from layerfield.kernels import three_passes
from layerfield.kernels.blends import Blend, Shares
from layerfield.kernels.compiled import plain
from layerfield.kernels.symbols import symbol_of

SIZE = (18, 24)
TERMS = (0.1, 0.003, -1.7, 0.4)
CENTRE = [1.0, 1.0, 1.0, 1.0, 5.0, 1.0, 1.0, 1.0, 1.0]  # the same both ways round, but no product


def spectral(weights: list[float] | None = None, dtype: torch.dtype = torch.float32) -> Spectral:
    text = f'name = "d"\nlink = "additive"\n{SHOWN["three layers"]}'
    display = Display(parse_spec(text, "a test"))
    known = [1.0] * display.view_count if weights is None else weights
    return spectral_of(display.projection, known, SIZE, torch.empty(0, dtype=dtype))


def test_views_of_a_grid_make_a_product():
    known = spectral().symbol
    found = symbol_of(known)
    assert found.shape == tuple(known.shape)
    assert len(found.whole) == 0
    product = torch.from_numpy(found.down)[..., None] * torch.from_numpy(found.across)[..., None, :]
    torch.testing.assert_close(product, known, rtol=0, atol=1e-6 * known.abs().max().item())


def test_views_that_count_unlike_make_none():
    known = spectral(CENTRE).symbol
    found = symbol_of(known)
    assert found.shape == tuple(known.shape)
    torch.testing.assert_close(torch.from_numpy(found.whole), known, rtol=0, atol=0)


@pytest.mark.parametrize("least", [1, 1 << 20])
def test_both_are_solved_as_in_double_precision(least, monkeypatch):
    """In three passes and plane by plane."""
    monkeypatch.setattr(three_passes, "LARGE", least)
    for weights in (None, CENTRE):
        found, expected = (solved(weights, each) for each in (torch.float32, torch.float64))
        assert (found - expected).abs().max() <= 1e-5 * expected.abs().max()


def solved(weights: list[float] | None, dtype: torch.dtype) -> torch.Tensor:
    known, generator = spectral(weights, dtype), torch.Generator().manual_seed(5)
    shadow = torch.rand(1, 3, 2, *SIZE, generator=generator).to(dtype)
    right = Blend(Shares(2, -1), shadow, (0.0, 1.0))
    added = Blend(Shares(-0.6, 1), shadow, (0.0, 1.0))
    if dtype == torch.float32:
        return known.solved_pixels(right, *TERMS, added=added)
    with plain():
        return known.solved_pixels(right, *TERMS, added=added)
