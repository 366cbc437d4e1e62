"""What commands write if it is asked for: whole, or not at all."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path

from layerfield.io import whole_directory, whole_file


@contextmanager
def _or_nothing(
    whole: Callable[..., AbstractContextManager[Path]], path: Path | None, *, force: bool
) -> Iterator[Path | None]:
    """Write as `whole` does; nothing where there is no name."""
    if path is None:
        yield None
        return
    with whole(path, force=force) as temporary:
        yield temporary


file_or_nothing = partial(_or_nothing, whole_file)
folder_or_nothing = partial(_or_nothing, whole_directory)
