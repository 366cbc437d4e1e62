"""Videos of layers: whoever makes the batches, nothing is lost, and the layers are the same."""

import json
import os
import signal
import sys
import time
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import torch
from test_cli import contents, fails, finish, run, start, succeed

from layerfield import DisparitySpec, Display, FieldOptions, LightField, psnr, synthesize
from layerfield.display_spec import format_spec
from layerfield.frames.opening import open_frames
from layerfield.io import read_image, write_png
from layerfield.scenes import panned
from layerfield.stored_result import read_layers
from layerfield.stream import synthesize_frames
from layerfield.video.film import Film
from layerfield.video.forms import FORMS
from layerfield.video.making import read_figures

av = pytest.importorskip("av")
SIZE, COUNT = (16, 24), 48
GRID = (2, 3)
SPEC = DisparitySpec(name="few", link="additive", disparity=(1.0, 0.0, -1.0), views=GRID)
QUILT = ["--quilt", "3x2", "--grid", "2x3", "--display", "few.toml"]


@pytest.fixture(scope="module")
def views() -> torch.Tensor:
    """A slow pan, `[frame, view, c, y, x]`, bytes."""
    made = panned(Display(SPEC).geometry, (1, 0), COUNT, size=SIZE, seed=3)
    return made.clamp(0, 1).mul(255).round().to(torch.uint8)


def quilts(views: torch.Tensor) -> np.ndarray:
    """Pictures of 3x2 views, the bottom row first, `[frame, y, x, c]`."""
    rows = views.unflatten(1, GRID).flip(1)
    return rows.permute(0, 1, 4, 2, 5, 3).flatten(3, 4).flatten(1, 2).contiguous().numpy()


def write_film(path: Path, pictures: np.ndarray, codec: str = "ffv1", **options: str) -> Path:
    pixels = "bgr0" if codec == "ffv1" else "yuv420p"
    with av.open(str(path), "w", options={"movflags": "+faststart"}) as container:
        stream = container.add_stream(codec, rate=Fraction(30000, 1001), options=options)
        stream.height, stream.width = pictures.shape[1:3]
        stream.pix_fmt = pixels
        for picture in pictures:
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), "rgb24")
            container.mux(stream.encode(frame.reformat(format=pixels)))
        container.mux(stream.encode())
    return path


@pytest.fixture(scope="module")
def film(views, tmp_path_factory) -> Path:
    """A quilt video without losses, and the display it is for."""
    folder = tmp_path_factory.mktemp("film")
    (folder / "few.toml").write_text(format_spec(SPEC))
    return write_film(folder / "film.mkv", quilts(views), g="12")


@pytest.fixture(autouse=True)
def _here(film, monkeypatch, tmp_path):
    """An empty folder with the video and the display in it."""
    monkeypatch.chdir(tmp_path)
    for file in film.parent.iterdir():
        Path(file.name).symlink_to(file)


def pixels(path: Path, form: str = "rgb24") -> np.ndarray:
    with av.open(str(path)) as container:
        return np.stack([frame.to_ndarray(format=form) for frame in container.decode(video=0)])


def layers(folder: str | Path) -> np.ndarray:
    return np.stack([pixels(path) for path in sorted(Path(folder).glob("layers/*.mkv"))])


@pytest.fixture(scope="module")
def single(film, tmp_path_factory) -> Path:
    """What one run without Ray makes of it, in batches of ten."""
    folder = tmp_path_factory.mktemp("single")
    display = ["--display", str(film.parent / "few.toml")]
    succeed("video", film, *QUILT[:-2], *display, "--batch", "10", "--out", folder / "out")
    return folder / "out"


def test_frames_come_out_as_they_went_in(views):
    """Wherever one begins to read, whatever they are stored in."""
    whole = open_frames("film.mkv", FieldOptions.parse(quilt="3x2", grid="2x3"))
    assert (whole.count, whole.rate, whole.name) == (COUNT, Fraction(30000, 1001), "film.mkv")
    for first, stop in ((0, 5), (11, 14), (47, 48), (20, 20)):
        found = [field.stored for field in whole.read(first, stop)]
        assert len(found) == stop - first
        assert all(map(torch.equal, found, views[first:stop]))


@pytest.mark.parametrize(("codec", "name"), [("libx264", "a.mp4"), ("libvpx-vp9", "a.webm")])
def test_videos_with_losses_are_found_frame_by_frame(views, codec, name):
    """Frames that follow from others, before and after them."""
    large = np.repeat(np.repeat(quilts(views[:20]), 2, 1), 2, 2)
    write_film(Path(name), large, codec, g="7", crf="10")
    found = open_frames(name, FieldOptions.parse(quilt="3x2"))
    assert found.count == 20
    everything = [field.stored for field in found.read(0, 20)]
    assert (
        psnr(everything[3][4] / 255, torch.from_numpy(large[3][:32, 48:96]).movedim(-1, 0) / 255)
        > 25
    )
    for first in (1, 6, 8, 15, 19):
        (alone,) = found.read(first, first + 1)
        assert torch.equal(alone.stored, everything[first])


def as_frames(views: torch.Tensor, how: str) -> list[str]:
    """Write frames as folders, quilts or arrays; return what the command line says of them."""
    for number, frame in enumerate(views):
        if how == "folders":
            place = Path(f"in/frame_{number:04d}")
            place.mkdir(parents=True)
            for i, view in enumerate(frame):
                write_png(place / f"view_{i // 3:02d}_{i % 3:02d}.png", view)
        elif how == "arrays":
            Path("in").mkdir(exist_ok=True)
            np.save(f"in/{number}.npy", frame.unflatten(0, GRID).movedim(2, -1).numpy())
        else:
            picture = torch.from_numpy(quilts(frame[None])[0]).movedim(-1, 0)
            Path("in").mkdir(exist_ok=True)
            write_png(f"in/take_{number + 7}_qs3x2.png", picture)
    named = {"folders": ["in"], "arrays": ["in/%d.npy"], "quilts": ["in/take_*"]}[how]
    return named + (QUILT[2:] if how == "quilts" else QUILT[-2:])


@pytest.mark.parametrize("how", ["folders", "arrays", "quilts"])
def test_sequences_give_the_same_layers_as_the_video(views, single, how):
    said = succeed("video", *as_frames(views[:12], how), "--batch", "10", "--out", "out")
    assert said.startswith("12 frames by fast on few: ")
    assert (layers("out") == layers(single)[:, :12]).all()
    facts = json.loads(Path("out/video.json").read_text())
    assert (facts["fps"], facts["frames"]) == ("25", [0, 12])


def test_layers_are_those_of_synthesize_frames(views, single):
    """In the first batch, before any border."""
    fields = [LightField(frame, GRID) for frame in views[:10]]
    display = Display(SPEC)
    found = layers(single)
    assert found.shape == (3, COUNT, SIZE[0] + 2, SIZE[1] + 2, 3)
    for number, solution in enumerate(synthesize_frames(fields, display)):
        told = read_figures(single)[number]
        shown = torch.from_numpy(found[:, number]).movedim(-1, -3) / 255
        assert psnr(display(shown[None]), fields[number].views) == pytest.approx(
            told["psnr"], abs=1e-3
        )
        assert (shown - solution.layers[0]).abs().mean() < 1 / 255


def test_the_record_says_what_was_made(single):
    facts = json.loads((single / "video.json").read_text())
    assert facts["display"]["name"] == "few"
    assert (facts["method"], facts["iterations"], facts["batch"]) == ("fast", 3, 10)
    assert facts["options"] == {"grid": "2x3", "quilt": "3x2"}
    rows = read_figures(single)
    assert [row["frame"] for row in rows] == list(range(COUNT))
    assert {"psnr", "mean_square_error", "iterations", "seconds", "start"} <= set(rows[0])
    assert [row["start"] for row in rows[:2]] == ["cold", "moved"]
    assert {row["start"] for row in rows[1:]} == {"moved"}  # behind a run-in, at borders too
    assert sorted(p.name for p in single.iterdir()) == [
        "display.toml", "frames.jsonl", "layers", "video.json",
    ]  # fmt: skip


CODES = {
    (1, 8): torch.uint8, (3, 8): torch.uint8, (1, 16): torch.uint16, (3, 16): torch.uint16,
}  # fmt: skip


@pytest.mark.parametrize(("channels", "bits"), CODES)
def test_lossless_layers_come_out_bit_for_bit(channels, bits):
    """Through parts that are joined, noise that no codec can guess."""
    form = FORMS["ffv1"]
    assert isinstance(form, Film)
    largest = np.iinfo(f"uint{bits}").max
    noise = np.random.default_rng(1).integers(0, largest + 1, (7, channels, 13, 11), f"uint{bits}")
    for first, stop in ((0, 4), (4, 7)):
        writer = form.begin("layers/layer_0", first, Fraction(24))
        for number in range(first, stop):
            writer.add(number, torch.from_numpy(noise[number]))
        for name, data in writer.files().items():
            Path(name).parent.mkdir(parents=True, exist_ok=True)
            Path(name).write_bytes(data)
    form.join(Path(), ["layers/layer_0"], [0, 4], Fraction(24))
    stored = {1: "gray", 3: "rgb24"} if bits == 8 else {1: "gray16le", 3: "rgb48le"}
    found = pixels(Path("layers/layer_0.mkv"), stored[channels])
    assert (found.reshape(7, 13, 11, channels) == np.moveaxis(noise, 1, -1)).all()


@pytest.mark.parametrize("form", ["h264", "av1"])
def test_videos_with_losses_are_near_and_even(single, form):
    how = [*QUILT, "--frames", "0:20", "--batch", "10", "--format", form]
    succeed("video", "film.mkv", *how, "--out", "out")
    exact = layers(single)
    row = read_figures("out")[7]
    assert row["psnr_before_compression"] == pytest.approx(read_figures(single)[7]["psnr"], abs=1)
    assert "psnr" not in row
    for k in range(3):
        found = pixels(Path(f"out/layers/layer_{k}.mp4"))
        assert found.shape[0] == 20
        near = torch.from_numpy(found[:, : SIZE[0] + 2, : SIZE[1] + 2] / 255.0)
        assert psnr(near, torch.from_numpy(exact[k, :20] / 255.0)) > 27


def test_odd_sizes_are_made_even_and_it_is_said(views):
    np.save("odd.npy", views[0].unflatten(0, GRID)[..., :15, :].movedim(2, -1).numpy())
    how = ["--display", "few.toml", "--format", "h264", "--out", "out"]
    said = succeed("video", "od[d].npy", *how)
    assert "the layers are 26x17 px; h264 has even sizes only" in said
    assert pixels(Path("out/layers/layer_0.mp4")).shape == (1, 18, 26, 3)


def test_pictures_are_a_folder_for_each_frame(single):
    how = [*QUILT, "--frames", "8:14", "--batch", "10"]
    succeed("video", "film.mkv", *how, "--format", "png", "--bits", "16", "--out", "out")
    assert sorted(p.name for p in Path("out").glob("frame_*"))[::5] == [
        "frame_000008",
        "frame_000013",
    ]
    found = read_layers("out/frame_000012")
    others = torch.from_numpy(layers(single) / 255.0).movedim(-1, -3)
    assert (found[0][:, None] - others).square().mean(dim=(0, 2, 3, 4)).argmin() == 12
    succeed("video", "film.mkv", *how, "--out", "lossless")
    exact = torch.from_numpy(layers("lossless")[:, 4] / 255.0).movedim(-1, -3)
    assert (found[0] - exact).abs().max() < 0.05  # codes of eight bits make up for each other
    assert read_image("out/frame_000013/layers/layer_0.png").shape == (3, SIZE[0] + 2, SIZE[1] + 2)


def test_panels_and_subframes_are_tracks_of_their_own(views):
    Path("lab.toml").write_text(
        'name = "lab"\nlink = "multiplicative"\nsubframes = 2\ndepth_mm = [3, -3]\n'
        "pitch_um = 250\nviewing_distance_mm = 600\nviewing_angle_deg = 3\nviews = [2, 3]\n"
        + 2
        * "[[panels]]\nresolution = [40, 30]\npitch_um = 250\n"
    )
    as_frames(views[:2], "folders")
    succeed("video", "in", "--display", "lab.toml", "--method", "fourier-admm", "--out", "out")
    made = {str(p.relative_to("out")) for p in Path("out").rglob("*.mkv")}
    assert made == {
        f"{kind}s/subframe_{s}/{kind}_{k}.mkv"
        for kind in ("layer", "panel") for s in (0, 1) for k in (0, 1)
    }  # fmt: skip
    assert [row["iterations"] for row in read_figures("out")][1] == 3


KILLED = ["video", "film.mkv", *QUILT, "--batch", "10", "--out", "out"]


def killed(after: int) -> None:
    """Run until so many batches are done, and a little on; then kill the process."""
    process = start(sys.executable, "-m", "layerfield", *KILLED, *(["--resume"] if after else []))
    deadline = time.monotonic() + 60
    while len(list(Path().glob("out.unfinished/parts/*.jsonl"))) < after + 1:
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.002)
    time.sleep(0.01)
    os.killpg(process.pid, signal.SIGKILL)
    finish(process)


def test_a_run_that_is_killed_three_times_ends_as_one_that_was_not(single):
    """The layers byte for byte; no batch that was done is made again."""
    seen: dict[Path, int] = {}
    for after in range(3):
        killed(after)
        parts = {p: p.stat().st_mtime_ns for p in Path("out.unfinished/parts").glob("*.jsonl")}
        assert {p: parts[p] for p in seen} == seen
        assert len(parts) > len(seen)
        seen = parts
        assert not Path("out").exists()
    fails(run(*KILLED), "out.unfinished", "resume")
    assert succeed(*KILLED, "--resume").startswith("48 frames")
    same_but_for_times("out", single)
    before = contents(Path("out"))
    assert succeed(*KILLED, "--resume").startswith("48 frames")
    assert contents(Path("out")) == before
    fails(run(*KILLED, "--resume", "--bits", "16"), "exists")


def same_but_for_times(folder: str | Path, other: Path) -> None:
    """Assert that two videos are alike byte by byte but for the seconds that frames took."""
    found, expected = contents(Path(folder)), contents(other)
    for made in (found, expected):
        made.pop("frames.jsonl")
    assert found == expected
    told, known = (
        [{k: v for k, v in row.items() if k != "seconds"} for row in read_figures(place)]
        for place in (folder, other)
    )
    assert told == known


def test_a_kill_while_parts_are_joined_loses_nothing(single):
    """Whatever was joined, or thrown away, when it came."""
    succeed(*KILLED, "--frames", "0:20")
    work = Path("out").rename("out.unfinished")
    figures = (work / "frames.jsonl").read_bytes()
    (work / "parts").mkdir()  # all joined, but not yet in place
    succeed(*KILLED, "--frames", "0:20", "--resume")
    assert Path("out/frames.jsonl").read_bytes() == figures
    assert not Path("out/parts").exists()


@pytest.mark.parametrize("form", ["ffv1", "h264", "av1"])
def test_joined_videos_are_as_long_as_they_should_be(form):
    how = [*QUILT, "--frames", "0:9", "--batch", "4", "--fps", "24", "--format", form]
    succeed("video", "film.mkv", *how, "--out", "out")
    (path,) = Path("out/layers").glob("layer_1.*")
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        times = sorted(
            f.pts * stream.time_base for f in container.decode(stream) if f.pts is not None
        )
        assert stream.average_rate == 24
        assert np.allclose([float(t) for t in times], np.arange(9) / 24, atol=6e-4)


def test_a_video_cut_short_keeps_its_whole_batches(views):
    """And goes on when the rest is there."""
    whole = Path("film.mkv").read_bytes()
    Path("cut.mkv").write_bytes(whole[: len(whole) // 2])
    how = ["video", "cut.mkv", *QUILT, "--batch", "10", "--out", "out"]
    found = run(*how)
    fails(found, "cut short", "of its 48 frames", "20 of 48 frames are done", "--resume")
    Path("cut.mkv").write_bytes(whole)
    assert succeed(*how, "--resume").startswith("48 frames")
    Path("cut.mkv").write_bytes(whole[: len(whole) // 2])
    part = [*how[:-1], "part", "--frames", "0:15"]
    assert succeed(*part).startswith("15 frames")


def test_of_a_video_damaged_in_the_middle_it_is_said(views):
    data = bytearray(Path("film.mkv").read_bytes())
    data[len(data) // 2 : len(data) // 2 + 3000] = bytes(3000)
    Path("bad.mkv").write_bytes(data)
    (note,) = open_frames("bad.mkv", FieldOptions()).notes
    assert "bad.mkv shows no frames for a while, the longest 12 frames behind frame 23" in note
    assert open_frames("film.mkv", FieldOptions()).notes == ()


def with_sound(path: Path, pictures: np.ndarray) -> Path:
    with av.open(str(path), "w") as container:
        stream = container.add_stream("ffv1", rate=24, options={"g": "1"})
        sound = container.add_stream("pcm_s16le", rate=8000)
        stream.height, stream.width = pictures.shape[1:3]
        stream.pix_fmt = "bgr0"
        for picture in pictures:
            frame = av.VideoFrame.from_ndarray(picture, "rgb24")
            container.mux(stream.encode(frame.reformat(format="bgr0")))
        container.mux(stream.encode())
        silence = av.AudioFrame.from_ndarray(np.zeros((1, 16000), np.int16), "s16", "mono")
        silence.sample_rate = 8000
        container.mux(sound.encode(silence))
        container.mux(sound.encode())
    return path


def test_sound_is_left_out_and_it_is_said(views):
    with_sound(Path("loud.mkv"), quilts(views[:3]))
    said = succeed("video", "loud.mkv", *QUILT, "--out", "out")
    assert "note: the sound of loud.mkv is left out\n3 frames" in said
    assert open_frames("loud.mkv", FieldOptions()).count == 3  # two seconds of sound are no frames


WRONG = [
    ("text.mp4", QUILT, ["text.mp4", "no video"]),
    ("none.mkv", QUILT, ["there is no file or folder none.mkv"]),
    ("few.toml", QUILT, ["few.toml is no video that is known"]),
    ("none_%04d.png", QUILT, ["fits the pattern none_%04d.png"]),
    ("gaps/q_%d.png", QUILT, ["lacks 1 of the frames 3 to 5", "missing 4", "with *"]),
    ("gaps", QUILT, ["lacks 1 of the frames 3 to 5"]),
    ("times", QUILT, ["lacks 86399 of the frames 0 to 86400", "1, 2, 3, 4, 5, 6 ..."]),
    ("field", QUILT, ["number of its own", "take synth"]),
    ("a%d_%d.png", QUILT, ["must hold one %d"]),
    ("empty", QUILT, ["found no frames in the folder empty"]),
    ("sizes", QUILT, ["frame 1 of sizes has", "the first has", "0 of 2 frames are done"]),
    ("film.mkv", QUILT[-2:], ["say how the views lie in it"]),
    ("film.mkv", ["--grid", "5x3", *QUILT[-2:]], ["5x3 equal tiles do not divide"]),
    ("film.mkv", ["--quilt", "3x2", *QUILT[-2:]], ["1x6 views", "expects 2x3"]),
    ("film.mkv", [*QUILT, "--frames", "40:60"], ["frames is 40:60", "has 48"]),
    ("film.mkv", [*QUILT, "--frames", "7"], ["expected FIRST:STOP"]),
    ("film.mkv", [*QUILT, "--fps", "1e3"], ["fps is '1e3'"]),
    ("film.mkv", [*QUILT, "--format", "avi"], ["unknown format 'avi'"]),
    ("film.mkv", [*QUILT, "--format", "av1", "--bits", "16"], ["av1 keeps 8 bits, found 16"]),
    ("film.mkv", [*QUILT, "--method", "unet"], ["unet"]),
    ("film.mkv", [*QUILT, "--workers", "2"], ["--workers", "give --ray"]),
    ("film.mkv", [*QUILT, "--ray", "somewhere"], ["expected local, auto, HOST:PORT"]),
    ("film.mkv", [*QUILT, "--ray", "127.0.0.1:9"], ["no Ray answers at 127.0.0.1:9"]),
]


@pytest.mark.parametrize(("source", "how", "words"), WRONG)
def test_wrong_input_is_one_line(views, source, how, words):
    if "--ray" in how:
        pytest.importorskip("ray")
    Path("text.mp4").write_text("no video")
    Path("empty").mkdir()
    for folder, numbers, sizes in (("gaps", (3, 5), (0, 0)), ("sizes", (0, 1), (0, 6))):
        Path(folder).mkdir()
        for number, less in zip(numbers, sizes, strict=True):
            picture = torch.from_numpy(quilts(views[:1])[0, less:]).movedim(-1, 0)
            write_png(f"{folder}/q_{number}.png", picture)
    for name in ("times/0.png", "times/86400.png", "field/view_00_00.png", "field/view_01_00.png"):
        Path(name).parent.mkdir(exist_ok=True)
        Path(name).write_bytes(b"")
    before = contents(Path())
    fails(run("video", source, *how, "--out", "out"), *words)
    left = {name for name in contents(Path()) if not name.startswith("out.unfinished")}
    assert left == set(before)
    assert Path("out.unfinished").exists() == (source == "sizes")


def test_a_quilt_that_does_not_divide_is_said(views):
    pictures = np.pad(quilts(views[:2]), ((0, 0), (1, 0), (0, 1), (0, 0)))
    write_film(Path("wide.mkv"), pictures)
    said = succeed("video", "wide.mkv", *QUILT, "--out", "out")
    assert "the quilt of 73x33 px does not divide into 3x2 tiles of 24x16" in said


def test_what_exists_is_not_replaced():
    Path("out").mkdir()
    fails(run("video", "film.mkv", *QUILT, "--out", "out"), "out exists", "force")
    fails(run("video", "film.mkv", *QUILT, "--out", "film.mkv"), "film.mkv")
    assert not list(Path().glob("*.unfinished"))


PEAKS = """
import sys
from contextlib import suppress
from layerfield import cli
from layerfield.own_process import peak_megabytes
for count in ("24", "96"):
    sys.argv = ["layerfield", *{words}, "--frames", f"0:{{count}}", "--out", f"of-{{count}}"]
    with suppress(SystemExit):
        cli.main()
    print("peak", peak_megabytes())
"""


def test_memory_does_not_grow_with_the_number_of_frames():
    """Frames that are kept would take a megabyte each."""
    made = panned(Display(SPEC).geometry, (0, 1), 6, size=(48, 64), seed=3)
    codes = made.clamp(0, 1).mul(255).round().to(torch.uint8)
    write_film(Path("large.mkv"), np.tile(quilts(codes), (16, 1, 1, 1)), g="12")
    words = ["video", "large.mkv", *QUILT, "--batch", "12", "--iterations", "1"]
    done = finish(start(sys.executable, "-c", PEAKS.format(words=words)))
    assert done.err == ""
    few, many = (float(line.split()[1]) for line in done.out.splitlines() if "peak" in line)
    assert many - few < 15, done


def test_batches_do_not_matter_where_every_frame_makes_its_own_start(views):
    """The direct solver makes the start, sweeps follow: layers are the same wherever one begins."""
    Path("product.toml").write_text(
        format_spec(SPEC.model_copy(update={"link": "multiplicative", "name": "product"}))
    )
    how = ["video", "film.mkv", *QUILT[:-1], "product.toml", "--frames", "0:7"]
    for length in ("3", "7"):
        succeed(*how, "--batch", length, "--out", length)
    assert (layers("3") == layers("7")).all()


def test_warm_starts_do_not_flicker_more_than_cold_ones(views):
    """Noise of 1/255 on a scene that stands still; cold frames take as much time."""
    noise = torch.randn((12, 6, 3, *SIZE), generator=torch.Generator().manual_seed(1)).round()
    codes = (views[:1] + noise).clamp(0, 255).to(torch.uint8)
    fields, display = [LightField(frame, GRID) for frame in codes], Display(SPEC)
    warm = [made.layers for made in synthesize_frames(fields, display)][6:]
    cold = [synthesize(field, display, method="fast", iterations=5).layers for field in fields][6:]
    flicker = [torch.stack(found).diff(dim=0).square().mean() for found in (warm, cold)]
    assert flicker[0] < flicker[1]
