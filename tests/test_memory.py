"""Memory that is kept for the next large arrays."""

import os
import platform
import subprocess
import sys

import pytest

LATER_ARRAY = """
import resource, torch
from layerfield.memory import keep_large_blocks

done = keep_large_blocks()

def faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    torch.zeros(12_000_000)  # 48 MB
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

print(done, min(faults() for _ in range(5)))
"""


def later_array(**environment: str) -> tuple[str, int]:
    """Whether anything was set, and how many pages the system gave for a later large array."""
    clean = {key: value for key, value in os.environ.items() if not key.startswith("MALLOC_")}
    command = [sys.executable, "-c", LATER_ARRAY]
    ran = subprocess.run(
        command, check=True, capture_output=True, text=True, env=clean | environment
    )
    done, pages = ran.stdout.split()
    return done, int(pages)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library")
def test_a_later_large_array_takes_no_new_pages():
    assert later_array() == ("True", pytest.approx(0, abs=100))
    done, pages = later_array(MALLOC_MMAP_THRESHOLD_=f"{2**20}")  # the user's own
    assert done == "False"
    assert pages > 1000 or os.sysconf("SC_PAGE_SIZE") > 4096
