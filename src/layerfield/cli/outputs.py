"""What commands write if it is asked for: whole, or not at all."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from layerfield.io import whole_directory, whole_file


@contextmanager
def file_or_nothing(path: Path | None, *, force: bool) -> Iterator[Path | None]:
    """Write a file as `whole_file` does; nothing where there is no name."""
    if path is None:
        yield None
        return
    with whole_file(path, force=force) as temporary:
        yield temporary


@contextmanager
def folder_or_nothing(path: Path | None, *, force: bool) -> Iterator[Path | None]:
    """Write a folder as `whole_directory` does; nothing where there is no name."""
    if path is None:
        yield None
        return
    with whole_directory(path, force=force) as temporary:
        yield temporary
