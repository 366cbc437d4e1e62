"""The same videos on Ray: the same layers, whoever dies."""

import os
import signal
import time
from fractions import Fraction
from pathlib import Path

import pytest
from test_cli import fails, run, succeed
from test_video import KILLED, SPEC, _here, film, layers, single, views

from layerfield import FieldOptions
from layerfield.frames.opening import open_frames
from layerfield.video.job import Job
from layerfield.video.making import make_video, read_figures
from layerfield.video.on_ray import Ray, ray_at

ray = pytest.importorskip("ray")
__all__ = ["_here", "film", "single", "views"]  # fixtures


@pytest.fixture(scope="module", autouse=True)
def _two():
    """Ray on this machine, with room for two workers."""
    with ray_at("local", workers=2) as started:
        assert started.device in ("cpu", "cuda")
        yield
    assert not ray.is_initialized()


def job(length: int = 8) -> Job:
    source = open_frames("film.mkv", FieldOptions.parse(quilt="3x2", grid="2x3"))
    return Job(
        source=source,
        frames=(0, source.count),
        spec=SPEC,
        method="fast",
        iterations=3,
        form="ffv1",
        bits=8,
        rounding="joint",
        rate=Fraction(24),
        length=length,
    )


def test_one_worker_and_two_make_the_layers_of_a_run_without_ray(single):
    """To 1/255, and here to the byte."""
    for workers in ("1", "2"):
        how = ["--ray", "local", "--workers", workers, "--device", "cpu", "--force"]
        assert succeed(*KILLED, *how).startswith("48 frames")
        difference = layers("out").astype(int) - layers(single)
        assert abs(difference).max() <= 1
        assert [row["frame"] for row in read_figures("out")] == list(range(48))
        assert (Path("out/layers/layer_1.mkv").read_bytes()) == (
            single / "layers" / "layer_1.mkv"
        ).read_bytes()


def workers_of_ray() -> list[int]:
    """The processes that are making batches; all below this one."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            name = (folder / "cmdline").read_bytes()
            raylet = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
            parent = int(Path(f"/proc/{raylet}/stat").read_text().rpartition(")")[2].split()[1])
        except (OSError, IndexError, ValueError):
            continue
        if name.startswith(b"ray::_Worker.make") and parent == os.getpid():
            found.append(int(folder.name))
    return found


def test_a_worker_that_is_killed_costs_no_frame():
    """One that is at work is killed as soon as the first batch has come."""
    made, killed = job(), []

    def make(given, batches, tick):
        for one in Ray(workers=2, threads=1, device="cpu")(given, batches, tick):
            deadline = time.monotonic() + 20
            while not killed and time.monotonic() < deadline:
                killed.extend(workers_of_ray()[:1])
                for process in killed:
                    os.kill(process, signal.SIGKILL)
            yield one

    make_video("out", made, {}, make=make)
    assert killed
    make_video("whole", made, {})
    assert (layers("out") == layers("whole")).all()
    assert [row["frame"] for row in read_figures("out")] == list(range(48))


def test_what_is_wrong_is_said_when_the_other_batches_have_come():
    whole = Path("film.mkv").read_bytes()
    Path("cut.mkv").write_bytes(whole[: len(whole) // 2])
    how = ["video", "cut.mkv", *KILLED[2:], "--ray", "local", "--workers", "1", "--device", "cpu"]
    fails(run(*how), "cut short", "20 of 48 frames are done")
    Path("cut.mkv").write_bytes(whole)
    assert succeed(*how[:-6], "--resume").startswith("48 frames")


def test_more_workers_than_there_is_room_for_are_refused():
    fails(run(*KILLED, "--ray", "local", "--workers", "5000"), "room for", "5000 workers")
