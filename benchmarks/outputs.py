"""Where a benchmark writes its record: refused before minutes of work, not behind them."""

import argparse
from pathlib import Path


def output_file(written: str) -> Path:
    """Return the path of a file to write, for `argparse`.

    Raises:
        ArgumentTypeError: it is a folder, or there is none for it.
    """
    path = Path(written)
    if path.is_dir() or not path.parent.is_dir():
        raise argparse.ArgumentTypeError(
            f"{path} is a folder, or there is none for it; expected a file to write"
        )
    return path
