"""Views of 8 and 16 bits stay whole numbers, and nothing comes out differently for it."""

from dataclasses import replace

import numpy
import pytest
import torch
from torchmetrics.functional.image import structural_similarity_index_measure

from layerfield import Display, FieldOptions, LightField, load_light_field, synthesize
from layerfield.display_spec import DisparitySpec
from layerfield.evaluate import figures
from layerfield.io import write_png
from layerfield.kept_views import LARGEST, KeptViews
from layerfield.metrics import psnr, psnr_by_view, ssim
from layerfield.own_process import in_own_process, peak_megabytes
from layerfield.problem import Problem
from layerfield.reference import cached_reference, reference
from layerfield.result import make_result
from layerfield.synthesizer import pose
from layerfield.transfer import NONE, Gamma, Srgb

DTYPES = sorted(LARGEST, key=str)


def codes(dtype=torch.uint8, count=9, size=(20, 24), seed=0):
    generator = torch.Generator().manual_seed(seed)
    numbers = torch.randint(LARGEST[dtype] + 1, (count, 3, *size), generator=generator)
    return numbers.to(torch.int32).to(dtype)


def display(link="additive", disparity=(1.0, 0.0, -1.0), views=(3, 3), **others):
    return Display(DisparitySpec(link=link, disparity=disparity, views=views, **others))  # pyright: ignore[reportArgumentType]


def as_floats(field):
    return replace(field, stored=field.views)


@pytest.mark.parametrize("dtype", DTYPES)
def test_values_are_codes_over_the_largest(dtype):
    kept = KeptViews(codes(dtype))
    expected = codes(dtype).to(torch.float64) / LARGEST[dtype]
    assert torch.equal(kept.all(), expected.float())
    assert torch.equal(torch.stack(list(kept)), kept.all())
    assert kept.mean().item() == pytest.approx(expected.mean().item())


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("law", [Srgb().decode, Gamma(2.2).decode, torch.Tensor.double])
def test_a_law_on_the_table_is_the_law_on_the_values(dtype, law):
    kept = KeptViews(codes(dtype)).then(law)
    assert kept.stored.dtype == dtype
    assert torch.equal(kept.all(), law(KeptViews(codes(dtype)).all()))
    assert kept.like.dtype == kept.all().dtype


def test_a_law_that_changes_nothing_leaves_whole_numbers_alone():
    views = KeptViews(torch.zeros(2, 1, 3, 3, dtype=torch.uint8))
    assert views.then(NONE.decode) is views


def test_floats_are_kept_as_they_are():
    views = torch.rand(4, 3, 5, 6, dtype=torch.float64)
    assert KeptViews(views).all() is views
    assert torch.equal(KeptViews(views).then(torch.exp).view(2), views[2].exp())


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("disparity", [(1.0, 0.0, -1.0), (0.5, -1.25)])
@pytest.mark.parametrize("transfer", ["none", "srgb"])
@pytest.mark.parametrize("weights", [None, tuple(float(i % 3) for i in range(9))])
def test_back_projection_of_whole_numbers_is_that_of_floats(dtype, disparity, transfer, weights):
    shown_on = display(disparity=disparity, transfer=transfer)
    whole = Problem.of(shown_on, KeptViews(codes(dtype)), weights)
    floats = Problem.of(shown_on, KeptViews(codes(dtype)).all().double(), weights)
    torch.testing.assert_close(
        whole.back_projected.double(), floats.back_projected, rtol=1e-5, atol=1e-5
    )
    torch.testing.assert_close(
        whole.even_start().double(), floats.even_start(), rtol=1e-5, atol=1e-5
    )


def test_sums_of_whole_numbers_do_not_overflow():
    bright = torch.full((169, 1, 12, 12), 255, dtype=torch.uint8)
    problem = Problem.of(display(disparity=(0.0,), views=(13, 13)), KeptViews(bright))
    assert torch.equal(problem.back_projected, torch.full((1, 1, 1, 12, 12), 169.0))


@pytest.mark.parametrize("link", ["additive", "multiplicative", "polarisation"])
@pytest.mark.parametrize("transfer", ["none", "srgb"])
def test_layers_of_whole_numbers_are_those_of_floats(link, transfer):
    field = LightField(codes(), (3, 3))
    shown_on = display(link, transfer=transfer)
    whole = synthesize(field, shown_on, iterations=3).layers
    floats = synthesize(as_floats(field), shown_on, iterations=3).layers
    torch.testing.assert_close(whole, floats, rtol=1e-3, atol=2e-4)


def test_a_reference_is_found_whatever_the_views_are_kept_as(quick_references):
    field, shown_on = LightField(codes(), (3, 3)), display()
    found = reference(pose(field, shown_on))
    assert cached_reference(pose(as_floats(field), shown_on)) == found


def test_problems_of_one_display_and_size_share_what_depends_on_them():
    one, other = (pose(LightField(codes(seed=s), (3, 3)), display()) for s in (1, 2))
    wider = pose(LightField(codes(size=(20, 26)), (3, 3)), display())
    assert one.gram is other.gram and one.coverage is other.coverage
    assert one.gram is not wider.gram
    assert one.gram is one.in_sum_domain().gram
    double = replace(one, views=one.views.then(torch.Tensor.double))
    assert double.gram.spectral.symbol.dtype == torch.float64


@pytest.fixture(params=DTYPES, ids=["8 bit", "16 bit"])
def stored(request, tmp_path):
    pictures = codes(request.param)
    for i, picture in enumerate(pictures):
        write_png(tmp_path / f"view_{i // 3:02d}_{i % 3:02d}.png", picture)
    return tmp_path, pictures


@pytest.mark.parametrize(
    "options", [FieldOptions(), FieldOptions(views=(1, 3)), FieldOptions(shift=1)]
)
def test_readers_keep_whole_numbers(stored, options):
    folder, pictures = stored
    field = load_light_field(folder, options)
    assert field.stored.dtype == pictures.dtype
    if options == FieldOptions():
        assert torch.equal(field.stored.int(), pictures.int())
        assert torch.equal(field.view(4), field.views[4])


@pytest.mark.parametrize("options", [FieldOptions(shift=0.5), FieldOptions(scale=0.5)])
def test_readers_make_floats_of_what_falls_between_whole_numbers(stored, options):
    field = load_light_field(stored[0], options)
    assert field.stored.dtype == torch.float32
    assert field.bits in (8, 16)


def test_files_of_different_depth_become_floats(tmp_path):
    pictures = codes()
    for i, picture in enumerate(pictures):
        deep = picture if i < 5 else (picture.int() * 257).to(torch.uint16)
        write_png(tmp_path / f"view_{i // 3:02d}_{i % 3:02d}.png", deep)
    field = load_light_field(tmp_path)
    assert field.stored.dtype == torch.float32
    torch.testing.assert_close(field.views, KeptViews(pictures).all())


def test_figures_view_by_view_are_those_of_all_views():
    field, shown_on = LightField(codes(), (3, 3)), display(transfer="srgb")
    layers = synthesize(field, shown_on, iterations=2).layers
    light = shown_on(layers)
    views, found = Srgb().encode(light), figures(layers, field, shown_on)
    assert found.psnr == pytest.approx(psnr(views, field.views), abs=1e-6)
    assert found.psnr_linear == pytest.approx(psnr(light, Srgb().decode(field.views)), abs=1e-6)
    assert found.psnr_by_view == pytest.approx(psnr_by_view(views, field.views), abs=1e-6)
    assert found.ssim == pytest.approx(ssim(views, field.views), abs=1e-6)


@pytest.mark.parametrize("size", [(11, 11), (11, 40), (130, 57)])
def test_ssim_is_the_published_one(size):
    generator = torch.Generator().manual_seed(3)
    wanted = torch.rand(2, 3, *size, generator=generator)
    views = wanted + 0.3 * torch.rand(wanted.shape, generator=generator)
    expected = structural_similarity_index_measure(views.clamp(0, 1), wanted, data_range=1.0)
    assert ssim(views, wanted) == pytest.approx(float(expected), abs=1e-5)  # pyright: ignore[reportArgumentType]
    assert ssim(wanted, wanted) == 1


def test_ssim_of_views_smaller_than_its_window_mirrors_them_again():
    generator = torch.Generator().manual_seed(3)
    for size in (1, 1), (2, 5), (4, 3):
        wanted, views = torch.rand(2, 1, 3, *size, generator=generator)
        around = [(0, 0), (0, 0), (25, 25), (25, 25)]
        wide = [
            torch.from_numpy(numpy.pad(each.double(), around, mode="reflect"))
            for each in (views, wanted)
        ]
        _, everywhere = structural_similarity_index_measure(
            wide[0], wide[1], data_range=1.0, return_full_image=True
        )
        expected = everywhere[..., 25 : 25 + size[0], 25 : 25 + size[1]].mean()
        assert ssim(views, wanted) == pytest.approx(float(expected), abs=1e-5)
        assert ssim(views.double(), wanted.double()) == pytest.approx(float(expected), abs=1e-12)


def _road(link):
    """Return the megabytes that layers and their figures take beyond the views and the program."""
    shown_on = display(link, views=(9, 9))
    field = LightField(torch.arange(256, dtype=torch.uint8).repeat(81, 3, 360, 2), (9, 9), bits=8)
    corner = replace(field, stored=field.stored[..., :24, :24])
    make_result(corner, shown_on, synthesize(corner, shown_on, iterations=1), method="", bits=16)
    before = peak_megabytes()
    made = synthesize(field, shown_on, iterations=1)
    make_result(field, shown_on, made, method="", bits=16)
    return peak_megabytes() - before, field.stored.numel() / 2**18


@pytest.mark.parametrize("link", ["additive", "multiplicative"])
def test_views_are_never_all_floats(link):
    taken, all_floats = in_own_process(_road, link)
    assert taken < 0.9 * all_floats


def test_figures_of_unlike_views_are_refused():
    with pytest.raises(ValueError, match=r"\(2, 3, 12, 12\) and a target of \(1, 3, 12, 12\)"):
        psnr(torch.zeros(2, 3, 12, 12), torch.zeros(1, 3, 12, 12))


def test_views_that_are_no_numbers_are_refused():
    views = torch.zeros(25, 3, 8, 8)
    views[7, 1, 2, 3] = torch.nan
    with pytest.raises(ValueError, match="no numbers"):
        synthesize(LightField(views, (5, 5)), Display.load("additive-3"))


def test_many_bright_views_of_half_precision_are_numbers():
    """Their sum is beyond what half precision holds."""
    views = torch.ones(25, 3, 40, 40, dtype=torch.float16)
    pose(LightField(views, (5, 5)), Display.load("additive-3"))
