"""Outputs of every image after the filter: baselines, `estimate.mcap`, `modes.csv`, the Rerun viewer, the record."""

from __future__ import annotations

import resource
import sys
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from pathlib import Path

import numpy as np
from jaxtyping import Int64

from filtering.errors import VaporTrackError
from sequences.atomic import atomic_output
from sequences.errors import SequenceError
from sequences.frame import Frame
from sequences.reading.counts import ImageCounts
from sequences.recordings.estimate_messages import EstimateWriter
from vapor.reporting.modes_file import COLUMNS, write_modes
from vapor.reporting.record import RunRecord, RunRecorder
from vapor.reporting.rerun_place import Place
from vapor.reporting.rerun_viewer import RerunViewer
from vapor.tracking.hindsight import LookBack
from vapor.tracking.loop import Step


class RunOutputs:
    """Writes and shows a run image by image; used in a `with` block, so that an error leaves nothing half-written.

    `estimate.mcap`, `modes.csv`, and `recording.rrd` if asked for, go into the directory; `view` opens the Rerun
    viewer.

    Raises:
        SequenceError: the folder is missing or cannot be written to.
        VaporTrackError: the viewer cannot be started.
    """

    def __init__(self, directory: Path, *, recording: bool, view: bool, place: Place | None = None) -> None:
        self._recorder = RunRecorder()
        with ExitStack() as block:
            path = directory / "recording.rrd" if recording else None
            viewer = RerunViewer(path, spawn=view, place=place) if recording or view else None
            self._viewer = None if viewer is None else block.enter_context(viewer)
            self._writer = block.enter_context(EstimateWriter(directory / "estimate.mcap"))
            partial = block.enter_context(atomic_output(directory / "modes.csv"))
            self._modes = block.enter_context(open(partial, "w", encoding="ascii"))
            self._modes.write(f"{COLUMNS}\n")
            self._block = block.pop_all()

    def __enter__(self) -> RunOutputs:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: object) -> None:
        if error is not None:  # of the loop: a writer would state an OSError as its own
            error = VaporTrackError("the run failed")
        self._block.__exit__(error and type(error), error, None)

    def add(self, frame: Frame, step: Step) -> None:
        """Write and show one image.

        Raises:
            SequenceError, VaporTrackError: it, or an earlier step, cannot be written.
        """
        estimate = step.estimate
        self._recorder.add(frame, step)
        try:
            write_modes(self._modes, frame.time_ns, estimate.modes)
        except OSError as error:
            raise SequenceError(f"{self._modes.name}: cannot write: {error.strerror or error}") from error
        modes = [(mode.world_from_camera, mode.covariance, mode.weight) for mode in estimate.modes]
        try:
            self._writer.write(frame.time_ns, modes, estimate.shown)
        except OSError as error:
            raise SequenceError(f"{self._writer.path}: cannot write: {error.strerror or error}") from error
        if self._viewer is not None:
            self._viewer.log(frame, estimate, step.observation.posterior.samples)

    @property
    def times_ns(self) -> Int64[np.ndarray, " n"]:
        """Stamps of the images so far, (n,)."""
        return self._recorder.times_ns

    def record(
        self, *, skipped: Mapping[str, int], images: ImageCounts, look_back: LookBack | None = None
    ) -> RunRecord:
        """The record of all images, with the peak memory of this process and the run in hindsight, which is written.

        Raises:
            SequenceError, VaporTrackError: it cannot be written.
        """
        record = self._recorder.finish(skipped=skipped, images=images, peak_rss_mb=_peak_rss_mb())
        if look_back is not None:
            record = record.in_hindsight(look_back)
            for name, trajectory in look_back.trajectories.items():
                try:
                    self._writer.write_trajectory(name, record.times_ns, trajectory.poses, trajectory.covariance)
                except OSError as error:
                    raise SequenceError(f"{self._writer.path}: cannot write: {error.strerror or error}") from error
        if self._viewer is not None:
            self._viewer.log_at_end(record.methods, record.truth)
        return record


def _peak_rss_mb() -> float:
    with suppress(OSError), open("/proc/self/status", encoding="ascii") as status:
        for line in status:  # getrusage includes the process that started this one
            if line.startswith("VmHWM:"):
                return float(line.split()[1]) / 2**10
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if sys.platform == "darwin" else 2**10)
