"""What marks a kernel, and the functions that kernels call."""

from collections.abc import Callable
from inspect import unwrap
from typing import Any

import triton


def kernel(function: Callable[..., Any]) -> Any:
    """Return a function that Triton compiles at its first call: `function[grid](*arguments)`."""
    return triton.jit(unwrap(function))  # without what tests wrap around it
