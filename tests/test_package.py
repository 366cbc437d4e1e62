"""The package as others meet it: public names, the wheel, the README, the displays."""

import re
import shlex
import subprocess
import sys
import tomllib
import venv
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch
from test_cli import run

import layerfield
from layerfield import DisparitySpec, Display, PhysicalSpec, preset_names
from layerfield.display_spec import format_spec, parse_spec
from layerfield.io import write_png
from layerfield.result import write_views
from layerfield.training.recipe import read_recipe
from layerfield.training.steps_recipe import read_steps_recipe

ROOT = Path(__file__).parents[1]


def test_public_names():
    assert sorted(layerfield.__all__, key=lambda n: (n.startswith("__"), n)) == [
        "DisparitySpec",
        "Display",
        "FieldOptions",
        "Geometry",
        "LightField",
        "METHODS",
        "PhysicalSpec",
        "Problem",
        "Reference",
        "Solution",
        "evaluate",
        "excess",
        "layer_figures",
        "load_light_field",
        "preset_names",
        "procedural_light_field",
        "psnr",
        "psnr_by_view",
        "reference",
        "solve",
        "ssim",
        "synthesize",
        "synthesize_frames",
        "__version__",
    ]
    for name in layerfield.__all__:
        assert getattr(layerfield, name) is not None


def test_one_version_everywhere():
    citation = (ROOT / "CITATION.cff").read_text("utf-8")
    assert f"version: {layerfield.__version__}\n" in citation
    assert "Apache License" in (ROOT / "LICENSE").read_text("utf-8")


def test_lower_rooms_do_not_import_higher_ones():
    """Data flows one way; a room is imported only by rooms listed after it."""
    order = [
        "version", "nearest", "own_process", "memory", "toml_model", "geometry", "kept_views",
        "light_field", "projection", "row_system", "grid_system", "links", "kernels", "clock",
        "lengths", "pieces", "back_projection", "warped_projection", "panel_projection",
        "frequencies", "band", "gram", "display_constants", "composition", "transfer", "panel_spec",
        "display_spec", "display", "panels", "motion", "problem", "solve", "half_size", "between",
        "tone", "solvers", "panel_images", "networks", "metrics", "provenance", "scenes", "io",
        "frames", "rendering", "rgbd", "eyes", "animation", "plane_sweep", "disparity", "weights",
        "shipped", "methods", "fast", "synthesizer", "stream", "reference", "evaluate", "remarks",
        "observers", "stored_result", "result", "simulation", "video", "spectrum", "design",
        "training", "report", "bench", "viewer", "demo", "reproduction", "cli", "__main__",
    ]  # fmt: skip
    source = ROOT / "src" / "layerfield"
    for file in source.rglob("*.py"):
        room = file.relative_to(source).parts[0].removesuffix(".py")
        if room == "__init__":
            continue
        assert room in order, f"{file} belongs to no room; place it in this list"
        for line in file.read_text("utf-8").splitlines():
            match = re.match(r"\s*from layerfield\.(\w+)", line)
            if match:
                assert order.index(match[1]) <= order.index(room), f"{file}: {line}"


def test_a_built_wheel_installs_and_runs(tmp_path):
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir"]
    subprocess.run([*build, str(tmp_path), str(ROOT)], check=True, capture_output=True)
    (wheel,) = tmp_path.glob("layerfield-*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    assert "layerfield/displays/additive-3.toml" in names
    assert "layerfield/trained/registry.json" in names
    assert "layerfield/report/page.css" in names
    assert not [name for name in names if name.startswith(("tests", "benchmarks"))]
    venv.create(tmp_path / "venv", with_pip=True, system_site_packages=False)
    python = tmp_path / "venv" / "bin" / "python"
    install = [str(python), "-m", "pip", "install", "--quiet", "--no-deps", "--no-index"]
    subprocess.run([*install, str(wheel)], check=True)
    # the dependencies are those of this environment; only layerfield comes from the wheel
    site = next(p for p in map(Path, sys.path) if (p / "torch").is_dir())
    own = subprocess.run(
        [str(python), "-c", "import sysconfig; print(sysconfig.get_paths()['purelib'])"],
        check=True, capture_output=True, text=True,
    ).stdout.strip()  # fmt: skip
    program = f"import sys; sys.path += [{str(site)!r}]; import layerfield.cli as c; c.main()"
    ran = subprocess.run(
        [str(python), "-c", program, "displays"],
        check=True, capture_output=True, text=True, cwd=tmp_path,
        env={"PYTHONPATH": own, "PATH": "/usr/bin:/bin"},
    )  # fmt: skip
    assert "additive-3" in ran.stdout


@pytest.mark.parametrize("name", preset_names())
def test_presets_go_through_their_files_unchanged(name):
    spec = Display.load(name).spec
    assert parse_spec(format_spec(spec), "again") == spec
    tomllib.loads(format_spec(spec))
    assert spec.name == name


def test_displays_go_through_toml_exactly():
    spec = PhysicalSpec(
        name='with "quotes" and \\',
        link="multiplicative",
        depth_mm=(12.345678901234567, 1 / 3),
        pitch_um=1e2 / 7,
        viewing_distance_mm=float("inf"),
        viewing_angle_deg=(10.0, 5.0),
        views=(3, 4),
    )
    assert parse_spec(format_spec(spec), "again") == spec
    listed = DisparitySpec(link="additive", disparity=(1.0,), viewpoints=((0.1, -2.0), (0.0, 0.0)))
    assert Display(parse_spec(format_spec(listed), "again")).geometry == listed.geometry()


def commands_in(document: str) -> list[str]:
    """Commands of the shell blocks of a document, continuation lines joined."""
    blocks = re.findall(r"```sh\n(.*?)```", document, flags=re.DOTALL)
    lines = "\n".join(blocks).replace("\\\n", " ").splitlines()
    return [line.split("#")[0].strip() for line in lines if line.split("#")[0].strip()]


def test_the_readme_opens_with_the_two_commands():
    commands = commands_in((ROOT / "README.md").read_text("utf-8"))
    assert commands[:2] == ["make demo", "make test"]


def runs(commands: list[str]) -> None:
    """Run commands; `view` would serve for ever, so it writes what it would serve.

    `render` makes small pictures, which takes seconds.
    """
    for command in commands:
        name, *words = shlex.split(command)
        assert name == "layerfield"
        if words[0] == "view" and "--export" not in words:
            words += ["--export", "served.html", "--force"]
        if words[0] == "render":
            words += ["--size", "32x24"]
            words += [] if "--preview" in words else ["--samples", "1"]
        done = run(*words)
        assert done.status == 0, f"{command}\n{done.err}"


def small_field(grid: tuple[int, int] = (5, 5)) -> layerfield.LightField:
    return layerfield.procedural_light_field(grid=grid, size=(40, 48))


@pytest.fixture
def my_views(tmp_path, monkeypatch, quick_references):
    """An empty folder with a light field called `my-views`, a photo and its depth map."""
    monkeypatch.chdir(tmp_path)
    write_png("photo.png", np.arange(40 * 48 * 3, dtype=np.uint8).reshape(3, 40, 48))
    write_png("depth.png", np.arange(40 * 48, dtype=np.uint16).reshape(1, 40, 48))
    write_views(Path("my-views"), small_field().views, Display.load("additive-3"), 8)


def test_every_command_of_the_readme_runs(my_views):
    readme = (ROOT / "README.md").read_text("utf-8")
    (toml,) = re.findall(r"```toml\n(.*?)```", readme, flags=re.DOTALL)
    Path("my-display.toml").write_text(toml, "utf-8")
    ours = [command for command in commands_in(readme) if command.startswith("layerfield")]
    runs([command for command in ours if not re.search(" (demo|train) ", f"{command} ")])


def test_every_command_of_the_page_on_networks_runs(my_views):
    """But for trainings, whose recipes are read only."""
    page = (ROOT / "docs" / "networks.md").read_text("utf-8")
    (toml,) = re.findall(r"```toml\n(.*?)```", page, flags=re.DOTALL)
    Path("my-recipe.toml").write_text(toml, "utf-8")
    trainings = [line.split()[2] for line in commands_in(page) if line.split()[1] == "train"]
    for given in trainings:
        recipe = read_recipe(Path(given) if "my-" in given else given)
        assert recipe.name == given.removesuffix(".toml")
    runs([command for command in commands_in(page) if command.split()[1] != "train"])
    for row in re.findall(r"^\| (`.*?) \|", page.split("| recipe |")[1], flags=re.MULTILINE):
        for recipe in re.findall("`(.*?)`", row):
            read_recipe(recipe)


def test_every_command_of_the_page_on_fast_runs(my_views, quick_references):
    """But for the training, whose recipe is read only."""
    commands = commands_in((ROOT / "docs" / "fast.md").read_text("utf-8"))
    assert read_steps_recipe(commands[-1].split()[2]).link == "additive"
    runs(commands[:-1])


def test_every_command_of_the_page_on_eyes_runs(tmp_path, monkeypatch, quick_references):
    page = (ROOT / "docs" / "eyes.md").read_text("utf-8")
    monkeypatch.chdir(tmp_path)
    nine = parse_spec('link = "additive"\ndisparity = [1, 0]\nviews = [9, 9]', "nine")
    field = small_field((9, 9))
    write_views(Path("my-views"), field.views, Display(nine), 8)
    (toml,) = re.findall(r"```toml\n(.*?)```", page, flags=re.DOTALL)
    Path("two-eyes.toml").write_text(toml, "utf-8")
    write_views(Path("my-eyes"), field.views[:2], Display.load("two-eyes.toml"), 8)
    three = 'name = "three"\nlink = "additive"\ndisparity = [1, 0, -1]\nviews = [3, 3]\n'
    Path("3x3.toml").write_text(three, "utf-8")
    runs(commands_in(page))
    for block in re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL):
        exec(compile(block, "eyes.md", "exec"), {})


def test_every_command_of_the_page_on_converting_runs(my_views):
    runs(commands_in((ROOT / "docs" / "convert.md").read_text("utf-8")))
    assert layerfield.load_light_field("row_qs5x1.png").grid == (1, 5)


def test_every_command_of_the_page_on_rgbd_runs(my_views):
    runs(commands_in((ROOT / "docs" / "rgbd.md").read_text("utf-8")))


def test_every_command_of_the_page_on_reports_runs(my_views):
    runs(commands_in((ROOT / "docs" / "report.md").read_text("utf-8")))
    assert Path("figures/layer-0.png").is_file()


PAGES = {
    "displays.md": ("three-in-time.toml", "for-the-middle/layers"),
    "panels.md": ("my-prototype.toml", "prototype/panels"),
}


def test_every_command_of_the_page_on_the_viewer_runs(my_views):
    runs(commands_in((ROOT / "docs" / "viewer.md").read_text("utf-8")))
    assert Path("page.html").stat().st_size > 100_000


def test_every_command_of_the_page_on_videos_runs(my_views):
    """But for those on Ray, which have tests of their own."""
    pytest.importorskip("av")
    from test_video import write_film  # noqa: PLC0415  which needs the same

    moving = layerfield.procedural_light_field(size=(40, 64)).views
    frames = [moving[..., number : number + 48] for number in range(3)]
    Path("my-take").mkdir()
    for number, frame in enumerate(frames):
        write_views(Path(f"my-take/frame_{number:04d}"), frame, Display.load("additive-3"), 8)
    tiles = torch.stack(frames).mul(255).byte().unflatten(1, (5, 5)).permute(0, 1, 4, 2, 5, 3)
    write_film(Path("my-quilts.mkv"), tiles.flatten(3, 4).flatten(1, 2).numpy())
    page = (ROOT / "docs" / "video-command.md").read_text("utf-8")
    blocks = re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL)
    for block in blocks:
        exec(compile(block, "video-command.md", "exec"), {})
    runs([command for command in commands_in(page) if " --ray " not in command])


def test_every_command_of_the_page_on_rendering_runs(my_views):
    page = (ROOT / "docs" / "render.md").read_text("utf-8")
    Path("moves.csv").write_text("0,10\n15,20\n")
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.icosphere(2).export("my-model.glb")
    runs([command for command in commands_in(page) if command.startswith("layerfield")])
    for block in re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL):
        exec(compile(block, "render.md", "exec"), {})


@pytest.mark.parametrize("name", PAGES)
def test_every_command_of_the_pages_on_displays_runs(my_views, name):
    """Each shows one display file, which its commands read."""
    (page, (file, made)) = (ROOT / "docs" / name).read_text("utf-8"), PAGES[name]
    (toml,) = re.findall(r"```toml\n(.*?)```", page, flags=re.DOTALL)
    Path(file).write_text(toml, "utf-8")
    runs(commands_in(page))
    assert Path(made).is_dir()


def test_every_python_block_of_the_readme_runs(my_views):
    readme = (ROOT / "README.md").read_text("utf-8")
    blocks = re.findall(r"```python\n(.*?)```", readme, flags=re.DOTALL)
    assert blocks
    for block in blocks:
        exec(compile(block, "README.md", "exec"), {})
