"""The run-time type checker of the tests: beartype, with int accepted where float is asked for.

In every test the first calls of a function are checked. Solvers call some of theirs thousands of
times with the same shapes, where checks of small tensors took most of the time.
"""

from collections import Counter
from collections.abc import Callable
from functools import wraps
from typing import Any

from beartype import BeartypeConf, beartype

_CALLS = 40
calls: Counter[Callable] = Counter()  # of every function; cleared before a test


def checked(function: Callable) -> Callable:
    strict: Callable = beartype(conf=BeartypeConf(is_pep484_tower=True))(function)

    @wraps(function)
    def at_first(*args: Any, **kwargs: Any) -> Any:
        calls[function] += 1
        return (strict if calls[function] <= _CALLS else function)(*args, **kwargs)

    return at_first
