"""Values and light: the laws themselves, displays that have one, and what the command line says."""

import json
import re
import shutil

import numpy as np
import pytest
import torch
from test_cli import HEIGHT, WIDTH, contents, desk, fails, original, read, run, stack, succeed

from layerfield import Display, Problem, procedural_light_field, psnr, synthesize
from layerfield.display_spec import format_spec, parse_spec
from layerfield.evaluate import evaluate, figures, tables
from layerfield.links import LINKS
from layerfield.result import make_result
from layerfield.tone import EncodedLink
from layerfield.transfer import NONE, Curve, Gamma, Srgb, named
from layerfield.weights import same_light_paths

__all__ = ["desk", "original"]  # fixtures

CURVE = Curve(((0.0, 0.002), (0.3, 0.05), (0.7, 0.4), (1.0, 1.0)))
LAWS = [NONE, Srgb(), Gamma(2.2), Gamma(0.7), CURVE]
WAYS = ["additive", "multiplicative"]


def display_with(transfer, link="additive") -> Display:
    spec = Display.load(f"{link}-3").spec
    return Display(spec.model_copy(update={"transfer": transfer}))


@pytest.fixture(scope="module")
def scene():
    return procedural_light_field(size=(64, 72), disparity_range=(-1.5, 1.5), seed=8)


@pytest.mark.parametrize("law", LAWS, ids=named)
def test_encode_undoes_decode(law):
    values = torch.linspace(0, 1, 1001, dtype=torch.float64)
    light = law.decode(values)
    assert (light.diff() > 0).all()
    assert light[-1] == pytest.approx(1, abs=1e-12)
    assert torch.allclose(law.encode(light), values, atol=1e-9)
    above = torch.tensor([1.5], dtype=torch.float64)
    assert law.encode(above).item() > 1  # views are not clipped
    assert law.decode(law.encode(above)).item() == pytest.approx(1.5)


def test_srgb_is_that_of_the_standard():
    values = torch.tensor([0.0, 0.02, 0.5, 1.0], dtype=torch.float64)
    known = torch.tensor([0.0, 0.02 / 12.92, 0.21404114, 1.0], dtype=torch.float64)
    assert torch.allclose(Srgb().decode(values), known, atol=1e-8)


def test_a_black_that_is_not_dark_stays():
    assert CURVE.decode(torch.tensor(0.0)).item() == pytest.approx(0.002)
    assert CURVE.encode(torch.tensor(0.0)).item() < 0  # no code; panels end at their black
    assert Curve.measured([(0, 1), (1, 400)]).points == ((0, 1 / 400), (1, 1))


@pytest.mark.parametrize("law", LAWS, ids=named)
def test_displays_with_a_transfer_go_through_their_files(law):
    spec = display_with(law).spec
    assert parse_spec(format_spec(spec), "again") == spec


def test_solvers_are_given_light(scene):
    problem = Problem.of(display_with(Srgb()), scene.views)
    assert torch.equal(problem.target, Srgb().decode(scene.views))


@pytest.mark.parametrize("link", WAYS)
def test_solving_encoded_values_for_panels_that_decode_them_costs_light(scene, link):
    """In light, additive: 30.7 dB -> 13.8. A product of powers is the power of the product."""
    right = display_with(Srgb(), link)
    blind = Srgb().decode(synthesize(scene, display_with(NONE, link)).layers)
    lost = figures(synthesize(scene, right).layers, scene, right).psnr_linear
    lost -= figures(blind, scene, right).psnr_linear
    assert lost > (10 if link == "additive" else 0)


def test_both_figures(scene):
    right, plain = display_with(Srgb()), display_with(NONE)
    layers = synthesize(scene, right).layers
    found = figures(layers, scene, right)
    light = right(layers)
    # Summed up in another order, so that the last digit may differ.
    encoded, decoded = Srgb().encode(light), Srgb().decode(scene.views)
    assert found.psnr == pytest.approx(psnr(encoded, scene.views), abs=1e-9)
    assert found.psnr_linear == pytest.approx(psnr(light, decoded), abs=1e-9)
    assert abs(found.psnr - found.psnr_linear) > 0.1
    same = figures(layers, scene, plain)
    assert same.psnr == same.psnr_linear


def test_tables_show_both_figures_where_they_differ(scene, quick_references):
    (row,) = evaluate([scene], [display_with(Srgb())], [("fourier-admm", 3)])
    assert {"psnr", "psnr_linear"} < set(row.as_record())
    ((title, lines),) = tables([row])
    assert re.search(r"optimum \d\d\.\d\d dB in linear light", title)
    assert lines[0][1:3] == ["PSNR dB", "linear"]
    assert lines[1][1:3] == [f"{row.figures.psnr:.2f}", f"{row.figures.psnr_linear:.2f}"]
    assert row.reference is not None
    assert row.figures.psnr_linear <= row.reference.psnr + 0.01
    (row,) = evaluate([scene], [display_with(NONE)], [("fourier-admm", 3)])
    ((title, lines),) = tables([row])
    assert "linear" not in title
    assert "linear" not in lines[0]


def test_a_display_with_another_transfer_is_another_one_to_networks(desk):
    assert not same_light_paths(display_with(NONE), display_with(Srgb()))
    assert same_light_paths(display_with(Gamma(2.2)), display_with(Gamma(2.2)))
    text = format_spec(display_with(Srgb()).spec)
    (desk / "d.toml").write_text(text.replace("additive-3", "mine"))
    found = run("synth", "views", "--display", "d.toml", "--method", "unet", "--out", "out")
    fails(found, "shifts to 2 px, transfer srgb)", "layerfield train")


# -------------------------------------------------------------------------- errors of the values


@pytest.mark.parametrize("link", WAYS)
def test_judging_values_wins_back_dark_tones(scene, link):
    """Rounded to 8 bits, too: rounding goes on with the errors that were minimised."""
    display = display_with(Srgb(), link)
    found = {}
    for method in ("fourier-admm", "tone"):
        result = make_result(
            scene, display, synthesize(scene, display, method=method), method=method, bits=8
        )
        found[method] = result.facts
    assert found["tone"]["psnr"] > found["fourier-admm"]["psnr"] + 0.3
    assert found["tone"]["psnr_linear"] < found["fourier-admm"]["psnr_linear"]


@pytest.mark.parametrize("law", [Srgb(), Gamma(2.2), CURVE], ids=named)
@pytest.mark.parametrize("link", WAYS)
def test_derivative_of_an_encoded_link(law, link):
    encoded = EncodedLink(LINKS[link], law)
    pixels = [torch.tensor([0.3, 0.05, 0.4], dtype=torch.float64), torch.tensor([0.5, 0.3, 0.42])]
    step = 1e-5
    for k in range(2):
        up, down = ([p + (j == k) * d for j, p in enumerate(pixels)] for d in (step, -step))
        slope = (encoded.compose(up) - encoded.compose(down)) / (2 * step)
        assert torch.allclose(encoded.derivative(pixels, k).double(), slope, rtol=0.01)


# ------------------------------------------------------------------------------ the command line

DISPARITY = 'name = "d"\nlink = "additive"\ndisparity = [1, 0, -1]\nviews = [5, 5]\n'
PHYSICAL = (
    'name = "p"\nlink = "additive"\ndepth_mm = [6, 0, -6]\npitch_um = 250\n'
    "viewing_distance_mm = 600\nviewing_angle_deg = 6\nviews = [5, 5]\n"
)
ARGS = ["synth", "views", "--display", "d.toml", "--out", "out"]


def test_written_files_hold_encoded_values(desk, quick_references):
    (desk / "d.toml").write_text(DISPARITY + 'transfer = "srgb"\n')
    out = succeed(*ARGS, "--simulate", "--reference")
    assert re.search(r"linear light \d\d\.\d\d dB\) after .* dB in linear light, excess", out)
    light = [
        Srgb().decode(torch.from_numpy(read(p) / 255))
        for p in sorted((desk / "out/layers").iterdir())
    ]
    views = np.zeros((5, 5, HEIGHT, WIDTH, 3))
    for row in range(5):
        for column in range(5):
            for layer, disparity in zip(light, (1, 0, -1), strict=True):
                y, x = 2 + (row - 2) * disparity, 2 + (column - 2) * disparity
                views[row, column] += layer[y : y + HEIGHT, x : x + WIDTH].numpy()
    shown = Srgb().encode(torch.from_numpy(views))
    facts = json.loads((desk / "out/result.json").read_text())
    target = torch.from_numpy(stack(desk / "views"))
    assert facts["psnr"] == pytest.approx(psnr(shown, target), abs=1e-3)
    linear = psnr(torch.from_numpy(views), Srgb().decode(target))
    assert facts["psnr_linear"] == pytest.approx(linear, abs=1e-3)
    seen = stack(desk / "out" / "views")
    assert np.abs(seen - shown.numpy().clip(0, 1)).max() <= 0.5 / 255 + 1e-5
    succeed("simulate", "out", "--out", "seen")
    assert contents(desk / "seen" / "views") == contents(desk / "out" / "views")


def test_a_curve_travels_with_the_result(desk):
    (desk / "bench").mkdir()
    (desk / "bench/d.toml").write_text(DISPARITY + 'transfer = { curve = "panel.csv" }\n')
    lines = [f"{v / 10}, {80 * (v / 10) ** 2 + 0.1}" for v in range(11)]
    (desk / "bench/panel.csv").write_text("# value, cd/m2\n" + "\n".join(lines) + "\n")
    succeed("synth", "views", "--display", "bench/d.toml", "--out", "out", "--simulate")
    shutil.rmtree(desk / "bench")
    succeed("simulate", "out", "--out", "seen")
    assert contents(desk / "seen" / "views") == contents(desk / "out" / "views")


def test_pictures_taken_for_light_are_remarked_on(desk, quick_references):
    remark = "no transfer, so the 8-bit values of 'views' are taken for light"
    (desk / "d.toml").write_text(PHYSICAL)
    assert succeed(*ARGS).count(remark) == 1
    rows = ["evaluate", "views", "--display", "d.toml", "--methods", "fourier-admm:1"]
    assert succeed(*rows, "--crop", "16x16").count(remark) == 1
    (desk / "d.toml").write_text(PHYSICAL + 'transfer = "srgb"\n')
    assert "note" not in succeed(*ARGS, "--force")
    (desk / "d.toml").write_text(DISPARITY)  # as the papers have it
    assert "note" not in succeed(*ARGS, "--force")


def test_layers_of_another_transfer_are_remarked_on(desk):
    (desk / "d.toml").write_text(DISPARITY)
    (desk / "e.toml").write_text(DISPARITY + "transfer = { gamma = 2.2 }\n")
    succeed(*ARGS)
    assert "note" not in succeed("simulate", "out", "--out", "seen")
    out = succeed("simulate", "out", "--display", "e.toml", "--out", "other")
    assert "made for panels with transfer none, those of display 'd' have gamma 2.2" in out


BAD = {
    "unknown": ('"srbg"', "", "unknown transfer 'srbg'|did you mean 'srgb'"),
    "no law": ("2.2", "", "found 2.2|{ gamma = 2.2 }"),
    "negative": ("{ gamma = -1 }", "", "gamma of -1|more than 0"),
    "zero": ("{ gamma = 0.0 }", "", "gamma of 0|more than 0"),
    "infinite": ("{ gamma = inf }", "", "gamma of inf"),
    "truth": ("{ gamma = true }", "", "expected"),
    "text": ('{ gamma = "2.2" }', "", "expected"),
    "two": ('{ gamma = 2.2, curve = "c.csv" }', "", "expected"),
    "no file": ('{ curve = "none.csv" }', "", "cannot read the curve none.csv|no such file"),
    "folder": ('{ curve = "views" }', "", "cannot read the curve views"),
    "not text": ('{ curve = "views/view_00_00.png" }', "", "no text file"),
    "words": ('{ curve = "c.csv" }', "0, 0\nhalf, 0.2\n1, 1", "c.csv, line 2|'half, 0.2'"),
    "columns": ('{ curve = "c.csv" }', "0, 0\n1, 1, 1", "c.csv, line 2|two numbers"),
    "nan": ('{ curve = "c.csv" }', "0, 0\n0.5, nan\n1, 1", "c.csv|not finite"),
    "falls": ('{ curve = "c.csv" }', "0, 0\n0.5, 0.4\n0.6, 0.3\n1, 1", "not strictly increasing"),
    "stays": ('{ curve = "c.csv" }', "0, 0\n0.5, 0\n1, 1", "not strictly increasing|0.5, 0"),
    "codes": ('{ curve = "c.csv" }', "0, 0\n255, 1", "run from 0 to 255|divide"),
    "dark": ('{ curve = "c.csv" }', "0, 0\n1, 0", "last point is 0"),
    "below": ('{ curve = "c.csv" }', "0, -1\n1, 1", "from -1 to 1|0 to 1"),
    "empty": ('{ curve = "c.csv" }', "", "c.csv"),
    "single": ('{ curve = "c.csv" }', "1, 1", "1 points|expected 2"),
    "points": ("{ curve = [[0, 0], [1]] }", "", "[1]|[value, light]"),
}  # fmt: skip


@pytest.mark.parametrize(("written", "csv", "words"), BAD.values(), ids=BAD)
def test_bad_transfers_are_one_line(desk, written, csv, words):
    (desk / "d.toml").write_text(f"{DISPARITY}transfer = {written}\n")
    (desk / "c.csv").write_text(csv)
    before = contents(desk)
    fails(run(*ARGS), "d.toml: 'transfer': ", *words.split("|"))
    assert contents(desk) == before
