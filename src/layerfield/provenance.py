"""What a result was made with: versions and processor, never a host, a user or a path."""

import platform
from pathlib import Path

import torch

from layerfield.version import __version__


def provenance(device: torch.device) -> dict[str, str | int]:
    """Return versions, processor and threads, to be recorded beside results.

    Beside a processor's name stand its widest vector instructions (AVX2, AVX512): times depend on
    them, and virtual machines call processors with and without by one name.
    """
    return {
        "layerfield": __version__,
        "python": platform.python_version(),
        "torch": torch.__version__,
        "device": device.type,
        "processor": _processor(device),
        "threads": torch.get_num_threads(),
    }


def _processor(device: torch.device) -> str:
    if device.type == "cuda":
        return torch.cuda.get_device_name(device)
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines()
    except OSError:
        lines = []
    named = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    widest = torch.backends.cpu.get_cpu_capability()
    return f"{named[0] if named else platform.machine()}, {widest}"
