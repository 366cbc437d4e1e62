"""Folders that take long to fill: what is done is kept until all is, under another name."""

import json
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from layerfield.io.safe_output import put_in_place, refuse_existing, whole_file


@contextmanager
def resumable_directory(
    path: str | Path,
    record: str,
    facts: Mapping[str, Any],
    *,
    resume: bool = False,
    force: bool = False,
) -> Iterator[Path]:
    """Fill a folder that appears only when it is complete; what is done before a stop is kept.

    Args:
        path: the folder to make; `PATH.unfinished` until then.
        record: name of a file in it, which holds
        facts: on what is made, for JSON.
        resume: go on with what an earlier run left.
        force: replace an existing folder, if this program made it, and what an earlier run left.

    Yields:
        The folder to fill, with whole files only; those of an earlier run are there.

    Raises:
        ValueError: the folder exists and may not be replaced, or an earlier run left something
            that is not to be resumed, or was to become something else.
    """
    path = Path(path)
    refuse_existing(path, force=force)
    work = unfinished(path)
    text = json.dumps(facts, indent=2) + "\n"
    if work.exists() or work.is_symlink():
        _refuse_foreign(work, record)
        if resume:
            _refuse_other(work, _facts(work / record), json.loads(text))
            _sweep(work)
        elif force:
            shutil.rmtree(work)
        else:
            raise ValueError(
                f"{work} holds what an earlier run did; go on with it by resume, or start anew by "
                "force"
            )
    refuse_existing(work, force=True)
    work.mkdir(exist_ok=True)
    with whole_file(work / record, force=True) as temporary:
        temporary.write_text(text, "utf-8")
    yield work
    put_in_place(work, path, force=force)


def is_made(path: str | Path, record: str, facts: Mapping[str, Any]) -> bool:
    """Whether a complete folder of these facts is there, and nothing unfinished."""
    found = Path(path) / record
    same = found.is_file() and _facts(found) == json.loads(json.dumps(facts))
    return same and not unfinished(Path(path)).exists()


def unfinished(path: Path) -> Path:
    """Return where a folder is until it is complete."""
    return path.with_name(f"{path.name}.unfinished")


def _refuse_foreign(work: Path, record: str) -> None:
    if not (work / record).is_file():
        raise ValueError(
            f"{work} has no {record}, so it was not made here and will not be touched; remove it "
            "yourself, or give another name"
        )


def _refuse_other(work: Path, earlier: Any, now: dict[str, Any]) -> None:
    known = earlier if isinstance(earlier, dict) else {}
    for key, value in now.items():
        if known.get(key) != value:
            raise ValueError(
                f"{work} was made with another '{key}' ({_short(known.get(key))}, now "
                f"{_short(value)}); give what was given then, or start anew by force"
            )


def _sweep(work: Path) -> None:
    """Remove what was being written when an earlier run was killed."""
    for file in work.rglob(".*"):
        file.unlink()


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _facts(path: Path) -> Any:
    try:
        return json.loads(path.read_text("utf-8"))
    except (OSError, ValueError):
        return None
