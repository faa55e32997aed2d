"""The calls that the output process takes, see `output_process`; this module is imported there only."""

from __future__ import annotations

import os
import pickle
import sys
import traceback
from collections.abc import Mapping
from contextlib import suppress
from importlib.abc import MetaPathFinder
from pathlib import Path
from typing import BinaryIO

import numpy as np

from filtering.config import LocalizerConfig
from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from sequences.frame import Frame
from sequences.reading.counts import ImageCounts
from vapor.reporting.html.page import Page, write_page
from vapor.reporting.output_process import DISCARDED
from vapor.reporting.pictures import write_pictures
from vapor.reporting.record import RunRecord
from vapor.reporting.rerun_place import Place
from vapor.reporting.rerun_recording import load_rerun
from vapor.reporting.run_outputs import RunOutputs
from vapor.tracking.loop import Baselines, Step
from vapor.tracking.methods import start_baselines


class Calls:
    """What the process can be asked to do, for one run at a time."""

    def __init__(self) -> None:
        self._outputs: RunOutputs | None = None

    def begin(
        self,
        settings: LocalizerConfig,
        seed: int,
        directory: Path,
        recording: bool,
        view: bool,
        particles: int,
        place: Place | None,
    ) -> None:
        """Begin a run, see `RunOutputs`; the baselines begin with these settings of the filter, and this seed."""
        baselines = Baselines(start_baselines(settings, lambda: np.random.default_rng(seed)))
        self._outputs = RunOutputs(
            baselines, directory, recording=recording, view=view, particles=particles, place=place
        )

    def add(self, frame: Frame, step: Step) -> None:
        """Write and show one image; nothing after an error."""
        if self._outputs is not None:
            self._outputs.add(frame, step)

    def finish(self, skipped: Mapping[str, int], images: ImageCounts, at_end: Mapping[str, Poses]) -> RunRecord:
        """Complete the files of a run, and give its record."""
        assert self._outputs is not None
        outputs, self._outputs = self._outputs, None
        with outputs:
            return outputs.record(skipped=skipped, images=images, at_end=at_end)

    def discard(self) -> str:
        """Remove the files of a run that will not be finished."""
        if self._outputs is not None:
            outputs, self._outputs = self._outputs, None
            error = VaporTrackError("the run failed")
            with suppress(VaporTrackError, OSError):
                outputs.__exit__(type(error), error, None)
        return DISCARDED

    def pictures(self, record: RunRecord, directory: Path, title: str) -> list[Path]:
        """Draw the pictures of a run, see `write_pictures`."""
        return write_pictures(record, directory, title=title)

    def page(self, path: Path, page: Page) -> None:
        """Write a page, see `write_page`."""
        write_page(path, page)


class WithoutPandas(MetaPathFinder):
    """Says that there is no pandas: where there is, pyarrow would load it, and Rerun has no use for it."""

    def find_spec(self, fullname: str, *_: object) -> None:
        """Refuse pandas; others look for the rest."""
        if fullname == "pandas":
            raise ModuleNotFoundError(fullname)


def serve() -> None:
    """Take calls until there are no more."""
    source, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)  # a viewer that outlives this process does not hold the pipe open
    os.dup2(2, 1)  # what others print is no answer
    sys.meta_path.insert(0, WithoutPandas())
    load_rerun()  # while nobody waits for it, as what follows
    import matplotlib.backends.backend_agg
    import matplotlib.figure  # noqa: F401

    calls = Calls()
    with suppress(EOFError, pickle.UnpicklingError, BrokenPipeError):  # the other process has no more calls, or is gone
        _serve(calls, source, answers)
    calls.discard()
    os._exit(0)  # at once: nothing is left to be done


def _serve(calls: Calls, source: BinaryIO, answers: BinaryIO) -> None:
    while True:
        name, arguments, is_asked = pickle.load(source)
        try:
            answer = getattr(calls, name)(*arguments)
        except Exception as error:
            calls.discard()
            known = isinstance(error, (VaporTrackError, OSError, MemoryError))
            traced = f"in the process that writes the results:\n{traceback.format_exc()}"
            answer, is_asked = error if known else RuntimeError(traced), True
        if is_asked:
            answers.write(pickle.dumps(answer, pickle.HIGHEST_PROTOCOL))
            answers.flush()
