"""Nothing is half-written: work under a temporary name, rename at the end."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from secrets import token_hex

# Files that only this program writes.
_OURS = (
    "result.json",
    "design.json",
    "figures.json",
    "render.json",
    "field.json",
    "video.json",
)


@contextmanager
def whole_file(path: str | Path, *, force: bool = False) -> Iterator[Path]:
    """Write a file that appears only when it is complete.

    Args:
        path: the file to make.
        force: replace an existing file.

    Yields:
        A path beside it, with the same suffix, to write to. It is gone after any exception.

    Raises:
        ValueError: the file exists and may not be replaced, or it cannot be written.
    """
    path = Path(path)
    with _one_line_errors(path):
        _refuse_file(path, force)
        temporary = _beside(path)
        temporary.touch(exist_ok=False)
        try:
            yield temporary
            _refuse_file(path, force)
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)


@contextmanager
def whole_directory(path: str | Path, *, force: bool = False) -> Iterator[Path]:
    """Write a folder that appears only when it is complete.

    Args:
        path: the folder to make.
        force: replace an existing folder, if it is empty or was written by this program. It stays
            until the new one is complete.

    Yields:
        An empty folder beside it to write into. It is gone after any exception.

    Raises:
        ValueError: the folder exists and may not be replaced, or it cannot be written.
    """
    path = Path(path)
    with _one_line_errors(path):
        _refuse_directory(path, force)
        temporary = _beside(path)
        temporary.mkdir()
        try:
            yield temporary
            _refuse_directory(path, force)
            _move_in(temporary, path)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)


def refuse_existing(path: str | Path, *, force: bool = False) -> None:
    """Refuse, before any work is done, what `whole_directory` would refuse in the end.

    Raises:
        ValueError: the folder exists and may not be replaced, or its parent is no folder.
    """
    path = Path(path)
    with _one_line_errors(path):
        _refuse_directory(path, force)


def put_in_place(made: Path, path: Path, *, force: bool = False) -> None:
    """Give a complete folder its name; one of that name stays until then.

    Raises:
        ValueError: as `refuse_existing` does, or it cannot be renamed.
    """
    with _one_line_errors(path):
        _refuse_directory(path, force)
        _move_in(made, path)


def _beside(path: Path) -> Path:
    return path.with_name(f".{path.stem[:50]}-{token_hex(6)}{path.suffix}")


@contextmanager
def _one_line_errors(path: Path) -> Iterator[None]:
    try:
        if path.name in ("", ".."):
            raise ValueError(f"cannot write '{path}': it has no name of its own; give another one")
        if not path.parent.is_dir():
            found = "is not a folder" if path.parent.exists() else "does not exist"
            raise ValueError(f"cannot write {path}: {path.parent} {found}")
        yield
    except BrokenPipeError:  # about the terminal, not about this file
        raise
    except OSError as error:
        raise ValueError(f"cannot write {path}: {error.strerror or error}") from None


def _refuse_file(path: Path, force: bool) -> None:
    if path.is_dir():
        raise ValueError(f"cannot write {path}: it is a folder, expected the name of a file")
    if _exists(path) and not force:
        raise ValueError(f"{path} exists; give another name, or force to replace it")


def _refuse_directory(path: Path, force: bool) -> None:
    if not _exists(path):
        return
    if not path.is_dir():
        raise ValueError(f"cannot write {path}: it is a file, expected the name of a folder")
    if not force:
        raise ValueError(f"{path} exists; give another name, or force to replace it")
    if any(path.iterdir()) and not _made_here(path):
        raise ValueError(
            f"{path} holds no {', '.join(_OURS)} or views with a display.toml, so it was not made "
            "here and will not be replaced; give another name, or remove it yourself"
        )


def _made_here(path: Path) -> bool:
    """A display.toml without views may be the user's own, beside anything else."""
    simulated = (path / "display.toml").is_file() and (path / "views").is_dir()
    return simulated or any((path / name).is_file() for name in _OURS)


def _exists(path: Path) -> bool:
    return path.is_symlink() or path.exists()


def _move_in(temporary: Path, path: Path) -> None:
    if not _exists(path):
        temporary.rename(path)
        return
    old = _beside(path)
    path.rename(old)
    try:
        temporary.rename(path)
    except BaseException:
        old.rename(path)
        raise
    try:
        old.unlink() if old.is_symlink() else shutil.rmtree(old)
    except OSError as error:
        raise ValueError(
            f"{path} is written, but what it replaced could not be removed and is now {old}: "
            f"{error.strerror}"
        ) from None
