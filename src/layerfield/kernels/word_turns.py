"""What rows of words go through from sweep to sweep, turn by turn; see `word_sweeps`."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from layerfield.kernels.parts import parts_of

LOAD, PUSH = -1, -2  # turns that are no layers
GIVEN, ENLARGED = 0, 1  # what is loaded
NOT_PUSHED = -1
STRIDE = 40503  # golden section of 2^16: any number of sweeps round up evenly
_ONE = 2**15  # what shares are parts of
_AT_ONCE, _OF_ONE = 4, 3  # sweeps, and of a single plane: of more, parts would be few


class Turns(NamedTuple):
    """Which turns rows have.

    A layer that was found is pushed on at once, for the next sweep. Layers that follow in this one
    see it as it was before: that is kept, as P of one sweep ago.

    Args:
        turns: `[turn, 4]`: `LOAD`, and what; `PUSH`, and by which share; or a layer, and by which
            share it is pushed on when it was found, or `NOT_PUSHED`; then by how much thresholds
            have gone up, and whether a picture is made.
        are_before: `[turn, layer]`, whether a layer is seen as it was before it was pushed.
        which: `[part, 2]`, the first turn of a part, and how many it has.
        parts: see `parts_of`.
        needs: likewise.
    """

    turns: np.ndarray
    are_before: np.ndarray
    which: np.ndarray
    parts: np.ndarray
    needs: np.ndarray


@lru_cache(maxsize=64)
def turns_of(
    planes: tuple[int, int, int],
    order: tuple[int, ...],
    loads: int | None,
    pushes: tuple[float, ...],
    made: int,
    *,
    shows: bool = True,
) -> Turns:
    """Return the turns of sweeps, a few at once and then the next.

    Args:
        planes: how many, their height, and how far rows look.
        order: of layers. The first one is found before anybody sees it, and never pushed.
        loads: what is loaded, where there are no words.
        pushes: of sweeps, each before it; the first has none where something is loaded.
        made: sweeps made before.
        shows: whether a picture is made in the end.
    """
    shares = [round(push * _ONE) for push in pushes] + [NOT_PUSHED]
    rises = [(made + n) * STRIDE % 2**16 for n in range(len(shares))]
    turns = [(PUSH, shares[0], rises[0], 0) if loads is None else (LOAD, loads, 0, 0)]
    seen = [(False,) * len(order)]
    which, parts, needs = [], [], []
    begin = 0
    at_once = _AT_ONCE if planes[0] > 1 else _OF_ONE
    for first in range(0, len(pushes), at_once):
        for n in range(first + 1, min(first + at_once, len(pushes)) + 1):
            is_last = n == len(pushes)
            for place, k in enumerate(order):
                share = shares[n] if place > 0 else NOT_PUSHED
                turns.append((k, share, rises[n], int(is_last and shows)))
                pushed = () if is_last else order[1:place]
                seen.append(tuple(j in pushed for j in range(len(order))))
        before, count = sum(map(len, parts)), len(turns) - begin
        own, needed = parts_of(*planes, count)
        which += [(begin, count)] * len(own)
        parts.append(own)
        needs.append(before + needed)
        begin = len(turns)
    lists = np.array(turns), np.array(seen), np.array(which)
    return Turns(*lists, np.concatenate(parts), np.concatenate(needs))
