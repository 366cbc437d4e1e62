"""How a scene moves from frame to frame."""

import csv
from pathlib import Path

from layerfield.rendering.placement import Pose

_MOST = 10_000  # frames


def turntable(count: int, start: Pose) -> tuple[Pose, ...]:
    """Return poses of one full turn; the one after the last would be the first again.

    Raises:
        ValueError: not 1 to 10 000 frames.

    >>> [pose.azimuth for pose in turntable(4, Pose(azimuth=30))]
    [30.0, 120.0, 210.0, 300.0]
    """
    _refuse_number(count)
    turns = (start.azimuth + 360 * i / count for i in range(count))
    return tuple(Pose(turn, start.elevation) for turn in turns)


def read_poses(path: Path) -> tuple[Pose, ...]:
    """Read poses from a CSV file: azimuth and elevation in degrees, a line for each frame.

    Raises:
        ValueError: no such file, or a line that is not two such numbers.
    """
    try:
        lines = list(csv.reader(path.read_text("utf-8").splitlines()))
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"cannot read {path}: {getattr(error, 'strerror', error)}") from None
    poses = tuple(_pose(line, f"{path}, line {i}") for i, line in enumerate(lines, 1) if any(line))
    _refuse_number(len(poses))
    return poses


def _pose(line: list[str], where: str) -> Pose:
    try:
        azimuth, elevation = (float(text) for text in line)
    except ValueError:
        found = ",".join(line)
        raise ValueError(
            f"{where}: found '{found}', expected azimuth,elevation in degrees, as 30,20"
        ) from None
    try:
        return Pose(azimuth, elevation)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None


def _refuse_number(count: int) -> None:
    if not 1 <= count <= _MOST:
        raise ValueError(f"found {count} frames, expected 1 to {_MOST}")
