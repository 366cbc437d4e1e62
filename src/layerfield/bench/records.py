"""The folder of a benchmark: facts and rows in one JSON file, whole at any time."""

import json
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from layerfield.io import whole_file
from layerfield.metrics import finite

FRONTIER, SCALING = "bench.json", "scaling.json"

Subjects = dict[str, dict[str, Any]]
"""By kind and name, what is measured or measured on: plain data that no two share."""


def open_folder(out: Path, *, resume: bool, force: bool) -> None:
    """Make the folder of a benchmark, or find it as it was left.

    Raises:
        ValueError: nothing to resume, or a folder that may not be replaced.
    """
    ours = any((out / name).is_file() for name in (FRONTIER, SCALING))
    if resume:
        if not ours:
            raise ValueError(f"{out} holds no {FRONTIER} to go on from; leave out --resume")
        return
    if out.is_file():
        raise ValueError(f"cannot write {out}: it is a file, expected the name of a folder")
    if out.is_dir() and any(out.iterdir()):
        if not force:
            raise ValueError(f"{out} exists; go on with --resume, replace it with --force")
        if not ours:
            raise ValueError(
                f"{out} holds no benchmark and will not be replaced; give another --out"
            )
        shutil.rmtree(out)
    try:
        out.mkdir(exist_ok=True)
    except OSError as error:
        raise ValueError(f"cannot make {out}: {error.strerror}") from None


def write_record(path: Path, record: Mapping[str, Any]) -> None:
    """Write a record; what is infinite in dB becomes null."""
    with whole_file(path, force=True) as temporary:
        temporary.write_text(json.dumps(finite(record), indent=1, allow_nan=False) + "\n", "utf-8")


@dataclass(frozen=True)
class Known:
    """What an earlier run has found.

    Args:
        rows: its rows.
        subjects: what names in them stood for.
    """

    rows: list[dict[str, Any]] = field(default_factory=list)
    subjects: Subjects = field(default_factory=dict)

    def together_with(self, subjects: Subjects, place: Path) -> Subjects:
        """Return the subjects of both runs.

        Raises:
            ValueError: one name stands for two things.
        """
        both = {kind: dict(named) for kind, named in self.subjects.items()}
        for kind, named in subjects.items():
            known = both.setdefault(kind, {})
            for name, what in named.items():
                if known.setdefault(name, what) != what:
                    raise ValueError(
                        f"{place} has rows of another {kind} named '{name}'; give it another name, "
                        "or another --out, or make all again with --force"
                    )
        return both


def known_rows(path: Path, facts: Mapping[str, Any]) -> Known:
    """Return the rows of an earlier run with the same facts; none if there is no file.

    Args:
        path: of the file.
        facts: what must be the same, so that rows compare.

    Raises:
        ValueError: the file is damaged, or was made otherwise.
    """
    if not path.is_file():
        return Known()
    try:
        found = json.loads(path.read_text("utf-8"))
        rows, earlier = found["rows"], {name: found.get(name) for name in facts}
        subjects = {kind: dict(named) for kind, named in found.get("subjects", {}).items()}
    except (ValueError, TypeError, KeyError, AttributeError):
        raise ValueError(f"{path} is damaged; make it again with --force") from None
    for name, value in json.loads(json.dumps(facts)).items():
        if earlier[name] != value:
            raise ValueError(
                f"{path} was made with {name} {_short(earlier[name])}, found {_short(value)}; ask "
                "for the same, or make it again with --force"
            )
    return Known(rows, subjects)


def _short(value: Any) -> str:
    return f"{value!s:.200}"
