"""Memory of large arrays: kept for the next ones, not handed back after each."""

import ctypes
import os
import platform
from functools import cache

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # of mallopt(3)
_NEVER = -1  # give back what is freed at the end of the heap
_LARGEST = 2**31 - 1  # bytes of a block, all that fits the C library's whole number
_OWN = ("GLIBC_TUNABLES", "MALLOC_TRIM_THRESHOLD_", "MALLOC_MMAP_THRESHOLD_")


@cache
def keep_large_blocks() -> bool:
    """Let the C library keep what is freed for the arrays to come.

    The GNU C library takes blocks above 32 MB from the system, one by one, and gives them back at
    once. The system clears them page by page: from a megapixel on, the steps of a solver wait for
    that longer than they compute. A bound on what is kept would be reached by pictures of 8
    megapixels, whose arrays come to 5 GB: every second one took half as long again.

    Holds for the whole process. Nothing is done where the user has set the thresholds (environment
    variables `GLIBC_TUNABLES`, `MALLOC_TRIM_THRESHOLD_`, `MALLOC_MMAP_THRESHOLD_`), nor with other
    C libraries.

    Returns:
        Whether anything was set.
    """
    if platform.libc_ver()[0] != "glibc" or any(name in os.environ for name in _OWN):
        return False
    library = ctypes.CDLL(None)
    thresholds = {_TRIM_THRESHOLD: _NEVER, _MMAP_THRESHOLD: _LARGEST}
    return all(library.mallopt(*threshold) == 1 for threshold in thresholds.items())
