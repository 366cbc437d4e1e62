"""Batches on Ray: workers on this machine, or on all of a cluster.

A worker is an actor that makes one batch at a time. Ray starts it anew where it dies, and gives it
the batch again. What it returns is written here, but it reads the frames itself: every machine must
find them under the same path.
"""

import logging
import os
import re
import shutil
import signal
import socket
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib.util import find_spec
from secrets import token_hex
from typing import Any

import torch

from layerfield.video.job import Batch, Job
from layerfield.video.making import Tick
from layerfield.video.work import Made, make_batch

LOCAL = "local"
_TRIES = 3  # of a batch, after the first, where workers die
_PATIENCE = 5.0  # seconds until a cluster counts as not reachable
_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
# Before Ray is imported, and for all that it starts: it tells nobody that it is used.
_SILENT = {"RAY_USAGE_STATS_ENABLED": "0"}
# Nothing but this machine can reach it (the name is that of the systems where this is so anyway),
# and its workers are as important as this process, not 15 steps less.
_OWN = {"RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0", "RAY_worker_niceness": "0"}


@dataclass(frozen=True)
class Ray:
    """Workers of a Ray that runs.

    Args:
        workers: how many make batches at a time.
        threads: of each worker.
        device: what they work on, "cpu" or "cuda": there each has a device of its own.
    """

    workers: int
    threads: int
    device: str

    def __call__(self, job: Job, batches: Sequence[Batch], tick: Tick) -> Iterator[Made]:
        """Make batches; they come in the order in which they are done.

        Raises:
            ValueError: a frame that cannot be made, or workers that die again and again; when all
                other batches have come.
        """
        from ray.exceptions import RayActorError, RayTaskError  # noqa: PLC0415  an extra

        done, wrong = job.count_without(batches), None
        tick("starting workers", done)
        pool = self._pool(job, batches)
        tick("frames", done)
        while pool.has_next():
            try:
                made: Made = pool.get_next_unordered()
            except RayTaskError as error:
                if not isinstance(error.cause, ValueError):
                    raise
                wrong = wrong or error.cause
            except RayActorError:
                wrong = wrong or ValueError(
                    f"a worker died {_TRIES + 1} times over the same frames, perhaps for want of "
                    "memory; take fewer --workers or a smaller --batch"
                )
            else:
                done += len(made.rows)
                tick("frames", done)
                yield made
        if wrong is not None:
            raise wrong

    def _pool(self, job: Job, batches: Sequence[Batch]) -> Any:
        import ray  # noqa: PLC0415  an extra
        from ray.exceptions import RayError  # noqa: PLC0415
        from ray.util import ActorPool  # noqa: PLC0415

        on_gpu = int(self.device == "cuda")
        kind = ray.remote(
            num_cpus=self.threads,
            num_gpus=on_gpu,
            max_restarts=-1,
            max_task_retries=_TRIES,
        )(_Worker)
        count = min(self.workers, len(batches))
        workers: list[Any] = [kind.remote(self.threads) for _ in range(count)]
        try:
            ray.get([worker.__ray_ready__.remote() for worker in workers])
        except RayError as error:
            raise ValueError(
                "a worker of Ray cannot start; every machine needs this version of layerfield "
                f"({str(error).strip().splitlines()[-1]})"
            ) from None
        pool = ActorPool(workers)
        sent = ray.put(replace(job))  # without what it has read
        for batch in batches:
            pool.submit(lambda worker, one: worker.make.remote(sent, one), batch)
        return pool


class _Worker:
    """Makes batches in a process of its own."""

    def __init__(self, threads: int) -> None:
        torch.set_num_threads(threads)
        self._job: Job | None = None

    def make(self, job: Job, batch: Batch) -> Made:
        self._job = self._job or job  # the first one has read the first frame
        return make_batch(self._job, batch)


@contextmanager
def ray_at(
    address: str, *, workers: int | None = None, threads: int = 1, device: str | None = None
) -> Iterator[Ray]:
    """Start or reach Ray; one that is started ends with the context, without traces.

    Args:
        address: "local": on this machine, and reachable from it alone; "auto", HOST:PORT or
            ray://HOST:PORT of a cluster. A Ray that this process is using already is taken.
        workers: how many; as many as there are devices or processors for if not given.
        threads: of each worker.
        device: "cpu" or "cuda"; the latter where Ray has such devices if not given.

    Raises:
        ValueError: Ray is missing, nothing answers, or there is no room for so many workers.
    """
    if find_spec("ray") is None:
        raise ValueError("this needs Ray; install it with pip install 'layerfield[ray]'")
    os.environ |= _SILENT
    if address == LOCAL:
        os.environ |= _OWN
        os.environ.setdefault("RAY_AUTH_TOKEN", token_hex(32))  # or it leaves a file with one
    import ray  # noqa: PLC0415  an extra

    if ray.is_initialized():
        yield _chosen(workers, threads, device)
        return
    folder = tempfile.mkdtemp(
        prefix="lf-"
    )  # short: sockets in it have names of 107 letters at most
    try:
        _connect(address, folder, (workers or 1) * threads)
        yield _chosen(workers, threads, device)
    except SystemError as error:  # Ray's word for a signal that came while it waited
        raise (error.__cause__ or error) from None
    finally:
        ray.shutdown()
        shutil.rmtree(folder, ignore_errors=True)


def _connect(address: str, folder: str, cpus: int) -> None:
    import ray  # noqa: PLC0415  an extra

    handlers = {number: signal.getsignal(number) for number in _SIGNALS}
    how: dict[str, Any] = {"address": address}
    if address == LOCAL:
        count = max(cpus, os.cpu_count() or 1)
        how |= {"num_cpus": count, "include_dashboard": False, "_temp_dir": folder}
    else:
        _refuse_unreachable(address)
    try:
        ray.init(**how, log_to_driver=False, logging_level=logging.ERROR)
    except (ConnectionError, RuntimeError, TimeoutError, ValueError) as error:
        raise ValueError(f"cannot use Ray at '{address}': {error}") from None
    for number, handler in handlers.items():  # Ray puts its own in the place of ours
        signal.signal(number, handler)


def _refuse_unreachable(address: str) -> None:
    """Ray itself would try for two minutes, and say so in many lines."""
    match = re.fullmatch(r"(?:ray://)?([\w.-]+|\[[\da-fA-F:]+\]):(\d{1,5})", address)
    if address == "auto":
        return
    if match is None:
        raise ValueError(
            f"ray is '{address}', expected local, auto, HOST:PORT or ray://HOST:PORT of a cluster"
        )
    try:
        socket.create_connection((match[1].strip("[]"), int(match[2])), _PATIENCE).close()
    except (OSError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ValueError(
            f"no Ray answers at {address} ({reason}); start one with `ray start --head`, or take "
            "--ray local"
        ) from None


def _chosen(workers: int | None, threads: int, device: str | None) -> Ray:
    """Choose device and workers by what Ray has.

    Raises:
        ValueError: it has not as much as was asked for; workers would wait for ever.
    """
    import ray  # noqa: PLC0415  an extra

    nodes = [node["Resources"] for node in ray.nodes() if node["Alive"]]
    device = device or ("cuda" if any(node.get("GPU") for node in nodes) else "cpu")
    room = sum(_room(node, threads, device) for node in nodes)
    if room < (workers or 1):
        devices = " and a CUDA device" if device == "cuda" else ""
        raise ValueError(
            f"Ray has room for {room} workers of {threads} processors{devices} each, found "
            f"{workers or 1} workers; take fewer, with fewer --threads, or --device cpu"
        )
    return Ray(workers or room, threads, device)


def _room(node: dict[str, float], threads: int, device: str) -> int:
    processors = int(node.get("CPU", 0)) // threads
    return min(processors, int(node.get("GPU", 0))) if device == "cuda" else processors
