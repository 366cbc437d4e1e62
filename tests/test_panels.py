"""Panels: where light paths meet them, what layers lose on the way, files, and errors."""

import json
import math
import re
import shutil
from dataclasses import replace

import naive
import numpy as np
import pytest
import torch
from test_cli import contents, desk, fails, original, read, run, succeed

from layerfield import Display, procedural_light_field, psnr, synthesize
from layerfield.between import interpolated_between
from layerfield.display_spec import PhysicalSpec, format_spec, parse_spec
from layerfield.metrics import decibels
from layerfield.panel_images import corrected, fitted, panel_images, panel_projection
from layerfield.panel_projection import PanelProjection
from layerfield.panel_spec import PanelSpec
from layerfield.result import write_views
from layerfield.synthesizer import pose
from layerfield.transfer import Gamma, Srgb

__all__ = ["desk", "original"]  # fixtures

PITCH = 250e-6
BENCH = """
name = "bench"
link = "multiplicative"
depth_mm = [6, 0, -5]
pitch_um = 250
viewing_distance_mm = 600
viewing_angle_deg = 6
views = [5, 5]
transfer = "srgb"

[[panels]]
resolution = [96, 80]
pitch_um = 215
offset_mm = [0.31, -0.17]
flip = "horizontal"

[[panels]]
resolution = [90, 80]
pitch_um = 225
rotation_deg = 0.5

[[panels]]
resolution = [120, 110]
pitch_um = 180
flip = "vertical"
transfer = { gamma = 2.2 }
bits = 16
"""


def bench(**changes) -> Display:
    spec = parse_spec(BENCH, "bench")
    return Display(spec.model_copy(update=changes))


@pytest.fixture(scope="module")
def scene():
    return procedural_light_field(size=(48, 60), disparity_range=(-1.5, 1.5), seed=8)


def test_eyes_at_different_distances_see_panels_as_they_see_layers():
    """Panels on the very pixels of the layers: both maps are the same where all light is inside."""
    display = Display(
        parse_spec(
            """
            name = "apart"
            link = "additive"
            depth_mm = [6, 0, -6]
            pitch_um = 250
            viewpoints_mm = [[-20, 0, 400], [20, 0, 1200], [0, 15, 700]]
            """,
            "apart",
        )
    )
    view_size = (20, 26)
    size = display.projection.layer_size(torch.empty(view_size))
    layers = torch.rand(3, 1, *size, dtype=torch.float64)
    straight = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    shifts, margin = display.geometry.shifts, display.geometry.margin
    panels = PanelProjection(
        shifts, margin, (straight,) * 3, (size,) * 3, view_size, display.geometry.magnifications
    )
    torch.testing.assert_close(
        panels.forward(layers), display.projection.forward(layers), atol=1e-6, rtol=0
    )
    assert display.geometry.magnifications[1] != (1.0, 1.0, 1.0)


@pytest.mark.parametrize("warped", [False, True])
def test_adjoint_is_exact(warped):
    display = bench()
    projection = panel_projection(display, (48, 60))
    if warped:
        leaning = tuple((a, b, (g, 2e-4, 1.0)) for a, b, (g, _, _) in projection.mappings)
        projection = replace(projection, mappings=leaning)
    random = torch.Generator().manual_seed(0)
    size = projection.layer_size(torch.empty(0))
    panels = torch.rand(3, 2, *size, generator=random, dtype=torch.float64)
    for k, (rows, columns) in enumerate(projection.sizes):  # the rest of the tensor is no panel
        panels[k, :, rows:] = 0
        panels[k, :, :, columns:] = 0
    views = torch.rand(25, 2, 48, 60, generator=random, dtype=torch.float64)
    one = (projection.forward(panels) * views).sum()
    other = (panels * projection.adjoint(views)).sum()
    assert one.item() == pytest.approx(other.item(), rel=1e-10)


def test_a_panel_that_is_its_layer_shows_the_same():
    display = bench(viewing_distance_mm=math.inf, transfer=Srgb())
    size = (48 + 2 * display.margin[0], 60 + 2 * display.margin[1])
    same = PanelSpec(resolution=(size[1], size[0]), pitch_um=250)
    display = Display(display.spec.model_copy(update={"panels": (same,) * 3}))
    projection = panel_projection(display, (48, 60))
    layers = torch.rand(3, 1, *size, dtype=torch.float64)
    assert torch.allclose(projection.forward(layers), display.projection.forward(layers))


def test_a_homography_replaces_the_mounting(scene):
    mounted = bench()
    mappings = panel_projection(mounted, scene.size).mappings
    panels = tuple(
        PanelSpec(resolution=panel.resolution, homography=mapping, bits=panel.bits)
        for panel, mapping in zip(mounted.panels, mappings, strict=True)
    )
    measured = Display(mounted.spec.model_copy(update={"panels": panels}))
    assert panel_projection(measured, scene.size) == panel_projection(mounted, scene.size)
    assert parse_spec(format_spec(measured.spec), "again") == measured.spec
    assert parse_spec(format_spec(mounted.spec), "again") == mounted.spec


@pytest.mark.parametrize("link", ["additive", "multiplicative"])
@pytest.mark.parametrize("distance", [600, math.inf])
def test_panels_cost_little(link, distance):
    """From the scaled grid to finer panels at most 0.1 dB, 8 bits at most 0.1 dB more."""
    field = procedural_light_field(size=(64, 80), disparity_range=(-1.5, 1.5), seed=8)
    panels = (
        PanelSpec(resolution=(110, 90), pitch_um=220, offset_mm=(0.3, 0.1), flip="horizontal"),
        PanelSpec(resolution=(130, 100), pitch_um=187, rotation_deg=0.5),
        PanelSpec(resolution=(220, 190), pitch_um=110, rotation_deg=-0.5, flip="vertical"),
    )
    angle = 2 * math.degrees(math.atan(2 * 0.25 / 5))
    display = bench(
        link=link, depth_mm=(5.0, 0.0, -5.0), panels=panels,
        viewing_distance_mm=float(distance), viewing_angle_deg=angle,
    )  # fmt: skip
    problem, layers = pose(field, display), synthesize(field, display).layers
    projection = panel_projection(display, field.size)
    through = replace(problem, projection=projection)
    light = corrected(through, fitted(layers, projection))
    grid, before = problem.mean_square_error(layers), through.mean_square_error(light)
    assert decibels(before) > decibels(grid) - 0.1
    rounded = torch.zeros_like(light)
    images = panel_images(problem, layers, display)
    for k, codes in enumerate(images.codes):
        rounded[:, k, :, : codes.shape[-2], : codes.shape[-1]] = Srgb().decode(codes / 255)
    assert decibels(through.mean_square_error(rounded)) > decibels(before) - 0.1
    assert images.missed == (0.0, 0.0, 0.0)


def test_coarser_panels_show_no_moire():
    """Stripes of one pixel, on a panel of three times the pitch, are grey."""
    stripes = (torch.arange(92) % 2).float().expand(1, 1, 1, 80, 92)
    mapping = ((0.31, 0.0, 0.0), (0.0, 0.31, 0.0), (0.0, 0.0, 1.0))
    one = PanelProjection((((0.0, 0.0),),), (0, 0), (mapping,), ((25, 29),), (80, 92))
    panel = fitted(stripes, one)[..., 3:-3, 3:-3]
    assert (panel - 0.5).abs().max() < 0.1


# ------------------------------------------------------------------------------ the command line


@pytest.fixture
def made(desk, scene):
    shutil.rmtree(desk / "views")
    write_views(desk / "views", scene.views, Display.load("additive-3"), 8)
    (desk / "d.toml").write_text(BENCH)
    return desk


ARGS = ["synth", "views", "--display", "d.toml", "--out", "out"]


@pytest.mark.parametrize("link", ["additive", "multiplicative"])
def test_written_panels_show_what_rays_meet(made, link):
    """Traced in double precision, from the files; two of the panels flipped, one turned."""
    (made / "d.toml").write_text(BENCH.replace('"multiplicative"', f'"{link}"'))
    out = succeed(*ARGS, "--simulate")
    facts = json.loads((made / "out/result.json").read_text())["panels"]
    assert re.search(
        rf"panels: {facts['psnr']:.2f} dB \(linear light {facts['psnr_linear']:.2f}", out
    )
    succeed("simulate", "out", "--out", "seen", "--array")
    assert contents(made / "seen" / "views") == contents(made / "out" / "views")
    mountings = [
        (215e-6, (0.31e-3, -0.17e-3), 0.0, (-1, 1), Srgb(), 255),
        (225e-6, (0.0, 0.0), math.radians(0.5), (1, 1), Srgb(), 255),
        (180e-6, (0.0, 0.0), 0.0, (1, -1), Gamma(2.2), 65535),
    ]
    panels = []
    for k, (pitch, offset, turn, flip, law, most) in enumerate(mountings):
        green = read(made / f"out/panels/panel_{k}.png")[..., 1].astype(float) / most
        panels.append((law.decode(torch.from_numpy(green)).numpy(), pitch, offset, turn, flip))
    seen = torch.from_numpy(np.load(made / "seen/views.npy"))[..., 1].double()
    target = torch.stack(
        [torch.from_numpy(read(p)[..., 1] / 255.0) for p in sorted((made / "views").iterdir())]
    ).unflatten(0, (5, 5))
    step = 2 * math.tan(math.radians(3)) / 4 * 0.6
    for row, column in ((0, 0), (1, 3), (4, 2)):
        eye = ((column - 2) * step, (row - 2) * step, 0.6)
        traced = torch.from_numpy(
            naive.panel_view(panels, eye, (6e-3, 0, -5e-3), PITCH, (48, 60), link)
        )
        shown = Srgb().encode(traced)
        assert (shown - seen[row, column]).abs().max() < 1e-3
        wanted = target[row, column]
        assert psnr(shown, wanted) == pytest.approx(psnr(seen[row, column], wanted), abs=0.02)


def test_layers_and_panels_are_written_side_by_side(made):
    succeed(*ARGS)
    names = sorted(entry.name for entry in (made / "out").iterdir())
    assert names == ["display.toml", "layers", "panels", "result.json"]
    sizes = [(80, 96), (80, 90), (110, 120)]
    for k, size in enumerate(sizes):
        panel = read(made / f"out/panels/panel_{k}.png")
        assert panel.shape == (*size, 3)
        assert panel.dtype == (np.uint16 if k == 2 else np.uint8)
    succeed("simulate", "out", "--out", "layers-only", "--margin", "3")


def test_light_paths_that_miss_a_panel_are_counted(made):
    narrow = BENCH.replace("resolution = [90, 80]\npitch_um = 225\nrotation_deg = 0.5",
                           "resolution = [60, 48]\npitch_um = 250")  # fmt: skip
    (made / "d.toml").write_text(narrow.replace("depth_mm = [6, 0, -5]", "depth_mm = [6, 4, -5]"))
    assert re.search(r"up to \d\.\d% of the light paths miss one and are dark", succeed(*ARGS))


PANEL = "resolution = [96, 80]\npitch_um = 215\n"
BAD = {
    "pitch": ("pitch_um = 215", "pitch_um = 0", "panels[0].pitch_um' is 0|greater than 0"),
    "too few": (BENCH[BENCH.rindex("[[panels]]") :], "", "2 panels for 3 layers|[[panels]]"),
    "too many": ('flip = "vertical"', f"[[panels]]\n{PANEL}", "4 panels for 3 layers"),
    "small": ("[96, 80]", "[50, 80]", "panel 0 (50x80 px) is smaller than the views|--crop"),
    "moved away": ("[0.31, -0.17]", "[9, 0]", "panel 0|smaller than the views|offset"),
    "transfer": ("{ gamma = 2.2 }", '"srbg"', "panels[2].transfer'|did you mean 'srgb'"),
    "gamma": ("gamma = 2.2", "gamma = -2.2", "panels[2].transfer'|gamma of -2.2|more than 0"),
    "curve": ("gamma = 2.2", 'curve = "none.csv"', "panels[2].transfer'|none.csv|no such file"),
    "bits": ("bits = 16", "bits = 10", "panels[2].bits' is 10|8 or 16"),
    "flip": ('"vertical"', '"both"', "panels[2].flip' is 'both'"),
    "typo": ("rotation_deg", "rotaton_deg", "unknown key 'panels[1].rotaton_deg'|did you mean"),
    "no resolution": ("resolution = [96, 80]\n", "", "'panels[0].resolution' is missing"),
    "resolution": ("[96, 80]", "[96, 0]", "panels[0].resolution[1]' is 0"),
    "neither": ("pitch_um = 215\n", "", "panels[0]'|either 'pitch_um' or 'homography'"),
    "both": (
        "pitch_um = 225", "pitch_um = 225\nhomography = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]",
        "panels[1]'|leave out 'pitch_um'",
    ),
    "singular": (
        "pitch_um = 225\nrotation_deg = 0.5", "homography = [[1, 0, 0], [2, 0, 0], [0, 0, 1]]",
        "panels[1].homography'|singular",
    ),
    "homography": (
        "pitch_um = 225\nrotation_deg = 0.5", "homography = [[1, 0], [2, 0], [0, 0]]",
        "panels[1].homography",
    ),
    "horizon": (
        "pitch_um = 225\nrotation_deg = 0.5", "homography = [[1, 0, 0], [0, 1, 0], [0.1, 0, -3]]",
        "panel 1|smaller than the views",
    ),
    "no tables": ("[[panels]]\nresolution = [96", "[panels]\nresolution = [96", "d.toml"),
}  # fmt: skip


@pytest.mark.parametrize(("old", "new", "words"), BAD.values(), ids=BAD)
def test_bad_panels_are_one_line(made, old, new, words):
    assert old in BENCH
    (made / "d.toml").write_text(BENCH.replace(old, new, 1))
    before = contents(made)
    fails(run(*ARGS), *words.split("|"))
    assert contents(made) == before


def test_panels_need_millimetres(made):
    flat = 'link = "additive"\ndisparity = [1]\nviews = [5, 5]\n[[panels]]\n' + PANEL
    (made / "d.toml").write_text(flat)
    fails(run(*ARGS), "d.toml", "'disparity'")


def test_damaged_results_are_one_line(made):
    succeed(*ARGS)
    args = ["simulate", "out", "--out", "seen"]
    facts = (made / "out/result.json").read_text()
    (made / "out/result.json").unlink()
    fails(run(*args), "result.json holds no size of the views")
    (made / "out/result.json").write_text(facts)
    (made / "out/panels/panel_1.png").unlink()
    fails(run(*args), "2 pictures of panels", "has 3 panels")
    shutil.copy(made / "out/panels/panel_0.png", made / "out/panels/panel_1.png")
    fails(run(*args), "picture of panel 1 is 96x80 px", "90x80")


def test_spec_is_physical():
    assert isinstance(bench().spec, PhysicalSpec)
    assert Display.load("additive-3").panels == ()


def test_panels_show_targets_between_the_views(scene):
    display = bench()
    asked = replace(scene, between=interpolated_between(scene))
    solution = synthesize(asked, display, iterations=2)
    assert solution.problem is not None
    pictures = panel_images(solution.problem, solution.layers, display)
    assert [tuple(codes.shape[-2:]) for codes in pictures.codes] == [
        panel.size for panel in display.panels
    ]
