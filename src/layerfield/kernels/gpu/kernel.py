"""What marks a kernel, or a function that kernels call, and how many programs it is run by."""

from collections.abc import Callable
from inspect import unwrap
from typing import Any

import triton


def kernel(function: Callable[..., Any]) -> Any:
    """Return a function that Triton compiles at its first call: `function[grid](*arguments)`."""
    return triton.jit(unwrap(function))  # without what tests wrap around it


def blocks(count: int, size: int) -> int:
    """Return how many blocks of a size hold so many.

    >>> blocks(9, 4)
    3
    """
    return -(-count // size)
