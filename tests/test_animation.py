"""What a moving eye sees: its path, the frames, and the files that hold them."""

import itertools
import json
import math
import tomllib
from pathlib import Path

import av
import numpy as np
import pytest
import torch
from PIL import Image, ImageSequence
from test_cli import contents, fails, run, succeed

from layerfield import Display, procedural_light_field, synthesize
from layerfield.animation import PATHS, Animation, Sweep, animate
from layerfield.display_spec import parse_spec
from layerfield.io import write_animation
from layerfield.io.animated import KINDS
from layerfield.io.frames import durations
from layerfield.panels import quantise

TWO_EYES = """link = "additive"\ndepth_mm = [12, 0, -12]\npitch_um = 400
viewpoints_mm = [[-32, 1, 500], [30, 1, 560]]\n"""
ROW = 'link = "additive"\ndisparity = [1, 0]\nviews = [1, 3]\n'
COLUMN = 'link = "additive"\ndisparity = [1, 0]\nviews = [3, 1]\n'
ALONE = 'link = "additive"\ndisparity = [1, 0]\nviews = [1, 1]\n'
LIST = 'link = "additive"\ndisparity = [1, 0]\nviewpoints = [[-1, 2], [3, 0], [0, 1]]\n'


def display_of(text: str) -> Display:
    return Display(parse_spec(text, "here"))


def layers_for(display: Display, size=(9, 14), channels=3) -> torch.Tensor:
    torch.manual_seed(0)
    y, x = (n + 2 * m for n, m in zip(size, display.margin, strict=True))
    return torch.rand(display.subframes, display.layer_count, channels, y, x)


class Still:
    """So many frames of one size, a gradient that moves unless told not to."""

    def __init__(self, count=7, size=(16, 24), channels=3, moves=True):
        self.count, self.size, self.channels, self.moves = count, size, channels, moves

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, index: int) -> torch.Tensor:
        y, x = torch.meshgrid(*map(torch.arange, self.size), indexing="ij")
        phase = 2 * math.pi * index / self.count * self.moves
        waves = [torch.sin(x / 7 + phase), torch.cos(y / 9 - phase), torch.sin((x + y) / 8)]
        return (127.5 + 120 * torch.stack(waves[: self.channels])).round().to(torch.uint8)


# ------------------------------------------------------------------------------- path and frames


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("display", ["additive-3", "perspective-3"])
def test_the_eye_stays_within_the_viewpoints_and_comes_back(path, display):
    geometry = Display.load(display).geometry
    sweep = Sweep(path, seconds=2, fps=20)
    slopes = np.array(sweep.slopes(geometry))
    assert slopes.shape == (sweep.frame_count, 2) == (40, 2)
    low, high = np.min(geometry.slopes, 0), np.max(geometry.slopes, 0)
    used = slice(None) if path == "circle" else slice(1)
    np.testing.assert_allclose(slopes.min(0)[used], low[used], rtol=1e-9)
    np.testing.assert_allclose(slopes.max(0)[used], high[used], rtol=1e-9)
    np.testing.assert_allclose(slopes[0], [low[0], 0], atol=1e-12)
    np.testing.assert_allclose(slopes[20], [high[0], 0], atol=1e-12)
    inside = np.sum((slopes / high) ** 2, 1)
    assert np.all(inside <= 1 + 1e-9)
    if path == "circle":
        np.testing.assert_allclose(inside, 1)
        assert slopes[10][1] == low[1]  # the top comes after the left
    else:
        assert not slopes[:, 1].any()


@pytest.mark.parametrize("path", PATHS)
def test_the_loop_has_no_seam(path):
    """Steps are as smooth from the last frame to the first as anywhere, and none is repeated."""
    slopes = np.array(Sweep(path, 1, 30).slopes(Display.load("additive-3").geometry))
    around = np.concatenate([slopes, slopes[:3]])
    steps, bends = (np.linalg.norm(np.diff(around, n, axis=0), axis=1) for n in (1, 2))
    assert steps.min() > 0
    assert steps.max() < 2 * 2 * math.pi / 30 * 1.01
    assert bends.max() < 2 * (2 * math.pi / 30) ** 2 * 1.01


def test_slow_at_both_ends():
    x = np.array(Sweep("horizontal", 1, 40).slopes(Display.load("additive-3").geometry))[:, 0]
    speed = np.abs(np.diff(x))
    assert speed[0] == pytest.approx(speed[19]) == pytest.approx(speed[20])
    assert speed[0] < 0.1 * speed[9]


@pytest.mark.parametrize(
    ("text", "path", "low", "high"),
    [
        (LIST, "horizontal", (-1, 1), (3, 1)),
        (LIST, "circle", (-1, 0), (3, 2)),
        (ROW, "circle", (-1, 0), (1, 0)),
        (COLUMN, "circle", (0, -1), (0, 1)),
    ],
)
def test_range_of_the_viewpoints(text, path, low, high):
    slopes = Sweep(path, 1, 40).slopes(display_of(text).geometry)
    np.testing.assert_allclose(np.min(slopes, 0), low, atol=1e-12)
    np.testing.assert_allclose(np.max(slopes, 0), high, atol=1e-12)


@pytest.mark.parametrize("transfer", ['"none"', '"srgb"', "{ gamma = 2.2 }"])
def test_frames_are_what_the_eye_sees(transfer):
    display = display_of(
        f'link = "multiplicative"\ndisparity = [1.3, 0]\nviews = [3, 5]\ntransfer = {transfer}\n'
    )
    layers = layers_for(display)
    sweep = Sweep("circle", 1, 8)
    frames = animate(layers, display, sweep)
    assert len(frames) == 8
    for i, slope in enumerate(sweep.slopes(display.geometry)):
        seen = display.transfer.encode(display.look(layers, slope)).clamp(0, 1)
        assert torch.equal(frames[i], (255 * seen).round().to(torch.uint8))
    assert torch.equal(frames[0], quantise(display.transfer.encode(display(layers)[5]), 8))


def test_bright_sums_are_clipped():
    display = Display.load("additive-3")
    frames = animate(torch.ones_like(layers_for(display)), display, Sweep(seconds=1, fps=2))
    assert torch.equal(frames[1], torch.full_like(frames[1], 255))


def test_eyes_at_different_distances():
    """Between them, where the mean of 1/Z is."""
    display = display_of(TWO_EYES)
    layers = layers_for(display)
    frames = animate(layers, display, Sweep("horizontal", 1, 4))
    far = 2 / (1 / 0.5 + 1 / 0.56)
    x, y = (-32 / 500 + 30 / 560) / 2, (1 / 500 + 1 / 560) / 2
    assert torch.equal(frames[1], quantise(display.look(layers, (x, y), far), 8))


@pytest.mark.parametrize(("width", "size"), [(None, (9, 14)), (7, (4, 7)), (1, (1, 1))])
def test_width(width, size):
    display = Display.load("additive-3")
    layers = torch.full_like(layers_for(display), 0.25)
    frame = animate(layers, display, Sweep(), width)[0]
    assert frame.shape == (3, *size)
    assert torch.equal(frame, torch.full_like(frame, round(0.75 * 255)))


def test_smaller_frames_are_not_aliased():
    display = display_of('link = "additive"\ndisparity = [0]\nviews = [1, 3]\n')
    stripes = torch.zeros(1, 1, 1, 32, 64)
    stripes[..., ::2] = 1
    frame = animate(stripes, display, Sweep(), 20)[0][..., 3:-3]
    assert frame.float().std() < 4


# ------------------------------------------------------------------------------------------ files


def decoded(path: Path) -> tuple[np.ndarray, list[float]]:
    """Return the frames of a file, `[frame, y, x, 3]`, and when each ends, in seconds."""
    if path.suffix == ".mp4":
        with av.open(str(path)) as container:
            stream = container.streams.video[0]
            frames = list(container.decode(stream))
            rate = stream.average_rate
            assert rate is not None
        ends = [(i + 1) / float(rate) for i in range(len(frames))]
        assert [frame.time for frame in frames] == pytest.approx([0, *ends[:-1]])
        return np.stack([frame.to_ndarray(format="rgb24") for frame in frames]), ends
    with Image.open(path) as image:
        stills = [
            (np.asarray(frame.convert("RGB")), frame.info["duration"])
            for frame in ImageSequence.Iterator(image)
        ]
    ends = [ms / 1000 for ms in itertools.accumulate(ms for _, ms in stills)]
    return np.stack([still for still, _ in stills]), ends


def as_pixels(frames) -> np.ndarray:
    stack = np.stack([frames[i].expand(3, -1, -1).numpy() for i in range(len(frames))])
    return np.moveaxis(stack, 1, -1)


def decibels(found: np.ndarray, expected: np.ndarray) -> float:
    error = np.mean((found.astype(float) - expected) ** 2) / 255**2
    return -10 * np.log10(max(error, 1e-9))


@pytest.fixture(scope="module")
def textured() -> Animation:
    """Layers of a procedural scene, with an eye that circles."""
    display = Display.load("additive-3")
    layers = synthesize(procedural_light_field(size=(72, 96)), display).layers
    return animate(layers, display, Sweep("circle", 0.5, 30))


@pytest.mark.parametrize("suffix", KINDS)
def test_files_hold_the_frames(tmp_path, textured, suffix):
    path = tmp_path / f"a{suffix}"
    write_animation(path, textured, 30)
    found, ends = decoded(path)
    assert found.shape == (15, 72, 96, 3)
    assert decibels(found, as_pixels(textured)) > 36
    tick = {".gif": 0.01, ".webp": 0.001, ".mp4": 1e-9}[suffix]
    assert ends == pytest.approx([(i + 1) / 30 for i in range(15)], abs=0.51 * tick)
    assert ends[-1] == pytest.approx(0.5)


@pytest.mark.parametrize("suffix", KINDS)
@pytest.mark.parametrize("size", [(1, 1), (1, 2), (15, 24), (16, 23), (17, 33)])
@pytest.mark.parametrize("channels", [1, 3])
def test_odd_sizes(tmp_path, suffix, size, channels):
    frames = Still(size=size, channels=channels)
    write_animation(tmp_path / f"a{suffix}", frames, 25)
    found, _ = decoded(tmp_path / f"a{suffix}")
    height, width = size
    if suffix == ".mp4":
        assert found.shape[1:3] == (height + height % 2, width + width % 2)
    else:
        assert found.shape[1:3] == size
    assert decibels(found[:, :height, :width], as_pixels(frames)) > 28


@pytest.mark.parametrize("suffix", KINDS)
def test_frames_that_are_alike_are_kept(tmp_path, suffix):
    write_animation(tmp_path / f"a{suffix}", Still(moves=False), 10)
    found, ends = decoded(tmp_path / f"a{suffix}")
    assert len(found) == 7
    assert ends[-1] == pytest.approx(0.7)


@pytest.mark.parametrize("suffix", [".gif", ".webp"])
def test_pictures_play_for_ever(tmp_path, suffix):
    write_animation(tmp_path / f"a{suffix}", Still(), 10)
    with Image.open(tmp_path / f"a{suffix}") as image:
        assert image.info["loop"] == 0


@pytest.mark.parametrize("colours", [1, 3])
def test_a_gif_of_few_colours(tmp_path, colours):
    """All codes but one have a colour of their own; none is shown in the one for no change."""
    flat = torch.tensor([[0, 0, 0], [255, 255, 255], [200, 30, 30]], dtype=torch.uint8)
    frames = [flat[[i % colours, (i + 1) % colours]].T[:, None] for i in range(4)]
    write_animation(tmp_path / "a.gif", frames, 10)
    found, _ = decoded(tmp_path / "a.gif")
    assert np.abs(found.astype(int) - as_pixels(frames)).max() <= 2


def test_the_video_says_what_its_colours_are(tmp_path):
    write_animation(tmp_path / "a.mp4", Still(), 29.97)
    with av.open(str(tmp_path / "a.mp4")) as container:
        stream = container.streams.video[0]
        context = stream.codec_context
        assert (context.name, context.pix_fmt) == ("h264", "yuv420p")
        assert (context.color_primaries, context.color_trc, context.colorspace) == (1, 1, 1)
        assert context.color_range == 1
        assert float(stream.average_rate or 0) == pytest.approx(29.97)
    data = (tmp_path / "a.mp4").read_bytes()
    assert data.index(b"moov") < data.index(b"mdat")  # plays before all of it has come


@pytest.mark.parametrize("suffix", KINDS)
def test_frames_are_asked_for_one_by_one(tmp_path, suffix):
    told = []
    write_animation(tmp_path / f"a{suffix}", Still(), 10, lambda what, n: told.append((what, n)))
    assert [n for _, n in told if n][-7:] == list(range(1, 8))
    assert {what for what, _ in told} == {"frames"}


@pytest.mark.parametrize("fps", [1, 7, 24, 29.97, 30, 50])
@pytest.mark.parametrize("ticks", [100, 1000])
def test_durations_do_not_drift(fps, ticks):
    found = durations(200, fps, ticks)
    assert np.cumsum(found) == pytest.approx(ticks * np.arange(1, 201) / fps, abs=0.51)
    assert min(found) >= 2


# ------------------------------------------------------------------------------- the command line


@pytest.fixture
def result(tmp_path, monkeypatch) -> Path:
    """A working folder that holds a result, `r`."""
    monkeypatch.chdir(tmp_path)
    made = tmp_path / "r"
    (made / "layers").mkdir(parents=True)
    for k, layer in enumerate(as_pixels(Still(3, (20, 28))) // 3):
        Image.fromarray(layer).save(made / f"layers/layer_{k}.png")
    (made / "display.toml").write_text('link = "additive"\ndisparity = [1, 0, -1]\nviews = [5, 5]')
    (made / "result.json").write_text(json.dumps({"margin": [2, 2]}))
    return tmp_path


SHORT = ("--seconds", "0.5", "--fps", "8")


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("suffix", KINDS)
def test_simulate_makes_a_video(result, path, suffix):
    said = succeed("simulate", "r", "--sweep", path, "--video", f"v{suffix}", *SHORT)
    assert said == f"4 frames are in v{suffix}\n"
    found, ends = decoded(result / f"v{suffix}")
    assert found.shape == (4, 16, 24, 3)
    assert ends[-1] == pytest.approx(0.5)
    assert sorted(entry.name for entry in result.iterdir()) == ["r", f"v{suffix}"]


def test_horizontal_if_not_said_and_views_beside(result):
    succeed("simulate", "r", "--sweep", "horizontal", "--video", "a.webp", *SHORT)
    said = succeed("simulate", "r", "--video", "B.WEBP", "--out", "seen", *SHORT)
    assert said == f"25 views are in {Path('seen/views')}\n4 frames are in B.WEBP\n"
    assert (result / "a.webp").read_bytes() == (result / "B.WEBP").read_bytes()
    assert len(list((result / "seen/views").iterdir())) == 25
    found, _ = decoded(result / "a.webp")
    view = np.asarray(Image.open(result / "seen/views/view_02_00.png"))
    assert decibels(found[0], view) > 30


def test_smaller_videos_and_force(result):
    for force in ([], ["--force"]):
        succeed("simulate", "r", "--video", "v.gif", "--width", "12", *SHORT, *force)
        assert decoded(result / "v.gif")[0].shape == (4, 8, 12, 3)


VIDEO = ["simulate", "r", "--video", "v.gif"]


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["simulate", "r"], ["nothing to make", "--out", "--video"]),
        (["simulate", "r", "--sweep", "circle"], ["--sweep", "--video"]),
        (["simulate", "r", "--out", "o", "--fps", "9"], ["--fps", "--video"]),
        (["simulate", "r", "--out", "o", "--width", "9"], ["--width", "--video"]),
        ([*VIDEO, "--eye", "0,0"], ["--eye", "--out"]),
        ([*VIDEO, "--array"], ["--array", "--out"]),
        ([*VIDEO, "--sweep", "horizontl"], ["unknown sweep", "did you mean 'horizontal'"]),
        ([*VIDEO, "--sweep", "up"], ["known are circle, horizontal"]),
        (["simulate", "r", "--video", "v.mov"], ["v.mov", ".mp4"]),
        (["simulate", "r", "--video", "v.avi"], ["v.avi", ".gif, .mp4, .webp"]),
        (["simulate", "r", "--video", "v"], ["known are .gif, .mp4, .webp"]),
        ([*VIDEO, "--fps", "0"], ["frames a second are 0", "above 0"]),
        ([*VIDEO, "--fps", "-3", "--seconds", "-3"], ["seconds are -3", "above 0"]),
        ([*VIDEO, "--fps", "nan"], ["frames a second are nan"]),
        ([*VIDEO, "--seconds", "inf"], ["seconds are inf"]),
        ([*VIDEO, "--seconds", "1e300"], ["frames, expected 2 to 10000"]),
        ([*VIDEO, "--seconds", "0.01"], ["0.3 frames, expected 2 to 10000"]),
        ([*VIDEO, "--fps", "60"], ["60 frames a second", "1 to 50 in a .gif"]),
        ([*VIDEO, "--fps", "0.5"], ["0.5 frames a second", "1 to 50"]),
        ([*VIDEO, "--width", "25"], ["25 px", "1 to 24"]),
        ([*VIDEO, "--width", "0"], ["0 px", "1 to 24"]),
        ([*VIDEO, "--margin", "10"], ["margin of 10x10"]),
        (["simulate", "r", "--video", "no/v.gif"], ["no does not exist"]),
        (["simulate", "r", "--video", "r/v.webp"], ["among the input r"]),
        (["simulate", "r", "--video", "r/layers/v.webp"], ["among the input"]),
        (["simulate", "r", "--video", "o/v.gif", "--out", "o"], ["o/v.gif lies in o"]),
        (["simulate", "none", "--video", "v.gif"], ["no folder none"]),
        ([*VIDEO, "--out", "r", "--force"], ["the input r"]),
    ],
)
def test_one_line_and_no_traces(result, args, words):
    before = contents(result)
    fails(run(*args), *words)
    assert contents(result) == before


@pytest.mark.parametrize(
    ("text", "path", "words"),
    [
        (COLUMN, "horizontal", ["lie above each other", "circle"]),
        (ALONE, "horizontal", ["at one place"]),
        (ALONE, "circle", ["at one place"]),
    ],
)
def test_displays_without_room_to_move(result, text, path, words):
    (result / "d.toml").write_text(text.replace("[1, 0]", "[1, 0, -1]"))
    fails(run(*VIDEO, "--sweep", path, "--display", "d.toml", "--margin", "2"), *words)
    assert not (result / "v.gif").exists()


def test_an_existing_file_is_kept(result):
    (result / "v.gif").write_text("mine")
    fails(run(*VIDEO), "v.gif exists")
    (result / "v.gif").unlink()
    (result / "v.gif").mkdir()
    fails(run(*VIDEO, "--force"), "it is a folder")


def test_frames_too_large_for_the_kind(tmp_path):
    with pytest.raises(ValueError, match=r"16384x1 px, a \.webp holds at most 16383"):
        write_animation(tmp_path / "a.webp", Still(size=(1, 16384)), 10)


def test_without_pyav(result, monkeypatch):
    monkeypatch.setattr("layerfield.io.animated.find_spec", lambda name: None)
    fails(run("simulate", "r", "--video", "v.mp4"), "pip install 'layerfield[video]'")
    succeed("simulate", "r", "--video", "v.webp", *SHORT)
    extras = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text("utf-8"))
    assert "video" in extras["project"]["optional-dependencies"]


@pytest.mark.parametrize("suffix", KINDS)
@pytest.mark.parametrize("problem", [KeyboardInterrupt(), OSError(28, "No space left on device")])
def test_a_write_that_fails_leaves_nothing(result, monkeypatch, suffix, problem):
    before = contents(result)
    whole = Animation.__getitem__

    def fail(self, index):
        if index == 2:
            raise problem
        return whole(self, index)

    monkeypatch.setattr(Animation, "__getitem__", fail)
    found = run("simulate", "r", "--video", f"v{suffix}", "--out", "seen", *SHORT)
    assert found.status != 0
    assert found.out == ""
    assert contents(result) == before
