"""Who looks from where: how much each view counts."""

import math
from pathlib import Path

from layerfield.geometry import grid_points

_CENTRAL = "central"
_EXPECTED = "expected central, central:STEPS or a CSV file, a line for each row of views"


def parse_observers(text: str, grid: tuple[int, int]) -> tuple[float, ...]:
    """Return the weights of the views of a grid, row by row from the top left.

    Args:
        text: `central:STEPS`, a Gaussian about the middle of the grid whose standard deviation
            is so many view steps (1 if not given); or the name of a CSV file with a number, at
            least 0, for each view.
        grid: (rows, columns).

    Raises:
        ValueError: neither of these, or a file that does not hold such numbers for the grid.

    >>> [round(w, 3) for w in parse_observers("central:0.5", (1, 3))]
    [0.135, 1.0, 0.135]
    """
    name, _, steps = text.partition(":")
    if name == _CENTRAL:
        spread = _positive(steps or "1", text)
        return tuple(math.exp(-(x * x + y * y) / (2 * spread**2)) for x, y in grid_points(grid))
    rows = [[_number(word) for word in line.split(",")] for line in _lines(text)]
    expected = "{}x{}".format(*grid)
    if len(rows) != grid[0] or any(len(row) != grid[1] for row in rows):
        lengths = {len(row) for row in rows}
        found = f"{len(rows)} lines of {' or '.join(map(str, sorted(lengths))) or 'no'} numbers"
        raise ValueError(f"{text} holds {found}, expected {expected}, one for each view")
    weights = tuple(weight for row in rows for weight in row)
    if not all(0 <= w < math.inf for w in weights) or not any(weights):
        raise ValueError(f"{text}: expected {expected} numbers, at least 0 and not all 0")
    return weights


def _positive(steps: str, text: str) -> float:
    spread = _number(steps)
    if not 0 < spread < math.inf:
        raise ValueError(f"observers are '{text}'; {_EXPECTED}, STEPS above 0")
    return spread


def _number(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        return math.nan


def _lines(name: str) -> list[str]:
    try:
        text = Path(name).read_text("utf-8")
    except FileNotFoundError:
        raise ValueError(
            f"observers are '{name}', and there is no such file; {_EXPECTED}"
        ) from None
    except (OSError, ValueError) as error:
        raise ValueError(f"cannot read observers from {name}: {error}; {_EXPECTED}") from None
    return [line for line in text.splitlines() if line.strip()]
