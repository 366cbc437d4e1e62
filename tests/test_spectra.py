"""Compiled passes over spectra: right whatever the display and the size."""

from contextlib import nullcontext

import pytest
import torch
from displays import SHOWN

from layerfield import Display
from layerfield.display_spec import parse_spec
from layerfield.frequencies import Apart, Spectral, low
from layerfield.gram import spectral_of
from layerfield.kernels import mkl
from layerfield.kernels.compiled import plain, serve
from layerfield.kernels.spectra import Pairs
from layerfield.kernels.transforms import transform_, transforms_made

SIZES = [(6, 8), (9, 14), (1, 2), (10, 4), (7, 10), (40, 36), (5, 70)]


@pytest.fixture(params=[0, 1 << 19])
def large(request, monkeypatch):
    """Planes one by one, or all at once."""
    monkeypatch.setattr(mkl, "_LARGE", request.param)


@pytest.fixture(params=["MKL", "compiled", "PyTorch"])
def library(request, monkeypatch):
    if request.param == "MKL":
        monkeypatch.setattr(mkl, "is_intel", lambda: True)
        mkl.library.cache_clear()
        if mkl.library() is None:
            pytest.skip("PyTorch computes with another library here")
        yield
        mkl.library.cache_clear()
    else:
        monkeypatch.setattr(mkl, "library", lambda: None)
        with plain() if request.param == "PyTorch" else nullcontext():
            yield


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


def near(found: torch.Tensor, expected: torch.Tensor) -> bool:
    """To ten times the rounding of PyTorch's single precision."""
    return bool(((found - expected).abs().amax() <= 1e-5 * expected.abs().amax()).item())


@pytest.mark.usefixtures("large", "library")
@pytest.mark.parametrize("by_row", [False, True])
@pytest.mark.parametrize("size", [(1, 1), (9, 7), (10, 4), (17, 3), (40, 36), (44, 208)])
@pytest.mark.parametrize("threads", [2, 7])
def test_transforms_are_those_of_pytorch_without_factors(size, by_row, threads):
    """Planes one by one where all threads have some, or by all threads together."""
    torch.set_num_threads(threads)
    generator = torch.Generator().manual_seed(5)
    values = torch.randn(2, 3, *size, dtype=torch.complex64, generator=generator)
    forth = torch.fft.fft if by_row else torch.fft.fft2
    expected, known = forth(values.to(torch.complex128)), values.clone()
    transform_(values, by_row=by_row)
    assert near(values, expected)
    with transforms_made() as made:
        transform_(values, by_row=by_row, back=True)
    assert made == [((2, 3, *size), by_row, True)]
    points = size[1] if by_row else size[0] * size[1]
    assert near(values / points, known)


def test_other_memory_is_refused():
    """A library past PyTorch would write over what lies beside it."""
    for values in (
        torch.randn(4, 6, dtype=torch.complex64).mT,
        torch.randn(4, 6, dtype=torch.complex64).conj(),
        torch.randn(4, 6).to(torch.complex128),
    ):
        with pytest.raises(ValueError, match="expected contiguous complex64"):
            transform_(values)


@pytest.mark.parametrize("by_row", [False, True])
@pytest.mark.parametrize("size", [(9, 14), (10, 16), (40, 36)])
@pytest.mark.parametrize("torus", [(4, 4), (5, 6), (7, 4)])
def test_low_frequencies_are_those_of_real_transforms(size, torus, by_row):
    values = planes(3, size)
    exact = values.double()
    spectrum = torch.fft.rfft(exact) if by_row else torch.fft.rfft2(exact)
    torus = (size[0] if by_row else torus[0], torus[1])
    assert near(Pairs.of(values, by_row).low(torus), low(spectrum, torus, by_row))


@pytest.mark.parametrize("kind", ["three layers", "one row"])
@pytest.mark.parametrize("size", [(12, 16), (21, 24), (13, 18)])
def test_low_frequencies_are_seen_on_larger_pixels_and_back(kind, size):
    """The highest, which a smaller torus cannot tell apart, are left out both ways."""
    known, exact = spectral(kind, size), spectral(kind, size, dtype=torch.float64)
    for each in (known, exact):
        each.pixels = 9.0
    spectrum = low(exact.to_frequencies(planes(3, size).double()), size, exact.by_row)
    seen = exact.low_to_pixels(spectrum)
    assert near(known.low_to_pixels(spectrum.to(torch.complex64)), seen)
    again = known.to_low(seen.float())
    assert near(again, low(exact.to_low(seen), size, exact.by_row))
    assert near(again, spectrum)


@pytest.mark.parametrize("kind", ["three layers", "one row"])
def test_low_frequencies_are_replaced_as_in_double_precision(kind):
    known, exact = spectral(kind, (21, 24)), spectral(kind, (21, 24), dtype=torch.float64)
    values = planes(len(known.symbol), (21, 24), (2, 1))

    def solved(spectral: Spectral, planes: torch.Tensor) -> torch.Tensor:
        grid = spectral.coarser(3)
        return spectral.solved_pixels(planes, 0.1, 0.003, apart=Apart(grid, lambda part: -3 * part))

    assert near(solved(known, values.clone()), solved(exact, values.double()))


@pytest.mark.usefixtures("large")
@pytest.mark.parametrize("kind", SHOWN)
@pytest.mark.parametrize("size", SIZES)
def test_layers_are_solved_as_in_double_precision(kind, size):
    known, exact = spectral(kind, size), spectral(kind, size, dtype=torch.float64)
    values = planes(len(known.symbol), size, (2, 1))
    terms = (0.1, 0.003, -1.7, 0.4)
    expected = exact.solved_pixels(values.double(), *terms)
    assert near(known.solved_pixels(values, *terms), expected)


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
        with pytest.raises(ValueError, match=r"found matrices .*, expected"):
            known.solved_pixels(values, 0.1, 0.003)
