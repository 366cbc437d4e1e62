"""Compiled passes over spectra: right whatever the display and the size."""

import pytest
import torch
from displays import SHOWN

from layerfield import Display
from layerfield.display_spec import parse_spec
from layerfield.frequencies import Spectral
from layerfield.gram import spectral_of
from layerfield.kernels import spectra
from layerfield.kernels.compiled import serve

SIZES = [(6, 8), (9, 14), (1, 2), (10, 4), (7, 10), (40, 36)]


@pytest.fixture(params=[0, 1 << 17])
def large(request, monkeypatch):
    """Planes one by one, or all at once."""
    monkeypatch.setattr(spectra, "_LARGE", request.param)


def spectral(
    kind: str,
    size: tuple[int, int],
    weights: list[float] | None = None,
    dtype: torch.dtype = torch.float32,
) -> Spectral:
    display = Display(parse_spec(f'name = "d"\nlink = "additive"\n{SHOWN[kind]}', "a test"))
    known = [1.0] * display.view_count if weights is None else weights
    return spectral_of(display.projection, known, size, torch.empty(0, dtype=dtype))


def planes(layers: int, size: tuple[int, int], batch: tuple[int, ...] = (1,)) -> torch.Tensor:
    generator = torch.Generator().manual_seed(3)
    return torch.rand(*batch, layers, 2, *size, generator=generator)


@pytest.mark.usefixtures("large")
@pytest.mark.parametrize("size", SIZES)
def test_planes_of_any_size_come_back(size):
    values = planes(3, size)
    spectrum = torch.fft.rfft2(values)
    known = spectrum.clone()
    torch.testing.assert_close(spectra.to_pixels(spectrum), values, rtol=0, atol=1e-6)
    assert torch.equal(spectrum, known)


def near(found: torch.Tensor, expected: torch.Tensor) -> bool:
    """To ten times the rounding of PyTorch's single precision."""
    return bool(((found - expected).abs().amax() <= 1e-5 * expected.abs().amax()).item())


@pytest.mark.usefixtures("large")
@pytest.mark.parametrize("kind", SHOWN)
@pytest.mark.parametrize("size", SIZES)
def test_layers_are_solved_as_in_double_precision(kind, size):
    known, exact = spectral(kind, size), spectral(kind, size, dtype=torch.float64)
    values = planes(len(known.symbol), size, (2, 1))
    expected = exact.solved_pixels(values.double(), 0.1, 0.003, gain=1.7)
    assert near(known.solved_pixels(values, 0.1, 0.003, gain=1.7), expected)


@pytest.mark.parametrize("kind", SHOWN)
def test_spectra_are_solved_as_in_double_precision(kind):
    known, exact = spectral(kind, (20, 24)), spectral(kind, (20, 24), dtype=torch.float64)
    values = planes(len(known.symbol), (20, 24), (2, 1))
    terms = (0.05, 0.1, -0.7, 0.3)
    expected = exact.solved_frequencies(exact.to_frequencies(values.double()), *terms)
    assert near(known.solved_frequencies(known.to_frequencies(values), *terms), expected)


def test_what_is_not_served_is_left_to_pytorch():
    """Viewpoints that do not lie symmetrically, double precision, derivatives, odd widths."""
    uneven = spectral("three layers", (20, 24), [1.0 + n for n in range(9)])
    assert uneven.symbol.is_complex()
    assert uneven.solved_pixels(planes(3, (20, 24)), 0.1, 0.0).isfinite().all()
    values = planes(3, (20, 24))
    assert not serve(values.double())
    assert not serve(values.clone().requires_grad_())
    odd = spectral("three layers", (20, 25))
    assert odd.solved_pixels(planes(3, (20, 25)), 0.1, 0.003).shape[-1] == 25


def test_solutions_do_not_depend_on_the_threads():
    known, values = spectral("six layers", (40, 36)), planes(6, (40, 36))
    one = known.solved_pixels(values.clone(), 0.1, 0.003)
    torch.set_num_threads(3)
    assert torch.equal(known.solved_pixels(values, 0.1, 0.003), one)


def test_matrices_of_another_size_are_refused():
    known = spectral("three layers", (20, 24))
    for values in (planes(3, (20, 26)), planes(3, (18, 24))):
        with pytest.raises(ValueError, match=r"found matrices of shape .*, expected"):
            known.solved_pixels(values, 0.1, 0.003)
