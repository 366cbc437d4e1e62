"""The history of a run for TensorBoard, in files that name no machine."""

import time
from pathlib import Path

from tensorboard.compat.proto.event_pb2 import (
    Event,  # pyright: ignore[reportAttributeAccessIssue], made at run time
    SessionLog,  # pyright: ignore[reportAttributeAccessIssue]
)
from tensorboard.compat.proto.summary_pb2 import Summary  # pyright: ignore[reportAttributeAccessIssue]
from tensorboard.summary.writer.record_writer import RecordWriter


class Board:
    """Appends scalars to a file of its own; each sitting of a training begins one.

    TensorBoard's own writer puts the name of the machine into that of the file.

    Args:
        folder: of event files, made if it is not there.
        step: that the sitting begins at; what earlier files say of later ones is void.
    """

    def __init__(self, folder: Path, step: int) -> None:
        folder.mkdir(exist_ok=True)
        sitting = len(list(folder.iterdir()))
        self.file = (folder / f"events.out.tfevents.{sitting:010d}").open("xb")
        self.writer = RecordWriter(self.file)
        self._write(Event(file_version="brain.Event:2"))
        self._write(Event(step=step + 1, session_log=SessionLog(status=SessionLog.START)))

    def add(self, scalars: dict[str, float], step: int) -> None:
        """Write the scalars of a step, at once."""
        values = [Summary.Value(tag=tag, simple_value=value) for tag, value in scalars.items()]
        self._write(Event(step=step, summary=Summary(value=values)))

    def _write(self, event: Event) -> None:
        event.wall_time = time.time()
        self.writer.write(event.SerializeToString())
        self.file.flush()
