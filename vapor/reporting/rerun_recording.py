"""A Rerun recording as a file that is whole, or not there."""

from __future__ import annotations

import os
import shutil
import threading
from pathlib import Path

from filtering.errors import VaporTrackError
from sequences.atomic import atomic_output


class Recording:
    """A file that Rerun writes through a pipe: where there is no room, Rerun itself would wait for ever.

    Attributes:
        pipe: Path that Rerun is to write to.
        error: Why the file could not be written; None while it can. What is written to the pipe then is lost.

    Raises:
        SequenceError: the folder is missing or cannot be written to.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._output = atomic_output(path)
        partial = self._output.__enter__()
        pipe, self._end = os.pipe()
        self.pipe = f"/dev/fd/{self._end}"
        self.error: VaporTrackError | None = None
        self._thread = threading.Thread(target=self._copy, args=(pipe, partial), daemon=True)
        self._thread.start()

    def _copy(self, pipe: int, partial: Path) -> None:
        with open(pipe, "rb") as stream:
            try:
                with partial.open("wb") as file:
                    shutil.copyfileobj(stream, file)
            except OSError as error:
                self.error = VaporTrackError(
                    f"{self._path}: the recording cannot be written: {error.strerror or error}; expected room for it on"
                    " the disk, a run with --no-recording needs none"
                )
            while stream.read(1 << 16):  # so that nobody waits for room in the pipe
                pass

    def close(self, *, keep: bool) -> None:
        """Give the file its name, or remove it, once Rerun has closed the pipe.

        Raises:
            VaporTrackError: the file was to be kept, and could not be written.
        """
        os.close(self._end)
        self._thread.join()
        failed = self.error or (None if keep else VaporTrackError("the run failed"))
        self._output.__exit__(failed and type(failed), failed, None)
        if keep and failed:
            raise failed
