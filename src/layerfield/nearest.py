"""Suggest the nearest known name for a mistyped one."""

from collections.abc import Iterable
from difflib import get_close_matches


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return a remedy to append to an error: the nearest name if there is one, else all of them.

    >>> did_you_mean("addtive-3", ["additive-3", "perspective-3"])
    "; did you mean 'additive-3'?"
    """
    known = sorted(known)
    close = get_close_matches(name, known, n=1)
    return f"; did you mean '{close[0]}'?" if close else f"; known are {', '.join(known)}"
