"""Light fields of 3D models: where points land, what is refused, and that nothing is lost."""

import dataclasses
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from test_cli import contents, fails, finish, run, start, succeed

from layerfield import Display
from layerfield.disparity import estimate_disparity
from layerfield.io import load_light_field, read_image
from layerfield.rendering import variant
from layerfield.rendering.materials import material_of
from layerfield.rendering.model import Material, Model, Surface
from layerfield.rendering.model_files import read_model
from layerfield.rendering.placement import Fit, Pose
from layerfield.rendering.poses import read_poses, turntable
from layerfield.rendering.previews import preview
from layerfield.rendering.sources import StagedModel
from layerfield.rendering.tracing import first_hits, trace
from layerfield.scenes import render, spot_scene

trimesh = pytest.importorskip("trimesh")
SIZE = (72, 96)
PITCH, DISTANCE, ANGLE = 4e-4, 0.5, np.radians(8)  # of the display perspective-3


@pytest.fixture(scope="module", autouse=True)
def _mitsuba():
    pytest.importorskip("mitsuba")
    variant.choose_variant()


@pytest.fixture(autouse=True)
def _here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.fixture(autouse=True)
def few(_here) -> str:
    """A display of few views."""
    Path("few.toml").write_text(
        'name = "few"\nlink = "additive"\ndisparity = [1, 0, -1]\nviews = [2, 2]\n'
    )
    return "few.toml"


def relief(columns: int = 48, rows: int = 36) -> Any:
    """A textured, wavy sheet that faces the front, y up, four units wide and two deep."""
    x, y = np.meshgrid(np.linspace(-2, 2, columns), np.linspace(-1.5, 1.5, rows))
    z = np.sin(1.3 * x) * np.cos(1.7 * y)
    first = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).reshape(-1, 1)
    pair = np.array([[0, 1, columns + 1, 0, columns + 1, columns]])
    noise = np.random.default_rng(3).integers(0, 256, (60, 80, 3), dtype=np.uint8)
    picture = Image.fromarray(noise).resize((240, 180), Image.Resampling.BICUBIC)
    uv = np.stack([(x + 2) / 4, (y + 1.5) / 3], axis=-1).reshape(-1, 2)
    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=picture, metallicFactor=0.0, roughnessFactor=1.0
    )
    return trimesh.Trimesh(
        np.stack([x, y, z], axis=-1).reshape(-1, 3),
        (first + pair).reshape(-1, 3),
        visual=trimesh.visual.TextureVisuals(uv=uv, material=material),
        process=False,
    )


def as_obj(mesh: Any, path: Path) -> Path:
    """Write an OBJ with its MTL and its texture beside it."""
    mesh.visual.material = mesh.visual.material.to_simple()
    text, files = trimesh.exchange.obj.export_obj(mesh, return_texture=True, mtl_name="its.mtl")
    path.write_text(text)
    for name, data in files.items():
        path.with_name(name).write_bytes(data)
    return path


def model_file(name: str) -> Path:
    path = Path(name)
    if path.suffix == ".obj":
        return as_obj(relief(), path)
    relief().export(path)
    return path


@pytest.mark.parametrize("name", ["sheet.glb", "sheet.obj"])
@pytest.mark.parametrize("display", ["additive-3", "perspective-3"])
def test_info_finds_the_disparities_of_a_model(name: str, display: str):
    """With both signs right, and the range that depth and geometry say."""
    model_file(name)
    how = ["--display", display, "--elevation", "0", "--fit", "1.3", "--depth"]
    how += ["--samples", "4"] if name == "sheet.glb" else ["--preview"]
    said = succeed("render", name, *how, "--no-ground", "--size", "128x96", "--out", "field")
    assert "25 views are in field" in said
    field = load_light_field("field")
    found = estimate_disparity(field)
    assert found.agree is True
    low, high = np.quantile(np.load("field/disparity/disparity_02_02.npy"), [0.01, 0.99])
    assert high - low > 1.5
    for range_ in (found.horizontal, found.vertical):
        assert range_ == pytest.approx((low, high), abs=0.2)
    assert "agree in the sign of disparity" in succeed("info", "field")


def squares(places: np.ndarray, side: float) -> Model:
    """White squares on black that face the viewer, at places with y up."""
    corner = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * side / 2
    quads = (places[:, None] + corner).reshape(-1, 3)
    faces = (4 * np.arange(len(places))[:, None] + [[0, 1, 2, 0, 2, 3]]).reshape(-1, 3)
    white = Surface(vertices=quads, faces=faces, material=Material(colour=(0.9, 0.9, 0.9)))
    return Model((white,), "squares")


PLACES = np.array(
    [[-1.5, 1.0, 1.0], [1.4, 0.9, -1.0], [0.0, 0.0, 0.0], [-1.2, -0.9, -0.4], [1.1, -1.0, 0.7]]
)


def shot(display: Display, size: tuple[int, int], how: str, **fit: float):
    """Return placement and views, black where there are no squares."""
    if how != "paths" and variant.mitsuba().variant() == variant.SAFE:
        pytest.skip("many rays take minutes without LLVM, and previews have one a pixel")
    source = StagedModel(squares(PLACES, 0.3), ground=False)
    placement = source.place([Pose()], display, size, Fit(**fit))
    take = dataclasses.replace(source.take(Pose(), placement), behind=0.0)
    views = []
    for view in range(display.view_count):
        rays = 16 if how == "fine hits" else 8  # along each side of a pixel
        light = np.isfinite(first_hits(take, placement, view, fine=rays)).astype(float)
        if how == "preview":
            light = preview(take, placement, view)
        if how == "paths":
            light = trace(take, placement, view, samples=16, seed=(view,))
        fine = light.shape[0] // size[0]
        light = light.reshape(size[0], fine, size[1], fine, -1).mean((1, 3, 4))
        views.append(light)
    return placement, views


def centroid(picture: np.ndarray, at: np.ndarray, reach: float) -> np.ndarray:
    """The centre of what is within reach of a place, (x, y) from the centre of the picture."""
    y, x = (np.arange(n) - (n - 1) / 2 for n in picture.shape)
    weight = picture * (abs(x[None] - at[0]) < reach) * (abs(y[:, None] - at[1]) < reach)
    return np.array([(weight * x).sum(), (weight * y[:, None]).sum()]) / weight.sum()


def projected(point: np.ndarray, eye: np.ndarray) -> np.ndarray:
    """Pinhole projection of (x, y, z), metres with y down, onto the plane z = 0, in pixels."""
    along = eye[2] / (eye[2] - point[2])
    return (eye[:2] + (point[:2] - eye[:2]) * along) / PITCH


@pytest.mark.parametrize("how", ["hits", "preview", "paths"])
def test_perspective_views_are_those_of_pinholes(how: str):
    """Of an independent projection of the vertices, on a picture that is not square."""
    display = Display.load("perspective-3")
    placement, views = shot(display, SIZE, how, depth=24)
    step = 2 * DISTANCE * np.tan(ANGLE / 2) / 4
    tolerance = 0.07 if how == "hits" else 0.1  # edges are as fine as rays
    for row in range(5):
        for column in range(5):
            eye = np.array([(column - 2) * step, (row - 2) * step, DISTANCE])
            for place in PLACES:
                across, up = placement.scale * (place - placement.centre)[:2] * PITCH
                deep = placement.scale * (place - placement.centre)[2] * placement.gain
                due = projected(np.array([across, -up, deep]), eye)
                found = centroid(views[5 * row + column], due, 0.25 * placement.scale)
                assert found == pytest.approx(due, abs=tolerance)
    assert placement.depths == pytest.approx((-0.012, 0.012))


@pytest.mark.parametrize("display", ["additive-3", "perspective-3"])
def test_a_point_at_the_display_plane_stays_put(display: str):
    placement, views = shot(Display.load(display), SIZE, "fine hits")
    middle = placement.scale * (PLACES[2] - placement.centre)
    assert middle[2] == pytest.approx(0, abs=1e-6)
    for view in views:
        found = centroid(view, middle[:2], 0.25 * placement.scale)
        assert found == pytest.approx(middle[:2], abs=0.05)


def test_views_agree_with_those_of_procedural_scenes():
    """Spots at the same places and disparities land in the same pixels, view by view."""
    display = Display.load("additive-3")
    placement, views = shot(display, SIZE, "hits")
    at = placement.scale * (PLACES - placement.centre) * [1, -1, 1]
    spots = [((float(x), float(y)), float(placement.gain * z)) for x, y, z in at]
    procedural = render(spot_scene(spots, size=SIZE), display.geometry.slopes)[0, :, 0]
    for view, other in zip(views, procedural.numpy(), strict=True):
        for (x, y), _ in spots:
            due = centroid(other.astype(float), np.array([x, y]), 6)
            found = centroid(view, due, 0.25 * placement.scale)
            assert found == pytest.approx(due, abs=0.1)


def test_viewpoints_that_are_a_list_at_different_distances():
    eyes = [[-32, 1, 500], [30, 1, 560]]
    Path("eyes.toml").write_text(
        'name = "eyes"\nlink = "additive"\ndepth_mm = [12, 0, -12]\npitch_um = 400\n'
        f"viewpoints_mm = {eyes}\n"
    )
    display = Display.load("eyes.toml")
    placement, views = shot(display, SIZE, "hits")
    for eye, view in zip(eyes, views, strict=True):
        for place in PLACES:
            x, y, z = placement.scale * (place - placement.centre)
            point = np.array([x * PITCH, -y * PITCH, z * placement.gain])
            due = projected(point, np.array(eye) * 1e-3)
            assert centroid(view, due, 0.25 * placement.scale) == pytest.approx(due, abs=0.06)


def staged(ground: bool = True) -> StagedModel:
    box = trimesh.creation.box((2.0, 1.0, 1.5))
    surface = Surface(vertices=np.array(box.vertices), faces=np.array(box.faces))
    return StagedModel(Model.centred([surface], "box"), ground)


@pytest.mark.parametrize("elevation", [0.0, 20.0, 90.0])
@pytest.mark.parametrize("display", ["additive-3", "perspective-3"])
def test_a_model_lies_within_the_depth_of_the_display(display: str, elevation: float):
    target, source, pose = Display.load(display), staged(ground=False), Pose(30, elevation)
    placement = source.place([pose], target, SIZE, Fit())
    z = first_hits(source.take(pose, placement), placement, 12)
    front, back = target.geometry.depths[0], target.geometry.depths[-1]
    seen = placement.gain * z[np.isfinite(z)]
    assert back - 1e-3 * (front - back) <= seen.min() <= seen.max() <= front + 1e-3 * (front - back)
    capped = placement.gain == target.geometry.pitch  # deeper than it is, it never gets
    assert capped or placement.depths == pytest.approx((back, front))


@pytest.mark.parametrize("elevation", [0.0, 20.0, 90.0])
def test_the_ground_fills_the_picture(elevation: float):
    """And what is seen of it is where it is said to be."""
    target, source, pose = Display.load("perspective-3"), staged(), Pose(30, elevation)
    placement = source.place([pose], target, SIZE, Fit())
    z = first_hits(source.take(pose, placement), placement, 12)
    assert np.isfinite(z).all()
    low, high = placement.seen
    assert z.min() == pytest.approx(low, abs=0.02 * (high - low))
    assert z.max() <= high + 0.02 * (high - low)
    assert low <= placement.back < placement.front <= high


def test_fit_scale_and_depth():
    source, display = staged(ground=False), Display.load("perspective-3")
    half = source.place([Pose()], display, (100, 100), Fit(share=0.5))
    seen = np.isfinite(first_hits(source.take(Pose(), half), half, 12))
    assert seen.any(0).sum() == pytest.approx(50, abs=1)
    scaled = source.place([Pose()], display, (100, 100), Fit(scale=10))
    assert scaled.scale == pytest.approx(0.010 / 4e-4)  # 10 mm a unit, 0.4 mm a pixel
    shallow = source.place([Pose()], display, (100, 100), Fit(depth=3))
    assert shallow.depths == pytest.approx((-0.0015, 0.0015))
    small = source.place([Pose()], display, (100, 100), Fit(scale=4))
    assert small.gain == pytest.approx(4e-4)  # proportions are kept where there is room
    assert small.depths == pytest.approx((-0.003, 0.003))


def test_disparity_displays_say_what_a_pixel_of_disparity_means():
    said = succeed("render", "sample", "--display", "additive-3", "--preview", "--size", "32x24",
                   "--depth-px", "1.5", "--out", "field")  # fmt: skip
    assert "one pixel of disparity stands for" in said
    assert "disparities are -0.75 to 0.75 px" in said
    record = json.loads(Path("field/render.json").read_text())
    assert record["depth"]["unit"] == "px of disparity"


def test_maps_are_those_of_the_geometry():
    succeed("render", "sample", "--display", "perspective-3", "--preview", "--size", "32x24",
            "--depth", "--out", "field")  # fmt: skip
    depth = np.load("field/depth/depth_00_03.npy")
    disparity = np.load("field/disparity/disparity_00_03.npy")
    assert depth.shape == disparity.shape == (24, 32)
    step = 2 * np.tan(ANGLE / 2) / 4
    due = step * depth * 1e-3 / (1 - depth * 1e-3 / DISTANCE) / PITCH
    np.testing.assert_allclose(disparity, due, atol=1e-4)


def test_textures_are_the_right_way_round():
    """Red, green, blue and white in the corners, from the top left, in glTF as in OBJ."""
    colours = np.array([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255, 255, 255]]], np.uint8)
    picture = Image.fromarray(colours).resize((64, 64), Image.Resampling.NEAREST)
    sheet = relief(2, 2)
    sheet.vertices *= [1, 1, 0]
    sheet.visual.material.baseColorTexture = picture
    sheet.export("a.glb")
    as_obj(sheet, Path("a.obj"))
    how = ["--display", "few.toml", "--preview", "--size", "40x30", "--fit", "1.1"]
    for name in ("a.glb", "a.obj"):
        succeed("render", name, *how, "--elevation", "0", "--no-ground", "--out", "f", "--force")
        view = read_image("f/view_01_01.png")
        corners = view[:, [7, 7, 22, 22], [10, 30, 10, 30]].T
        assert [tuple(int(c > 0.5) for c in corner) for corner in corners] == [
            (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1),
        ]  # fmt: skip


def test_colours_of_vertices_and_of_materials_are_kept():
    ball = trimesh.creation.icosphere(1, 0.5)
    ball.visual = trimesh.visual.ColorVisuals(ball, vertex_colors=[255, 0, 0, 255])
    ball.export("ball.ply")
    red = read_model(Path("ball.ply")).surfaces[0]
    assert red.colours is not None
    np.testing.assert_allclose(red.colours, np.tile([1.0, 0, 0], (len(red.colours), 1)))
    metal = trimesh.visual.material.PBRMaterial(
        baseColorFactor=[0.5, 0.25, 1.0, 1.0], metallicFactor=1.0, roughnessFactor=0.25
    )
    box = trimesh.creation.box()
    box.visual = trimesh.visual.TextureVisuals(material=metal)
    found = material_of(box)
    assert found.colour == pytest.approx((0.5, 0.25, 1.0), abs=1 / 255)
    assert (found.metallic, found.roughness) == (1.0, 0.25)


def test_what_glows_is_seen_and_cutouts_are_not(few: str):
    glow = trimesh.visual.material.PBRMaterial(
        emissiveFactor=[1.0, 0.0, 0.0], baseColorFactor=[0, 0, 0, 255], metallicFactor=0.0
    )
    ball = trimesh.creation.icosphere(2, 1.0)
    ball.visual = trimesh.visual.TextureVisuals(material=glow)
    sheet = relief(2, 2)
    clear = np.full((8, 8, 4), [0, 255, 0, 0], np.uint8)
    sheet.visual.material.baseColorTexture = Image.fromarray(clear)
    sheet.visual.material.alphaMode = "MASK"
    sheet.apply_translation([0, 0, 2])
    trimesh.Scene([ball, sheet]).export("lamp.glb")
    how = ["--samples", "4", "--size", "32x24", "--elevation", "0"]
    succeed("render", "lamp.glb", "--display", few, *how, "--out", "f")
    red, green, blue = read_image("f/view_00_00.png")[:, 12, 16]
    assert red > 0.95
    assert max(green, blue) < 0.5


def test_edges_are_kept_where_a_file_has_no_normals():
    trimesh.creation.box().export("box.stl")
    box = read_model(Path("box.stl")).surfaces[0].by_corners()
    assert box.normals is not None
    assert np.sort(abs(box.normals), axis=1) == pytest.approx(np.tile([0, 0, 1], (36, 1)))
    trimesh.creation.icosphere(3).export("ball.stl")
    ball = read_model(Path("ball.stl")).surfaces[0].by_corners()
    assert ball.normals is not None
    radial = ball.vertices / np.linalg.norm(ball.vertices, axis=1, keepdims=True)
    assert (ball.normals * radial).sum(1).min() > 0.995


def test_stl_stands_up():
    tall = trimesh.creation.box((1, 1, 3))
    tall.export("tall.stl")
    extent = np.ptp(read_model(Path("tall.stl")).vertices, axis=0)
    assert extent == pytest.approx([1, 3, 1])
    assert np.ptp(read_model(Path("tall.stl"), "y").vertices, axis=0) == pytest.approx([1, 1, 3])


MITSUBA = """<scene version="3.0.0">
  <integrator type="path"/>
  <sensor type="perspective"><float name="fov" value="40"/>
    <transform name="to_world">
      <lookat origin="0, 1, 6" target="0, 0, 0" up="0, 1, 0"/></transform></sensor>
  <emitter type="constant"/>
  <shape type="sphere"><bsdf type="diffuse"/></shape>
</scene>"""


def test_scenes_of_mitsuba():
    Path("ball.xml").write_text(MITSUBA)
    said = succeed("render", "ball.xml", "--display", "perspective-3", "--samples", "4",
                   "--size", "48x32", "--depth", "--out", "field")  # fmt: skip
    assert "as deep as it is" in said
    depth = np.load("field/depth/depth_02_02.npy")
    # a ball, as large in its middle as the camera sees it there; the sky has no depth
    assert np.isfinite(depth).any(1).sum() == pytest.approx(0.65 * 32, abs=2)
    assert np.nanmin(depth) < -1.5 < 1.5 < np.nanmax(depth)
    assert load_light_field("field").size == (32, 48)


def test_turntables_and_paths():
    turned = turntable(3, Pose(10, 20))
    assert [p.azimuth for p in turned] == [10, 130, 250]
    Path("moves.csv").write_text("0,10\n15.5,20\n\n")
    assert read_poses(Path("moves.csv")) == (Pose(0, 10), Pose(15.5, 20))
    how = ["--display", "few.toml", "--preview", "--size", "24x18"]
    succeed("render", "sample", *how, "--turntable", "3", "--out", "turn")
    succeed("render", "sample", *how, "--path", "moves.csv", "--out", "moves")
    assert [f.name for f in sorted(Path("turn").glob("frame_*"))] == [
        "frame_0000", "frame_0001", "frame_0002",
    ]  # fmt: skip
    fields = [load_light_field(f"turn/frame_000{i}") for i in range(3)]
    assert all(field.grid == (2, 2) for field in fields)
    assert not torch.equal(fields[0].stored, fields[1].stored)
    assert len(list(Path("moves").glob("frame_*"))) == 2


def test_render_synth_and_view():
    relief().export("my-model.glb")
    how = ["--display", "perspective-3", "--samples", "4", "--size", "32x24"]
    succeed("render", "my-model.glb", *how, "--out", "my-field")
    succeed("synth", "my-field", "--display", "perspective-3", "--out", "my-layers")
    succeed("view", "my-layers", "--export", "page.html")
    assert Path("page.html").stat().st_size > 10_000


TRACED = ["render", "sample", "--display", "additive-3", "--samples", "2", "--size", "32x24"]


def test_a_killed_run_ends_as_if_it_had_not_been():
    succeed(*TRACED, "--out", "whole", "--depth")
    process = start(sys.executable, "-m", "layerfield", *TRACED, "--out", "out", "--depth")
    try:
        for _ in range(2400):
            if len(list(Path("out.unfinished").glob("view_*.png"))) >= 3:
                break
            time.sleep(0.05)
        os.killpg(process.pid, signal.SIGKILL)
    finally:
        finish(process)
    assert not Path("out").exists()
    kept = {f.name: f.stat().st_mtime_ns for f in Path("out.unfinished").glob("view_*.png")}
    assert len(kept) >= 3
    fails(run(*TRACED, "--out", "out", "--depth"), "out.unfinished", "resume")
    other = run(*TRACED, "--out", "out", "--depth", "--seed", "1", "--resume")
    fails(other, "another 'quality'")
    assert len(list(Path("out.unfinished").glob("view_*.png"))) == len(kept)
    succeed(*TRACED, "--out", "out", "--depth", "--resume")
    assert contents(Path("out")) == contents(Path("whole"))
    for name, when in kept.items():
        assert Path("out", name).stat().st_mtime_ns == when
    assert not Path("out.unfinished").exists()
    succeed(*TRACED, "--out", "out", "--depth", "--resume")  # nothing is left to do


def test_the_noise_is_that_of_the_seed():
    for name, seed in (("a", "0"), ("b", "0"), ("c", "1")):
        succeed("render", "sample", "--display", "few.toml", "--samples", "1", "--size", "16x12",
                "--seed", seed, "--out", name)  # fmt: skip
    views = [load_light_field(name).stored for name in "abc"]
    assert torch.equal(views[0], views[1])
    assert not torch.equal(views[0], views[2])


def test_an_llvm_that_aborts_is_noticed(monkeypatch):
    monkeypatch.setattr(variant, "_TRIAL", "import os; os.abort()")
    monkeypatch.delitem(sys.modules, "mitsuba")
    assert not variant._works(variant.start_trial())


PREVIEW = ["--display", "few.toml", "--preview", "--size", "24x18", "--out", "field"]


def damaged(what: str) -> str:
    """Write a model that cannot be rendered; return its name."""
    name = {"missing texture": "a.obj", "nan": "a.obj", "no faces": "a.ply"}.get(what, "a.glb")
    sheet = relief(4, 4)
    match what:
        case "missing texture":
            as_obj(sheet, Path(name))
            for picture in [*Path().glob("*.png"), *Path().glob("*.jp*g")]:
                picture.unlink()
        case "texture that is none":
            sheet.export("a.gltf")
            name = "a.gltf"
            document = json.loads(Path(name).read_text())
            document["images"] = [{"uri": "a.png"}]
            Path(name).write_text(json.dumps(document))
            Path("a.png").write_bytes(b"no picture")
        case "missing buffer":
            sheet.export("a.gltf")
            name = "a.gltf"
            for buffer in Path().glob("*.bin"):
                buffer.unlink()
        case "nan":
            Path(name).write_text("v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n")
        case "no faces":
            trimesh.PointCloud(np.eye(3)).export(name)
        case "garbage":
            Path(name).write_bytes(b"glTF and then nothing of use")
        case "one place":
            trimesh.Trimesh(np.ones((3, 3)), [[0, 1, 2]], process=False).export("a.ply")
            name = "a.ply"
        case "cut short":
            sheet.export(name)
            Path(name).write_bytes(Path(name).read_bytes()[:700])
    return name


@pytest.mark.parametrize(
    ("what", "words"),
    [
        ("missing texture", ("which is not there", "put the file beside")),
        ("texture that is none", ("a.png", "no picture")),
        ("missing buffer", ("a.gltf", "which is not there")),
        ("nan", ("1 of 3 vertices", "not finite")),
        ("no faces", ("no faces", "3 points")),
        ("garbage", ("cannot be read as GLB",)),
        ("one place", ("at one place",)),
        ("cut short", ("cannot be read as GLB",)),
    ],
)
def test_damaged_models_are_refused(what: str, words: tuple[str, ...]):
    fails(run("render", damaged(what), *PREVIEW), *words)
    assert not Path("field").exists()
    assert not Path("field.unfinished").exists()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (["nothing.glb"], ("nothing.glb", "no such file", "'sample'")),
        (["model.gbl"], ("unknown format '.gbl'", "did you mean '.glb'")),
        (["."], ("is a folder",)),
        (["sample", "--display", "additive"], ("did you mean 'additive-3'",)),
        (["sample", "--depth-mm", "4"], ("in px of disparity", "--depth-px")),
        (["sample", "--display", "perspective-3", "--depth-px", "4"], ("in mm", "--depth-mm")),
        (["sample", "--display", "perspective-3", "--depth-mm", "2000"], ("nearest viewer",)),
        (["sample", "--display", "flat.toml"], ("no depth", "px of disparity")),
        (["sample", "--fit", "0"], ("fit is 0",)),
        (["sample", "--fit", "0.5", "--scale", "2"], ("leave out either",)),
        (["sample", "--size", "24"], ("expected WxH",)),
        (["sample", "--size", "4x4"], ("expected 8 to",)),
        (["sample", "--up", "x"], ("expected y or z",)),
        (["sample", "--elevation", "120"], ("-90 to 90",)),
        (["sample", "--turntable", "0"], ("0 frames",)),
        (["sample", "--path", "none.csv"], ("none.csv",)),
        (["sample", "--path", "bad.csv"], ("bad.csv, line 2", "azimuth,elevation")),
        (["sample", "--turntable", "2", "--path", "bad.csv"], ("leave out either",)),
        (["sample", "--exposure", "99"], ("exposure",)),
        (["sample", "--samples", "9"], ("--samples 9", "--preview", "leave out either")),
        (["sample", "--seed", "0"], ("--seed 0", "--preview", "leave out either")),
        (["dark.xml", "--up", "z"], ("leave out up and no-ground",)),
        (["broken.xml"], ("cannot be read as a scene of Mitsuba",)),
        (["dark.xml"], ("has no light",)),
        (["blind.xml"], ("has no camera",)),
    ],
)
def test_wrong_input_is_one_line(change: list[str], words: tuple[str, ...]):
    Path("model.gbl").write_bytes(b"x")
    Path("bad.csv").write_text("1,2\n3,x\n")
    Path("flat.toml").write_text(
        'name = "flat"\nlink = "additive"\ndisparity = [0]\nviews = [3, 3]\n'
    )
    Path("broken.xml").write_text(MITSUBA.replace("diffuse", "no-such-matter"))
    Path("dark.xml").write_text(MITSUBA.replace('<emitter type="constant"/>', ""))
    sensor = MITSUBA[MITSUBA.index("  <sensor") : MITSUBA.index("  <emitter")]
    Path("blind.xml").write_text(MITSUBA.replace(sensor, ""))
    fails(run("render", change[0], *PREVIEW, *change[1:]), *words)
    assert not Path("field").exists()
    assert not Path("field.unfinished").exists()


def test_folders_of_others_are_kept():
    Path("field").mkdir()
    Path("field/diary.txt").write_text("dear")
    fails(run("render", "sample", *PREVIEW), "field exists")
    fails(run("render", "sample", *PREVIEW, "--force"), "not made here")
    Path("field/diary.txt").unlink()
    Path("field").rmdir()
    Path("field.unfinished").mkdir()
    Path("field.unfinished/diary.txt").write_text("dear")
    fails(run("render", "sample", *PREVIEW, "--force"), "field.unfinished", "not made here")
    assert Path("field.unfinished/diary.txt").read_text() == "dear"


def test_a_missing_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "mitsuba", None)
    fails(run("render", "sample", *PREVIEW), "mitsuba", "pip install 'layerfield[render]'")


def test_without_llvm_scenes_are_rendered_all_the_same(tmp_path):
    """The scalar variant; a process has one variant, so in a process of its own."""
    program = (
        "import sys, layerfield.rendering.variant as v; v._TRIAL = 'import os; os.abort()'; "
        "import layerfield.cli as c; c.main()"
    )
    how = ["render", "sample", "--display", "few.toml", "--samples", "1", "--size", "16x12"]
    ran = subprocess.run(
        [sys.executable, "-c", program, *how, "--out", "field"],
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    assert "docs/render.md" in ran.stdout
    assert json.loads(Path("field/render.json").read_text())["made_with"]["variant"] == "scalar_rgb"
