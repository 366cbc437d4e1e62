"""How much faster two workers of Ray make the layers of a video than one, start-up excluded.

    python benchmarks/video_workers.py OUT.json

A quilt video of 96 frames of 5x5 views of 128x96 pixels, a slow pan over a procedural scene, for
`additive-3`, in batches of 16 frames; every worker has one thread. The time is that from when the
workers are ready to when the videos of the layers are written, the best of three. Beside it that of
a run without Ray, and whether the layers are the same.
"""

import argparse
import json
import shutil
import tempfile
import time
from fractions import Fraction
from pathlib import Path

import av
import ray
import torch
from outputs import output_file

from layerfield import Display, FieldOptions
from layerfield.frames.opening import open_frames
from layerfield.io import whole_file
from layerfield.provenance import provenance
from layerfield.scenes import panned
from layerfield.video.job import Job
from layerfield.video.making import Maker, make_here, make_video, read_figures
from layerfield.video.on_ray import ray_at

FRAMES, SIZE, BATCH, RUNS = 96, (96, 128), 16, 3
SHOWN = Display.load("additive-3")
LAYOUT = FieldOptions.parse(quilt="5x5", grid="5x5", order="bl-row")


def write_quilts(path: Path) -> None:
    """Write the video that is read: views from the bottom left, as the picture shows them."""
    views = panned(SHOWN.geometry, (1, 0), FRAMES, size=SIZE, seed=11)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("ffv1", rate=24, options={"g": "1"})
        stream.height, stream.width = 5 * SIZE[0], 5 * SIZE[1]
        stream.pix_fmt = "bgr0"
        for frame in views:
            codes = frame.clamp(0, 1).mul(255).round().to(torch.uint8).unflatten(0, (5, 5))
            picture = codes.permute(0, 3, 1, 4, 2).flatten(2, 3).flatten(0, 1)
            shown = av.VideoFrame.from_ndarray(picture.contiguous().numpy(), "rgb24")
            container.mux(stream.encode(shown.reformat(format="bgr0")))
        container.mux(stream.encode())


def job_of(path: Path) -> Job:
    source = open_frames(str(path), LAYOUT)
    return Job(
        source=source,
        frames=(0, source.count),
        spec=SHOWN.spec,
        method="fast",
        iterations=3,
        form="ffv1",
        bits=8,
        rounding="joint",
        rate=Fraction(24),
        length=BATCH,
    )


def seconds(out: Path, job: Job, make: Maker) -> float:
    """Return how long a video takes from the first frame to the last file, the best of runs."""
    found = []
    for _ in range(RUNS):
        shutil.rmtree(out, ignore_errors=True)
        began: list[float] = []

        def tick(what: str, done: int, began: list[float] = began) -> None:
            if what == "frames":
                began.append(time.perf_counter())

        begin = time.perf_counter()
        make_video(out, job, {}, make=make, tick=tick)
        found.append(time.perf_counter() - (began[0] if make is not make_here else begin))
    return min(found)


def same(one: Path, other: Path) -> bool:
    files = sorted(one.glob("layers/*"))
    return all(f.read_bytes() == (other / "layers" / f.name).read_bytes() for f in files)


def main(out: Path) -> None:
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        write_quilts(place / "quilts.mkv")
        job = job_of(place / "quilts.mkv")
        took = {"without Ray": seconds(place / "without", job, make_here)}
        for workers in (1, 2):
            with ray_at("local", workers=workers, device="cpu") as found:
                took[f"{workers} workers"] = seconds(place / str(workers), job, found)
        alike = all(same(place / "without", place / str(workers)) for workers in (1, 2))
        iterations = sum(row["iterations"] for row in read_figures(place / "without"))
    record = {
        "command": f"python benchmarks/video_workers.py {out.name}",
        "made_with": provenance(torch.device("cpu")) | {"ray": ray.__version__},
        "frames": FRAMES,
        "views": [5, 5, *SIZE],
        "batch": BATCH,
        "run_in": job.run_in,
        "iterations": iterations,
        "seconds": took,
        "speed_up": took["1 workers"] / took["2 workers"],
        "same_layers": alike,
    }
    with whole_file(out, force=True) as temporary:
        temporary.write_text(json.dumps(record, indent=1) + "\n", "utf-8")
    print(json.dumps(record["seconds"]), f"speed-up {record['speed_up']:.2f}, same: {alike}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="speed-up of a second worker")
    parser.add_argument("out", type=output_file)
    main(parser.parse_args().out)
