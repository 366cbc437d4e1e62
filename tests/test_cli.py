"""The command line as users meet it: what works; one line, status 2 and no traces where not."""

import contextlib
import errno
import getpass
import io
import json
import os
import re
import resource
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import h5py
import numpy as np
import pytest

from layerfield import cli
from layerfield.version import __version__

COMMAND = Path(sys.executable).with_name("layerfield")
HEIGHT, WIDTH = 24, 32
SYNTH = ["synth", "views", "--display", "additive-3", "--out", "out"]


class Outcome(NamedTuple):
    status: int
    out: str
    err: str


def run(*args: str | Path) -> Outcome:
    """Run the command in this process, with this process's arguments and signals put back."""
    out, err = io.StringIO(), io.StringIO()
    argv, numbers = sys.argv, (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    handlers = [signal.getsignal(number) for number in numbers]
    sys.argv = ["layerfield", *map(str, args)]
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            cli.main()
    except SystemExit as done:
        return Outcome(int(done.code or 0), out.getvalue(), err.getvalue())
    finally:
        sys.argv = argv
        for number, handler in zip(numbers, handlers, strict=True):
            signal.signal(number, handler)
    raise AssertionError("main returned")


def succeed(*args: str | Path) -> str:
    found = run(*args)
    assert (found.status, found.err) == (0, ""), found
    return found.out


def fails(found: Outcome, *words: str) -> None:
    """Assert that this is how an error looks: one line, one status, and it says the words."""
    assert found.status == 2, found
    assert found.out == ""
    assert re.fullmatch(r"layerfield: [^\n]{10,}\n", found.err), found.err
    assert "Traceback" not in found.err
    for word in words:
        assert word.lower() in found.err.lower(), (word, found.err)


def start(*args: str | Path, **how: Any) -> subprocess.Popen:
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    how = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "env": environment} | how
    return subprocess.Popen([*map(str, args)], text=True, start_new_session=True, **how)


def finish(process: subprocess.Popen) -> Outcome:
    try:
        out, err = process.communicate(timeout=120)
    finally:
        process.kill()
    return Outcome(process.returncode, out, err)


def contents(folder: Path) -> dict[str, bytes | None]:
    """Return everything below a folder, byte by byte."""
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None
        for path in folder.rglob("*")
    }


def write_views(
    folder: Path, grid=(5, 5), size=(HEIGHT, WIDTH), channels=3, change=lambda view: view
) -> Path:
    """Write a textured plane and a nearer one; no display shows it exactly."""
    folder.mkdir(parents=True)
    height, width = size
    texture = np.random.default_rng(0).random((2, height + 20, width + 20, channels))
    far, near = (cv2.GaussianBlur(t, (0, 0), 1.5).reshape(t.shape) for t in texture)
    covers = np.zeros((height + 20, width + 20, 1))
    covers[15 : 5 + height, 18 : 8 + width // 2] = 1
    for row in range(grid[0]):
        for column in range(grid[1]):
            y, x = row % 5, column % 5
            behind = far[4 - y :, 4 - x :][:height, :width]
            before, mask = (
                p[4 + (1 * y) :, 4 + (1 * x) :][:height, :width] for p in (near, covers)
            )
            view = change(mask * before + (1 - mask) * behind)
            pixels = (255 * view).round().astype(np.uint8)
            cv2.imwrite(str(folder / f"view_{row:02d}_{column:02d}.png"), pixels)
    return folder


def read(path: Path) -> np.ndarray:
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert image is not None
    return image


def stack(folder: Path) -> np.ndarray:
    """Return the views of a folder, `[row, column, y, x, c]`, 0 to 1."""
    images = [read(path) for path in sorted(folder.glob("view_*.png"))]
    values = np.stack(images) / np.iinfo(images[0].dtype).max
    return values.reshape(5, 5, HEIGHT, WIDTH, -1)


@pytest.fixture(scope="session")
def original(tmp_path_factory) -> Path:
    return write_views(tmp_path_factory.mktemp("original") / "views")


@pytest.fixture
def desk(tmp_path, original, monkeypatch) -> Path:
    """A working folder that holds a light field, `views`, and nothing else."""
    shutil.copytree(original, tmp_path / "desk" / "views")
    monkeypatch.chdir(tmp_path / "desk")
    return tmp_path / "desk"


@pytest.fixture(scope="session")
def made(original, tmp_path_factory) -> Path:
    """A result of synth, made from a light field given by its absolute path."""
    out = tmp_path_factory.mktemp("made") / "out"
    succeed("synth", original, "--display", "additive-3", "--out", out, "--simulate", "--history")
    return out


# ---------------------------------------------------------------------------------- what works


def test_synth_writes_layers_display_facts_and_views(made):
    names = sorted(entry.name for entry in made.iterdir())
    assert names == ["display.toml", "layers", "result.json", "views"]
    layers = sorted((made / "layers").iterdir())
    assert [layer.name for layer in layers] == ["layer_0.png", "layer_1.png", "layer_2.png"]
    for layer in layers:
        assert read(layer).shape == (HEIGHT + 4, WIDTH + 4, 3)
        assert read(layer).dtype == np.uint8
    assert len(list((made / "views").iterdir())) == 25
    assert [entry.name for entry in made.parent.iterdir()] == ["out"]


def test_facts(made, original):
    text = (made / "result.json").read_text()
    facts = json.loads(text, parse_constant=pytest.fail)
    assert facts["method"] == "fourier-admm"
    assert facts["iterations"] == len(facts["history"]) == 10
    assert facts["field"] == {"name": "views", "grid": [5, 5], "size": [24, 32], "options": {}}
    assert facts["display"] == "additive-3"
    assert facts["bits"] == 8
    assert facts["margin"] == [2, 2]
    assert facts["seed"] is None
    assert facts["seconds"] > 0
    assert facts["made_with"]["layerfield"] == __version__
    assert {"python", "torch"} < set(facts["made_with"])
    assert facts["psnr_view_min"] < facts["psnr"] < facts["psnr_view_max"]
    assert {"psnr_interior", "psnr_view_std", "ssim"} < set(facts)
    for layer in facts["layers"]:
        assert set(layer) == {"mean", "std", "gradient_energy", "peak"}
    for private in (str(original), str(made), "/", socket.gethostname(), getpass.getuser()):
        assert not re.search(rf"\b{re.escape(private)}\b", text)


def test_constants_of_steps_are_recorded_by_name(desk):
    succeed(*SYNTH, "--method", "fast", "--iterations", "2")
    swept = json.loads((desk / "out" / "result.json").read_text())["solver"]
    assert (swept["sweeps"], swept["inner"], swept["momentum"]) == (4, 6, 0.95)
    solver = swept["direct"]
    names = ["penalty", "relaxation", "trust", "kept", "momentum"]
    assert [list(each) for each in solver["full"]] == [names]
    assert solver["after"]["penalty"] == 0.05
    assert solver["relief"]["last"]["shape"] == [1, 4, 3, 3]
    assert len(solver["relief"]["last"]["sha256"]) == 64


def test_psnr_is_that_of_the_written_pictures(made, original):
    layers = [read(made / "layers" / f"layer_{k}.png") / 255 for k in range(3)]
    views = np.zeros((5, 5, HEIGHT, WIDTH, 3))
    for row in range(5):
        for column in range(5):
            for layer, disparity in zip(layers, (1, 0, -1), strict=True):
                y, x = 2 + (row - 2) * disparity, 2 + (column - 2) * disparity
                views[row, column] += layer[y : y + HEIGHT, x : x + WIDTH]
    psnr = -10 * np.log10(np.mean((views - stack(original)) ** 2))
    assert json.loads((made / "result.json").read_text())["psnr"] == pytest.approx(psnr, abs=1e-4)
    assert psnr > 20
    assert np.abs(stack(made / "views") - views.clip(0, 1)).max() <= 0.5 / 255 + 1e-6


def test_the_same_input_gives_the_same_bytes(made, desk):
    succeed(*SYNTH, "--simulate")
    for part in ("layers", "views"):
        assert contents(desk / "out" / part) == contents(made / part)


@pytest.mark.parametrize("display", ["additive-3", "multiplicative-3", "perspective-3"])
def test_simulate_shows_what_synth_showed(desk, display):
    succeed("synth", "views", "--display", display, "--out", "out", "--simulate", "--bits", "16")
    succeed("simulate", "out", "--out", "seen", "--bits", "16", "--array")
    assert contents(desk / "seen" / "views") == contents(desk / "out" / "views")
    assert (desk / "seen" / "display.toml").read_text() == (desk / "out/display.toml").read_text()
    array = np.load(desk / "seen" / "views.npy")
    assert array.shape == (5, 5, HEIGHT, WIDTH, 3)
    red_first = stack(desk / "seen" / "views")[..., ::-1]
    assert np.abs(array.clip(0, 1) - red_first).max() <= 0.5 / 65535 + 1e-6


def test_simulate_a_plain_folder(desk, made):
    shutil.copytree(made / "layers", "plain")
    (desk / "plain" / "._layer_0.png").write_bytes(b"what other systems leave behind")
    args = ["simulate", "plain", "--display", "additive-3"]
    succeed(*args, "--margin", "0", "--out", "wide")
    assert read(desk / "wide/views/view_00_00.png").shape == (HEIGHT + 4, WIDTH + 4, 3)
    for path in (made / "views").iterdir():
        wide = read(desk / "wide" / "views" / path.name)[2:-2, 2:-2]
        assert np.array_equal(wide, read(path))
    succeed(*args, "--out", "same")
    assert contents(desk / "same" / "views") == contents(made / "views")


def test_simulate_what_eyes_see(desk, made):
    """Eyes at viewpoints see these views; others see what their place and distance shows."""
    places = ["--eye", "-2,-2", "--eye", "0,1", "--eye", "0.5,0,300"]
    succeed("simulate", made, "--out", "seen", *places, "--array")
    names = sorted(path.name for path in (desk / "seen/views").iterdir())
    assert names == ["eye_00.png", "eye_01.png", "eye_02.png"]
    for name, view in (("eye_00", "view_00_00"), ("eye_01", "view_03_02")):
        seen, shown = desk / f"seen/views/{name}.png", made / f"views/{view}.png"
        assert seen.read_bytes() == shown.read_bytes()
    assert np.load(desk / "seen/views.npy").shape == (1, 3, HEIGHT, WIDTH, 3)


def test_eyes_in_millimetres(desk):
    succeed(*SYNTH[:-4], "--display", "perspective-3", "--out", "out", "--simulate")
    edge = 500 * np.tan(np.radians(4))
    places = ["--eye", f"{edge},0", "--eye", f"{edge},0,500", "--eye", f"{edge},0,1000"]
    succeed("simulate", "out", "--out", "seen", *places)
    one, two, far = (read(path) for path in sorted((desk / "seen/views").iterdir()))
    assert np.array_equal(one, read(desk / "out/views/view_02_04.png"))
    assert np.array_equal(one, two)
    assert not np.array_equal(one, far)


def test_eyes_at_different_distances(desk):
    (desk / "d.toml").write_text(APART)
    succeed("synth", "views", "--views", "1x2", *OWN[2:], "--simulate", "--reference")
    assert len(list((desk / "out/views").iterdir())) == 2
    succeed("simulate", "out", "--out", "seen", "--eye", "-32,0,500", "--eye", "32,0,560")
    for eye, view in (("eye_00", "view_00_00"), ("eye_01", "view_00_01")):
        seen, shown = read(desk / f"seen/views/{eye}.png"), read(desk / f"out/views/{view}.png")
        assert np.array_equal(seen, shown)


@pytest.mark.parametrize("bits", ["8", "16"])
def test_grey_fields_give_grey_layers(desk, bits):
    write_views(desk / "grey", channels=1)
    args = ["--display", "perspective-3", "--out", "out", "--bits", bits, "--rounding", "nearest"]
    assert f"{bits} bit" in succeed("synth", "grey", *args, "--simulate")
    facts = json.loads((desk / "out/result.json").read_text())
    y, x = facts["margin"]
    layer = read(desk / "out" / "layers" / "layer_0.png")
    assert layer.shape == (HEIGHT + 2 * y, WIDTH + 2 * x)
    assert layer.dtype == (np.uint8 if bits == "8" else np.uint16)


def test_field_options_are_recorded(desk):
    write_views(desk / "many", (9, 9))
    args = ["--display", "additive-3", "--out", "out", "--step", "2", "--crop", "16x12"]
    succeed("synth", "many", *args)
    found = json.loads((desk / "out/result.json").read_text())["field"]
    assert found["size"] == [12, 16]
    assert found["options"]["step"] == "2"


def test_force_replaces_an_earlier_result(desk):
    succeed(*SYNTH, "--simulate")
    succeed(*SYNTH, "--force", "--iterations", "0")
    assert json.loads((desk / "out/result.json").read_text())["iterations"] == 0
    assert not (desk / "out" / "views").exists()
    assert sorted(entry.name for entry in desk.iterdir()) == ["out", "views"]


def test_a_result_called_like_its_display_can_be_replaced(desk):
    for force in ([], ["--force"]):
        succeed("synth", "views", "--display", "additive-3", "--out", "additive-3", *force)


@pytest.mark.parametrize(
    "name", ["with space", "ünï/cödé 日本", "[bold]x", "[/x]", ":smile:", "-x"]
)
def test_odd_names(desk, name):
    folder = desk / "odd" / name
    shutil.copytree("views", folder / "views")
    out = succeed("synth", "--display", "additive-3", f"--out=odd/{name}/out", f"odd/{name}/views")
    assert f"odd/{name}/out/layers" in out
    succeed("simulate", f"odd/{name}/out", "--out", f"odd/{name}/seen")


def test_a_leading_dash_after_two_dashes(desk):
    (desk / "views").rename(desk / "-views")
    succeed("synth", "--display", "additive-3", "--out", "out", "--", "-views")


def test_links_are_followed_and_never_written_through(desk):
    (desk / "link").symlink_to("views")
    succeed("synth", "link", "--display", "additive-3", "--out", "out")
    (desk / "other").symlink_to("out")
    before = contents(desk / "out")
    succeed("synth", "link", "--display", "additive-3", "--out", "other", "--bits", "16", "--force")
    assert contents(desk / "out") == before
    assert not (desk / "other").is_symlink()


def test_a_display_of_ones_own_survives_the_round_trip(desk):
    (desk / "d.toml").write_text(
        'name = "a\\tb\\r\\u001b\\u007f 日本 \\U0001F600 \\"q\\" \\\\"\nlink = "multiplicative"\n'
        "disparity = [0.5, -1]\nviews = [5, 5]\n",
        "utf-8",
    )
    succeed("synth", "views", "--display", "d.toml", "--out", "out", "--simulate")
    succeed("simulate", "out", "--out", "seen")
    assert contents(desk / "seen" / "views") == contents(desk / "out" / "views")


def test_info(desk):
    out = succeed("info", "views")
    assert "5x5, 32x24 px, colour" in out
    assert "contact sheet: views-views.png" in out
    assert read(desk / "views-views.png").shape[2] == 3
    succeed("info", "views")  # its own contact sheets may be replaced
    succeed("info", "views", "--contact-sheet", "sheet.png")
    assert sorted(e.name for e in desk.iterdir()) == ["sheet.png", "views", "views-views.png"]


def test_lists():
    assert {"additive-3", "multiplicative-3", "perspective-3"} < set(succeed("displays").split())
    assert {"fourier-admm", "nmf", "sart", "sweeps"} < set(succeed("methods").split())
    assert succeed("--version") == f"layerfield {__version__}\n"
    assert "Usage" in succeed("--help")
    assert "--rounding" in succeed("synth", "--help")


def test_as_a_module(desk):
    found = finish(start(sys.executable, "-m", "layerfield", "--version"))
    assert found == (0, f"layerfield {__version__}\n", "")


def test_evaluate_in_its_own_processes(desk):
    """Two light fields of one name stay apart, too."""
    write_views(desk / "other" / "views")
    fields = ["views", "other/views"]
    methods = ["--methods", "fourier-admm:2,nmf", "--iterations", "3"]
    args = ["--display", "additive-3", *methods, "--crop", "16x16", "--json", "rows.json"]
    found = finish(start(COMMAND, "evaluate", *fields, *args))
    assert (found.status, found.err) == (0, "")
    rows = json.loads((desk / "rows.json").read_text(), parse_constant=pytest.fail)
    assert {"fourier-admm:2", "nmf:3", "desk/views", "other/views"} < set(found.out.split())
    expected = (
        "field display method iterations psnr psnr_interior excess reference_psnr reference_kind "
        "ssim psnr_view_min psnr_view_max psnr_view_std layers seconds peak_mb"
    )
    for row in rows:
        assert set(expected.split()) <= set(row)
        assert len(row["layers"]) == 3
        assert all(
            set(layer) == {"mean", "std", "gradient_energy", "peak"} for layer in row["layers"]
        )
        assert row["peak_mb"] > 1
        assert row["excess"] >= 0
    assert [(row["field"], row["method"], row["iterations"]) for row in rows] == [
        (field, method, count)
        for field in ("desk/views", "other/views")
        for method, count in (("fourier-admm", 2), ("nmf", 3))
    ]
    for asked in ([], ["--reference"]):  # by now it is known
        out = succeed(*SYNTH, "--crop", "16x16", "--force", *asked)
        assert re.search(r"; optimum \d\d\.\d\d dB, excess \d+\.\d%", out)
    found = json.loads((desk / "out" / "result.json").read_text())
    assert found["reference"]["psnr"] == rows[0]["reference_psnr"] > found["psnr"] - 0.01


def test_evaluate_between(desk, quick_references):
    """Every second view is shown, those between are judged, or are targets, too."""
    every_second = ["--step", "2", "--views", "3x3", "--display", "d.toml"]
    (desk / "d.toml").write_text(FLAT.replace("[5, 5]", "[3, 3]"))
    args = [
        "--methods",
        "fourier-admm:40",
        "--between",
        "--eye-map",
        "m.png",
        "--json",
        "rows.json",
    ]
    assert "between" in succeed("evaluate", "views", *every_second, *args).split()
    assert read(desk / "m.png").shape[0] > 100
    (plain,) = json.loads((desk / "rows.json").read_text())
    assert len(plain["eyes"]) == 25
    targets = ["--targets-between", "given:1", "--force"]
    succeed("evaluate", "views", *every_second, *args, *targets)
    (row,) = json.loads((desk / "rows.json").read_text())
    assert row["psnr_between"] > plain["psnr_between"]
    assert row["psnr"] < plain["psnr"]
    assert row["details"]["weight_between"] == 1
    succeed("synth", "views", *every_second, *targets, "--out", "out")
    facts = json.loads((desk / "out/result.json").read_text())
    assert facts["field"]["options"]["targets-between"] == "given:1"


def test_demo(desk):
    found = finish(start(COMMAND, "demo"))
    assert (found.status, found.err) == (0, "")
    out = found.out
    assert "additive-3" in out
    assert "multiplicative-3" in out
    names = {entry.name for entry in (desk / "demo").iterdir()}
    assert {"additive-3", "multiplicative-3", "field", "result.json", "comparison.png"} == names
    assert len(list((desk / "demo" / "field").iterdir())) == 25
    succeed("simulate", "demo/additive-3", "--out", "seen")
    assert contents(desk / "seen/views") == contents(desk / "demo/additive-3/views")
    fails(run("demo"), "demo exists", "force")


# ------------------------------------------------------------------------- what does not: files

Prepare = Callable[[Path], object]


def case(name: str, args: str | list[str], words: str, prepare: Prepare = lambda desk: None):
    """One bad call: its name, arguments, words of its error (by `|`), and what lies there."""
    split = args.split() if isinstance(args, str) else args
    return pytest.param(prepare, split, words.split("|"), id=name)


def put(name: str, data: str | bytes) -> Prepare:
    return lambda desk: (desk / name).write_bytes(data.encode() if isinstance(data, str) else data)


def save(name: str, array) -> Prepare:
    return lambda desk: np.save(desk / name, np.asarray(array))


def truncate(desk: Path) -> None:
    path = desk / "views" / "view_03_01.png"
    path.write_bytes(path.read_bytes()[:-200])


def smaller(desk: Path) -> None:
    cv2.imwrite(str(desk / "views/view_01_02.png"), np.zeros((HEIGHT, WIDTH - 1, 3), np.uint8))


def grey(desk: Path) -> None:
    cv2.imwrite(str(desk / "views/view_01_02.png"), np.zeros((HEIGHT, WIDTH), np.uint8))


def picture(desk: Path) -> None:
    cv2.imwrite(str(desk / "all.png"), np.zeros((50, 51, 3), np.uint8))


def with_nan(value: float) -> np.ndarray:
    array = np.full((5, 5, HEIGHT, WIDTH, 3), 0.5, np.float32)
    array[3, 2, 1, 0, 2] = value
    return array


def archive(desk: Path) -> None:
    np.savez(desk / "f.npz", a=with_nan(0), b=with_nan(0))


def hdf5(desk: Path) -> None:
    with h5py.File(desk / "f.h5", "w") as file:
        file["other"] = [1, 2]


def cut_array(desk: Path) -> None:
    np.save(desk / "f.npy", with_nan(0))
    data = (desk / "f.npy").read_bytes()
    (desk / "f.npy").write_bytes(data[: len(data) // 2])


def field(name: str) -> list[str]:
    return ["synth", name, "--display", "additive-3", "--out", "out"]


def line(desk: Path) -> None:
    (desk / "none").mkdir()
    for n, path in enumerate(sorted((desk / "views").iterdir())):
        shutil.copy(path, desk / "none" / f"{n}.png")


FIELDS = [
    case("missing view", SYNTH, "lacks 1|02_03", lambda d: (d / "views/view_02_03.png").unlink()),
    case("two files for one view", SYNTH, "two files|view_0_0", put("views/view_0_0.png", b"x")),
    case("mixed sizes", SYNTH, "view_01_02.png|31x24|32x24|one size", smaller),
    case("mixed kinds", SYNTH, "view_01_02.png is grey|in colour", grey),
    case("not a picture", SYNTH, "view_01_01.png|not a picture", put("views/view_01_01.png", "hi")),
    case("no bytes", SYNTH, "view_01_01.png|not a picture", put("views/view_01_01.png", b"")),
    case("truncated", SYNTH, "view_03_01.png|truncated", truncate),
    case("empty folder", field("none"), "no pictures|none", lambda d: (d / "none").mkdir()),
    case("no such field", field("veiws"), "there is no file or folder veiws"),
    case("no name", [*SYNTH[:1], "", *SYNTH[2:]], "no pictures"),
    case("a text", field("f.txt"), "f.txt|expected a folder", put("f.txt", "hi")),
    case("a display", field("f.toml"), "f.toml|expected a folder", put("f.toml", "a=1")),
    case("views in a line", field("none"), "25 views|grid", line),
    case("one view", [*SYNTH, "--views", "1x1"], "1x1|5x5"),
    case("3x3 of 5x5", [*SYNTH, "--views", "3x3"], "3x3 views|'additive-3' expects 5x5"),
    case("more views than there are", [*SYNTH, "--views", "7x7"], "views is 7x7|5x5"),
    case("wrong grid", [*SYNTH, "--grid", "4x4"], "grid given is 4x4|5x5"),
    case("grid of words", [*SYNTH, "--grid", "five"], "grid is 'five'|5x5"),
    case("grid of nothing", [*SYNTH, "--grid", "0x5"], "grid is '0x5'"),
    case("order", [*SYNTH, "--order", "tl"], "order is 'tl'|tl-row"),
    case("step", [*SYNTH, "--step", "0"], "step is 0"),
    case("step too wide", [*SYNTH, "--step", "9"], "step is 9|smaller"),
    case("shift", [*SYNTH, "--shift", "nan"], "shift is nan"),
    case("shift too far", [*SYNTH, "--shift", "40"], "shift is 40|smaller"),
    case("scale", [*SYNTH, "--scale", "-1"], "scale is -1|above 0"),
    case("scale to nothing", [*SYNTH, "--scale", "0.1"], "3x2 px|at least 11x11"),
    case("crop", [*SYNTH, "--crop", "5"], "crop is '5'|WxH"),
    case("crop outside", [*SYNTH, "--crop", "20x20+20+0"], "crop is 20x20 at 20,0|32x24"),
    case("quilt of a folder", [*SYNTH, "--quilt", "5x5"], "is a folder|quilt"),
    case("lenslets of a number", [*SYNTH, "--lenslet", "x"], "lenslet is 'x'"),
    case("no grid", field("all.png"), "one picture|grid", picture),
    case("tiles do not fit", [*field("all.png"), "--grid", "5x5"], "51x50|do not divide", picture),
    case("lenslets do not", [*field("all.png"), "--lenslet", "5"], "51x50|do not divide", picture),
    case("nan", field("f.npy"), "view 17|not finite", save("f.npy", with_nan(np.nan))),
    case("inf", field("f.npy"), "view 17|not finite", save("f.npy", with_nan(np.inf))),
    case("out of range", field("f.npy"), "0.5 to 2|expected 0 to 1", save("f.npy", with_nan(2))),
    case("whole numbers", field("f.npy"), "int64", save("f.npy", np.ones((5, 5, 24, 32, 3), int))),
    case("shape", field("f.npy"), "shape (5, 5)|expected", save("f.npy", np.ones((5, 5)))),
    case("empty array", field("f.npy"), "empty array", save("f.npy", np.ones((0, 5, 8, 8, 3)))),
    case("pickled", field("f.npy"), "f.npy|NumPy", save("f.npy", np.array([{}], object))),
    case("cut array", field("f.npy"), "f.npy|damaged", cut_array),
    case("quilt of an array", [*field("f.npy"), "--quilt", "5x5"], "is an array", cut_array),
    case("two arrays", field("f.npz"), "2 arrays|views", archive),
    case("no archive", field("f.npz"), "f.npz|damaged", put("f.npz", b"PK\3\4 and no more")),
    case("no dataset", field("f.h5"), "no dataset /LF|other", hdf5),
    case("no hdf5", field("f.h5"), "f.h5|damaged", put("f.h5", b"hi")),
]


# ----------------------------------------------------------------------------------- displays


OWN = ["synth", "views", "--display", "d.toml", "--out", "out"]


def display(name: str, text: str, words: str):
    return case(name, OWN, f"d.toml|{words}", put("d.toml", text))


FLAT = 'link = "additive"\nviews = [5, 5]\ndisparity = [1, 0, -1]\n'
DEEP = (
    'link = "additive"\ndepth_mm = [12, 0, -12]\npitch_um = 400\nviewing_distance_mm = 500\n'
    "viewing_angle_deg = 8\nviews = [5, 5]\n"
)


def flat(name: str, old: str, new: str, words: str):
    assert old in FLAT
    return display(name, FLAT.replace(old, new), words)


def deep(name: str, old: str, new: str, words: str):
    assert old in DEEP
    return display(name, DEEP.replace(old, new), words)


APART = (
    'link = "additive"\ndepth_mm = [12, 0, -12]\npitch_um = 400\n'
    "viewpoints_mm = [[-32, 0, 500], [32, 0, 560]]\n"
)


def apart(name: str, old: str, new: str, words: str):
    assert old in APART
    return display(name, APART.replace(old, new), words)


LAYERS = "[1, 0, -1]"
DISPLAYS = [
    case("display", [*SYNTH, "--display", "addtive-3"], "'addtive-3'|did you mean 'additive-3'"),
    case(
        "display far off",
        [*SYNTH, "--display", "hologram"],
        "known are additive-3, desktop-lcd, multi",
    ),
    case("nameless display", [*SYNTH, "--display", ""], "unknown display ''"),
    case("no such file", [*SYNTH, "--display", "no.toml"], "no.toml|No such file"),
    case("a folder", [*SYNTH, "--display", "views"], "unknown display 'views'"),
    case("a picture", [*SYNTH, "--display", "views/view_00_00.png"], "not a text file"),
    display("empty", "", "'link' is missing"),
    display("no TOML", "link = additive", "not valid TOML"),
    display("binary", "link = '\0'", "not valid TOML"),
    display("nested", "a = " + "[" * 100_000, "not valid TOML"),
    display("long number", "a = " + "1" * 5000, "not valid TOML"),
    flat("key twice", "views = ", "views = [5, 5]\nviews = ", "not valid TOML|overwrite|line 3"),
    flat("typo", "disparity", "dispartiy", "unknown key 'dispartiy'; did you mean 'disparity'?"),
    flat("foreign key", "views", "colour = 1\nviews", "unknown key 'colour'; known are"),
    flat("in a table", FLAT, f"[display]\n{FLAT}", "unknown key 'display'"),
    flat(
        "link",
        '"additive"',
        '"aditive"',
        "'link' is 'aditive'|'additive', 'multiplicative' or 'polarisation'",
    ),
    flat("a text for views", "[5, 5]", '"5x5"', "'views' is '5x5'|list"),
    flat("one number for views", "[5, 5]", "[5]", "'views' holds too few numbers"),
    flat("zero columns", "[5, 5]", "[5, 0]", "'views[1]' is 0|greater than or equal to 1"),
    flat("zero rows", "[5, 5]", "[0, 5]", "'views[0]' is 0|greater than or equal to 1"),
    flat("half a view", "[5, 5]", "[5, 2.5]", "'views[1]' is 2.5|integer"),
    flat("too many views", "[5, 5]", "[9999, 9999]", "'views' is [9999, 9999]|at most"),
    case("other views", OWN, "'views' has 5x5|expects 3x3", put("d.toml", FLAT.replace("5", "3"))),
    flat("no layers", LAYERS, "[]", "'disparity' is []|at least 1"),
    flat("9 layers", LAYERS, "[9, 8, 7, 6, 5, 4, 3, 2, 1]", "'disparity' is|at most 8|9"),
    flat("back to front", LAYERS, "[-1, 0, 1]", "decrease from front to back|-1 before 0"),
    flat("equal depths", LAYERS, "[1, 1]", "decrease from front to back|1 before 1"),
    flat("no number", LAYERS, '["1", 0]', "'disparity[0]' is '1'|number"),
    flat("not finite", LAYERS, "[1, nan]", "'disparity[1]' is nan|finite"),
    flat("infinite", LAYERS, "[inf, 0]", "'disparity[0]' is inf|finite"),
    flat("no pixel that far", LAYERS, "[1e300, 0]", "px, expected at most"),
    flat("overflow", LAYERS, "[1e308, 0]", "inf px, expected at most 4096|units"),
    flat("both", "views", "viewpoints = [[0, 0]]\nviews", "'views' or 'viewpoints'|both"),
    flat("neither", "views = [5, 5]\n", "", "'views' or 'viewpoints'|neither"),
    flat("no viewpoints", "views = [5, 5]", "viewpoints = []", "no viewpoints|at least one"),
    flat("half a point", "views = [5, 5]", "viewpoints = [[0]]", "'viewpoints' holds too few"),
    flat("bad point", "views = [5, 5]", "viewpoints = [[0, nan]]", "'viewpoints[0][1]' is nan"),
    case(
        "few viewpoints",
        OWN,
        "25 views|expects 1",
        put("d.toml", FLAT.replace("views = [5, 5]", "viewpoints = [[0, 0]]")),
    ),
    deep("layer at the viewer", "[12, 0", "[500, 0", "0.5 m is at or behind the viewer|move"),
    deep("layer behind the viewer", "[12, 0", "[501, 0", "at or behind the viewer at 0.5 m"),
    deep("layer near the viewer", "[12, 0", "[499.9, 0", "px, expected at most 4096|units"),
    deep("depths ascend", "[12, 0, -12]", "[-12, 0, 12]", "decrease from front to back"),
    deep("no distance", "= 500", "= 0", "'viewing_distance_mm' is 0|greater than 0"),
    deep("distance behind", "= 500", "= -500", "'viewing_distance_mm' is -500|greater than 0"),
    deep("distance nan", "= 500", "= nan", "'viewing_distance_mm' is nan|greater than 0"),
    deep("angle 0", "= 8", "= 0", "'viewing_angle_deg' is 0.0|between 0 and 180"),
    deep("angle 180", "= 8", "= 180", "'viewing_angle_deg' is 180.0|between 0 and 180"),
    deep("negative angle", "= 8", "= -8", "'viewing_angle_deg' is -8.0|between 0 and 180"),
    deep("angle of words", "= 8", '= "wide"', "'viewing_angle_deg' is 'wide'|number"),
    deep("one angle in a list", "= 8", "= [8]", "'viewing_angle_deg' is [8]|number"),
    deep("no angle", "viewing_angle_deg = 8\n", "", "'viewing_angle_deg' is missing"),
    deep("pitch 0", "= 400", "= 0", "'pitch_um' is 0|greater than 0"),
    deep("pitch infinite", "= 400", "= inf", "'pitch_um' is inf|finite"),
    deep("pitch in mm", "= 400", "= 0.0004", "px, expected at most 4096|units"),
    deep("no pitch", "pitch_um = 400\n", "", "'pitch_um' is missing"),
    deep(
        "viewpoints, no distance",
        "= 500\nviewing_angle_deg = 8\nviews = [5, 5]",
        "= 0\nviewpoints_mm = [[1, 1]]",
        "'viewing_distance_mm' is 0",
    ),
    deep(
        "viewpoints at infinity",
        "= 500\nviewing_angle_deg = 8\nviews = [5, 5]",
        "= inf\nviewpoints_mm = [[1, 1]]",
        "'viewpoints_mm' needs a finite 'viewing_distance_mm'",
    ),
]


# ------------------------------------------------------------------------------------ options

SIMULATE = ["simulate", "r", "--out", "out"]
EVALUATE = ["evaluate", "views", "--display", "additive-3", "--json", "out"]


def result(desk: Path, facts: str | None = None) -> None:
    """Write a small result by hand: three layers of 12x12 px on additive-3."""
    (desk / "r" / "layers").mkdir(parents=True)
    for k in range(3):
        cv2.imwrite(str(desk / f"r/layers/layer_{k}.png"), np.zeros((12, 12, 3), np.uint8))
    (desk / "r" / "display.toml").write_text(FLAT)
    (desk / "r" / "result.json").write_text('{"margin": [2, 2]}' if facts is None else facts)


def result_with(name: str, data: str | bytes) -> Prepare:
    def prepare(desk: Path) -> None:
        result(desk)
        put(f"r/{name}", data)(desk)

    return prepare


def lacking(*names: str) -> Prepare:
    def prepare(desk: Path) -> None:
        result(desk)
        for name in names:
            (desk / "r" / name).unlink()

    return prepare


def odd_layer(desk: Path) -> None:
    result(desk)
    cv2.imwrite(str(desk / "r/layers/layer_1.png"), np.zeros((12, 12), np.uint8))


def result_among_views(desk: Path) -> None:
    """A folder that may be replaced, but for the light field in it."""
    (desk / "views").rename(desk / "kept")
    (desk / "out").mkdir()
    (desk / "kept").rename(desk / "out" / "views")
    (desk / "out" / "result.json").write_text("{}")


def facts(name: str, text: str):
    return case(
        f"margin {name}", SIMULATE, "result.json holds no margin", partial(result, facts=text)
    )


OPTIONS = [
    case("unknown command", "synt views", "No such command 'synt'|synth"),
    case("unknown option", [*SYNTH, "--metod", "nmf"], "No such option|--metod|--method"),
    case("no field", "synth", "missing argument|field"),
    case("no display", "synth views --out out", "missing option|--display"),
    case("no out", "synth views --display additive-3", "missing option|--out"),
    case("no value", "synth views --display additive-3 --out", "--out"),
    case("two fields", [*SYNTH, "views"], "unexpected|views"),
    case("iterations of words", [*SYNTH, "--iterations", "1e3"], "--iterations|integer"),
    case("negative iterations", [*SYNTH, "--iterations", "-1"], "iterations|0"),
    case("method", [*SYNTH, "--method", "fourier-adm"], "unknown method|did you mean 'fourier-a"),
    case("method far off", [*SYNTH, "--method", "magic"], "known are fast"),
    case("rounding", [*SYNTH, "--rounding", "jiont"], "unknown rounding|did you mean 'joint'"),
    case("rounding far off", [*SYNTH, "--rounding", "up"], "known are joint, nearest"),
    case("bits", [*SYNTH, "--bits", "7"], "7 bits|8 or 16"),
    case("device", [*SYNTH, "--device", "tpu"], "unknown device 'tpu'|cpu"),
    case(
        "method of other displays",
        [*SYNTH, "--display", "multiplicative-3", "--method", "nmf"],
        "'nmf' serves additive|'multiplicative-3' is multiplicative",
    ),
    case("no such result", SIMULATE, "there is no folder r"),
    case("no layers", "simulate views/none --out out", "no folder views/none"),
    case("empty result", SIMULATE, "no layer images|layer_0.png", lambda d: (d / "r").mkdir()),
    case("views are no layers", "simulate views --out out --display additive-3", "25|has 3"),
    case("no display known", SIMULATE, "no display.toml|--display", lacking("display.toml")),
    case("a layer is missing", SIMULATE, "2 layer images|has 3", lacking("layers/layer_1.png")),
    case("a layer differs", SIMULATE, "layer_1.png|grey|one size and one kind", odd_layer),
    case("layer damaged", SIMULATE, "not a picture", result_with("layers/layer_2.png", b"x")),
    case(
        "display of 2 layers",
        SIMULATE,
        "3 layer images|has 2",
        result_with("display.toml", FLAT.replace("[1, 0, -1]", "[1, 0]")),
    ),
    case(
        "result's display damaged",
        SIMULATE,
        "display.toml|did you mean 'link'",
        result_with("display.toml", FLAT.replace("link", "lnk")),
    ),
    case("margin of all", [*SIMULATE, "--margin", "6"], "12x12|margin of 6x6|smaller", result),
    case("margin negative", [*SIMULATE, "--margin", "-1"], "margin of -1x-1|0 or more", result),
    case("margin of words", [*SIMULATE, "--margin", "two"], "--margin|integer", result),
    case("bits of views", [*SIMULATE, "--bits", "12"], "12 bits|8 or 16", result),
    facts("in no JSON", "{"),
    facts("in a binary", "\x00\x01"),
    facts("nowhere", "{}"),
    facts("in a list", "[]"),
    facts("of one number", '{"margin": [1]}'),
    facts("of a text", '{"margin": "12"}'),
    facts("infinite", '{"margin": [Infinity, 1]}'),
    facts("nested", "[" * 100_000),
    case("no methods", EVALUATE, "missing option|--methods"),
    case("methods", [*EVALUATE, "--methods", "nmf,swaps"], "'swaps'|did you mean 'sweeps'"),
    case("empty methods", [*EVALUATE, "--methods", ""], "unknown method ''|known are"),
    case("methods count", [*EVALUATE, "--methods", "nmf:abc"], "'nmf:abc'|nmf:10"),
    case("methods no count", [*EVALUATE, "--methods", "nmf:"], "'nmf:'|nmf:10"),
    case("evaluate -1", [*EVALUATE, "--methods", "nmf", "--iterations", "-1"], "iterations|0"),
    case("evaluate bits", [*EVALUATE, "--methods", "nmf", "--bits", "1"], "1 bits|8 or 16"),
    case(
        "methods of other displays",
        [*EVALUATE, "--display", "multiplicative-3", "--methods", "sweeps,sart"],
        "'sart' serves additive|'multiplicative-3' is multiplicative",
    ),
    case("display twice", [*EVALUATE, "--display", "additive-3", "--methods", "nmf"], "2 displays"),
    case("field twice", [*EVALUATE, "views", "--methods", "nmf"], "2 light fields"),
    case("second field", [*EVALUATE, "none", "--methods", "nmf"], "no file or folder none"),
    case("other grid", [*EVALUATE, "--methods", "nmf", "--views", "3x3"], "3x3|expects 5x5"),
]

EYES = [
    case(f"eye at {eye!r}", [*SIMULATE, "--eye", eye], f"eye is '{eye}'|X,Y,Z", result)
    for eye in ("left", "", "1", "1,", "1,2,3,4", "nan,0", "0,inf", "1e99,0", "0;1")
] + [
    case("an eye behind", [*SIMULATE, "--eye", "0,0,-100"], "-100 px|behind|more than 1", result),
    case("an eye in a layer", [*SIMULATE, "--eye", "0,0,1"], "1 px|at or behind", result),
    case(
        "an eye in a layer at 12 mm",
        [*SIMULATE, "--eye", "0,0", "--eye", "0,0,12", "--display", "perspective-3"],
        "12 mm|at or behind the front layer|more than 12",
        result,
    ),
    case(
        "an eye without a distance",
        [*SIMULATE, "--eye", "0,0", "--display", "d.toml"],
        "parallel|X,Y,Z",
        result_with("../d.toml", DEEP.replace("= 500", "= inf")),
    ),
]

DISTANCES = [
    apart("distance missing", "32, 0, 560", "32, 0", "'viewpoints_mm"),
    apart("distance of a word", "560", '"far"', "'viewpoints_mm"),
    apart("distance infinite", "560", "inf", "'viewpoints_mm"),
    apart("a negative distance", "560", "-560", "-560 mm|at or behind|12 mm"),
    apart("an eye in the layers", "560", "12", "12 mm|at or behind"),
    apart("two distances", "pitch", "viewing_distance_mm = 5\npitch", "leave out either"),
    apart("no distances", ", 0, 5", ", 5", "'viewing_distance_mm' is missing"),
    case("not two views", OWN, "25 views|expects 2", put("d.toml", APART)),
    case(
        "a method for one distance",
        [*OWN, "--method", "nmf"],
        "'nmf' needs viewpoints at one distance|fourier-admm",
        put("d.toml", APART),
    ),
    case(
        "eye of no distance",
        [*SIMULATE, "--eye", "0,0", "--display", "d.toml"],
        "different distances|X,Y,Z",
        result_with("../d.toml", APART),
    ),
]
JUDGE = [*EVALUATE, "--methods", "nmf"]
LISTED = 'link = "additive"\ndisparity = [1, 0]\nviewpoints = [[0, 0], [1, 0]]\n'
BETWEEN = [
    case("nothing between", [*JUDGE, "--between"], "'views' has no views between|--step 2"),
    case("nothing around", [*JUDGE, "--eye-map", "m.png"], "no views in or around|--views"),
    case("no targets", [*SYNTH, "--targets-between", "given"], "no views between|--step 2"),
    case("odd targets", [*SYNTH, "--targets-between", "gven"], "'gven'|given or interpolated"),
    case("odd weight", [*SYNTH, "--targets-between", "given:x"], "'given:x'|given:0.25"),
    case(
        "between a list",
        [*EVALUATE[:2], "--display", "l.toml", "--methods", "nmf", "--between"],
        "are a list|--between",
        put("l.toml", LISTED),
    ),
    case(
        "targets between a list",
        [*SYNTH, "--display", "l.toml", "--targets-between", "interpolated"],
        "are a list|--targets-between",
        put("l.toml", LISTED),
    ),
    case(
        "map among the views",
        [*JUDGE, "--eye-map", "views/m.png"],
        "views/m.png|among the input",
    ),
]

OUTPUTS = [
    case("out exists", SYNTH, "out exists|force", lambda d: (d / "out").mkdir()),
    case("out is a file", [*SYNTH, "--force"], "out|it is a file", put("out", "mine")),
    case(
        "out is not ours",
        [*SYNTH, "--force"],
        "out|was not made here|another name",
        lambda d: ((d / "out").mkdir(), put("out/display.toml", FLAT)(d)),
    ),
    case("out dangles", SYNTH, "cannot write out", lambda d: (d / "out").symlink_to("nowhere")),
    case("out has no folder", [*SYNTH[:-1], "no/out"], "no/out|no does not exist"),
    case("out under a file", [*SYNTH[:-1], "f/out"], "f/out|f is not a folder", put("f", "")),
    case("out cannot be written", [*SYNTH[:-1], "/proc/out"], "cannot write /proc/out|no such"),
    case("out has no name", [*SYNTH[:-1], "."], "no name of its own"),
    case("out is nothing", [*SYNTH[:-1], ""], "no name of its own"),
    case("out is above", [*SYNTH[:-1], "..", "--force"], "no name of its own"),
    case("out is too long", [*SYNTH[:-1], "x" * 300], "file name too long"),
    case("out is the field", [*SYNTH[:-1], "views", "--force"], "views"),
    case(
        "out holds the field",
        ["synth", "out/views", *SYNTH[2:], "--force"],
        "out|holds|the input out/views|another name",
        result_among_views,
    ),
    case(
        "out holds the display",
        ["synth", "views", "--display", "r/display.toml", "--out", "r", "--force"],
        "the input r/display.toml",
        result,
    ),
    case(
        "out is the result that is read",
        ["simulate", "r", "--out", "r", "--force"],
        "r is|the input r|another name",
        result,
    ),
    case("simulate out exists", SIMULATE, "out exists", lambda d: (result(d), (d / "out").mkdir())),
    case("demo out exists", "demo", "demo exists|force", lambda d: (d / "demo").mkdir()),
    case("demo has no folder", "demo --out no/demo", "no does not exist"),
    case("json exists", [*EVALUATE, "--methods", "nmf"], "out exists|force", put("out", "mine")),
    case(
        "json is a folder",
        [*EVALUATE, "--methods", "nmf", "--force"],
        "out|it is a folder",
        lambda d: (d / "out").mkdir(),
    ),
    case("json unwritable", [*EVALUATE[:-1], "no/j", "--methods", "nmf"], "no does not exist"),
    case(
        "json is the field",
        ["evaluate", "f.npy", *EVALUATE[2:-1], "f.npy", "--methods", "nmf", "--force"],
        "the input f.npy",
        save("f.npy", with_nan(0)),
    ),
    case(
        "json is a view",
        [*EVALUATE[:-1], "views/view_00_00.png", "--methods", "nmf", "--force"],
        "among the input views",
    ),
    case("sheet exists", "info views", "views-views.png exists", put("views-views.png", "mine")),
    case("sheet is a folder", "info views --contact-sheet views --force", "views"),
    case("sheet unwritable", "info views --contact-sheet no/x.png", "no does not exist"),
    case(
        "sheet is a view",
        "info views --contact-sheet views/view_00_00.png --force",
        "among the input views|another name",
    ),
    case("sheet among the views", "info views --contact-sheet views/x.png", "among the input"),
    case("info of nothing", "info none", "no file or folder none"),
    case("info of a bad picture", "info views", "truncated", truncate),
]


@pytest.mark.parametrize(
    ("prepare", "args", "words"),
    [*FIELDS, *DISPLAYS, *OPTIONS, *EYES, *DISTANCES, *BETWEEN, *OUTPUTS],
)
def test_one_line_and_no_traces(desk, prepare, args, words):
    prepare(desk)
    before = contents(desk)
    found = run(*args)
    assert contents(desk) == before
    fails(found, *words)


def test_no_command(desk):
    found = run()
    assert found.status == 2
    assert "Usage" in found.out
    fails(found._replace(out=""), "layerfield --help")


def test_cuda_where_there_is_none(desk, monkeypatch):
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    fails(run(*SYNTH, "--device", "cuda"), "no CUDA device", "--device cpu")


@pytest.mark.parametrize(
    "args",
    [
        [*SYNTH, "--bits", "7"],
        [*SYNTH, "--rounding", "up"],
        [*SYNTH, "--method", "magic"],
        [*SYNTH, "--display", "magic"],
        [*SYNTH, "--targets-between", "magic"],
        [*SYNTH, "--iterations", "-1"],
        [*SYNTH[:-1], "views"],
        ["evaluate", "views", "--display", "multiplicative-3", "--methods", "sweeps,nmf"],
        ["info", "views", "--contact-sheet", "views"],
    ],
)
def test_nothing_is_read_before_the_options_are_good(desk, monkeypatch, args):
    for room in ("info", "fields"):
        name = f"layerfield.cli.{room}.load_light_field"
        monkeypatch.setattr(name, lambda *_: pytest.fail("was read"))
    fails(run(*args))


# ----------------------------------------------------------------------- full disks, interrupts


def no_space(*_, **__):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def failing(target: str) -> Callable:
    """Return a Path method that works until it comes to a file of this name."""
    method = Path.write_bytes if target.endswith("png") else Path.write_text

    def write(self: Path, *args, **options):
        return no_space() if self.name == target else method(self, *args, **options)

    return write


@pytest.mark.parametrize("target", ["layer_2.png", "display.toml", "result.json", "view_04_04.png"])
@pytest.mark.parametrize("earlier", [False, True])
def test_a_full_disk(desk, monkeypatch, target, earlier):
    if earlier:
        succeed(*SYNTH)
    before = contents(desk)
    name = "write_bytes" if target.endswith("png") else "write_text"
    monkeypatch.setattr(Path, name, failing(target))
    fails(run(*SYNTH, "--simulate", "--force"), "cannot write", "No space left")
    assert contents(desk) == before


@pytest.mark.parametrize(
    ("target", "args"),
    [
        ("numpy.save", ["simulate", "r", "--out", "out", "--array"]),
        ("PIL.Image.Image.save", ["info", "views"]),
        ("pathlib.Path.mkdir", SYNTH),
        ("pathlib.Path.rename", SYNTH),
        ("pathlib.Path.touch", ["info", "views"]),
        ("pathlib.Path.replace", ["info", "views"]),
    ],
)
def test_a_full_disk_elsewhere(desk, monkeypatch, target, args):
    result(desk)
    before = contents(desk)
    monkeypatch.setattr(target, no_space)
    found = run(*args)
    monkeypatch.undo()
    fails(found, "cannot write", "No space left")
    assert contents(desk) == before


def test_a_real_limit_of_the_system(desk):
    """Files end after 1000 bytes, in a process of its own."""
    before = contents(desk)
    limit = partial(resource.setrlimit, resource.RLIMIT_FSIZE, (1000, 1000))
    found = finish(start(COMMAND, *SYNTH, preexec_fn=limit))
    fails(found, "cannot write", "out", "File too large")
    assert contents(desk) == before


@pytest.mark.parametrize(
    "error", [MemoryError(), RuntimeError("DefaultCPUAllocator: can't allocate memory: 99 bytes")]
)
def test_out_of_memory(desk, monkeypatch, error):
    def synthesize(*_, **__):
        raise error

    monkeypatch.setattr("layerfield.cli.synth.synthesize", synthesize)
    fails(run(*SYNTH), "out of memory", "--crop")


def test_unforeseen_errors_are_not_hidden(desk, monkeypatch):
    monkeypatch.setattr("layerfield.cli.synth.synthesize", lambda *_, **__: {}["key"])
    with pytest.raises(KeyError):
        run(*SYNTH)
    assert not (desk / "out").exists()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_an_interrupt_while_it_computes(desk, monkeypatch, number):
    before, handler = contents(desk), signal.getsignal(number)
    monkeypatch.setattr(
        "layerfield.cli.synth.synthesize", lambda *_, **__: os.kill(os.getpid(), number)
    )
    signal.signal(number, signal.SIG_DFL)  # the tests themselves may run under nohup
    try:
        fails(run(*SYNTH), "interrupted", "nothing is half-written")
    finally:
        signal.signal(number, handler)
    assert contents(desk) == before


def test_what_nohup_ignores_stays_ignored(desk):
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        assert run("methods").status == 0
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


SLOWLY = """
import pathlib, time, layerfield.result as result
write = result.write_png
def slowly(path, pixels):
    write(path, pixels)
    time.sleep(60)
result.write_png = slowly
from layerfield.cli import main
main()
"""


def wait_for(desk: Path, pattern: str, process: subprocess.Popen) -> None:
    for _ in range(600):
        if process.poll() is not None or list(desk.glob(pattern)):
            break
        time.sleep(0.05)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_while_it_writes(desk, number):
    """Half of a new result is there, the earlier one is kept."""
    succeed(*SYNTH)
    before = contents(desk)
    process = start(sys.executable, "-c", SLOWLY, *SYNTH, "--force")
    wait_for(desk, ".out-*/layers/layer_0.png", process)
    assert list(desk.glob(".out-*"))
    process.send_signal(number)
    time.sleep(0.02)
    process.send_signal(number)  # impatience
    fails(finish(process), "interrupted")
    assert contents(desk) == before


def test_ctrl_c_is_answered_by_one_process_only():
    """Also by the first that is started, with which Python starts one more."""
    script = """
import signal
from layerfield.own_process import in_own_process
print(in_own_process(signal.pthread_sigmask, signal.SIG_BLOCK, []) == {signal.SIGINT})
"""
    said = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True)
    assert said.stdout == b"True\n"


def test_ctrl_c_reaches_the_processes_of_evaluate(desk):
    before = contents(desk)
    methods = ["--methods", "nmf:100000000"]
    process = start(
        COMMAND, "evaluate", "views", "--display", "additive-3", *methods, "--json", "j"
    )
    wait_for(desk, ".j-*", process)
    time.sleep(4)  # the process beneath has begun
    os.killpg(process.pid, signal.SIGINT)
    fails(finish(process), "interrupted")
    assert contents(desk) == before


# ------------------------------------------------------------------------- where output goes to


@pytest.mark.parametrize("call", ["methods", "--help"])
def test_a_closed_pipe(desk, call):
    """As in `layerfield methods | head -0`."""
    reading, writing = os.pipe()
    os.close(reading)
    process = start(COMMAND, call, stdout=writing)
    os.close(writing)
    _, err = process.communicate(timeout=60)
    assert err == ""


@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_a_full_standard_output(desk, monkeypatch, unbuffered):
    monkeypatch.setenv("PYTHONUNBUFFERED", unbuffered)
    with Path("/dev/full").open("w") as full:
        process = start(COMMAND, "methods", stdout=full)
        _, err = process.communicate(timeout=60)
    fails(Outcome(process.returncode, "", err), "No space left")


def test_names_that_cannot_be_printed(desk):
    """Bytes that are no UTF-8, on a terminal that knows ASCII only."""
    command = f"PYTHONIOENCODING=ascii {COMMAND} {' '.join(SYNTH[:-1])} $'\\xff ö'"
    found = finish(start("bash", "-c", command))
    assert (found.status, found.err) == (0, "")
    assert "layers, 8 bit, are in \\udcff \\xf6/layers" in found.out


def test_the_installed_command_fails_alike(desk):
    before = contents(desk)
    found = finish(start(COMMAND, *SYNTH, "--display", "addtive-3"))
    fails(found, "unknown display 'addtive-3'; did you mean 'additive-3'?")
    assert contents(desk) == before


def test_a_perfect_reproduction(desk):
    write_views(desk / "black", change=lambda view: 0 * view)
    args = ["--display", "additive-3", "--out", "out", "--reference"]
    assert "exact" in succeed("synth", "black", *args)
    facts = json.loads((desk / "out/result.json").read_text(), parse_constant=pytest.fail)
    assert facts["psnr"] is None
    assert facts["excess"] == 0
    assert facts["psnr_view_std"] in (None, 0)
