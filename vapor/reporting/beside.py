"""What a run leaves behind, written and drawn beside it: in the process of `output_process`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from filtering.config import LocalizerConfig
from filtering.se3 import Poses
from filtering.unchecked import unchecked_replace
from sequences.frame import Frame
from sequences.reading.counts import ImageCounts
from vapor.reporting.html.page import Page
from vapor.reporting.output_process import OutputProcess, output_process
from vapor.reporting.peak_memory import peak_rss_mb
from vapor.reporting.record import RunRecord
from vapor.reporting.rerun_place import Place
from vapor.tracking.loop import Step


class OutputsBeside:
    """A `RunOutputs` in another process: what is written there does not keep the loop waiting.

    An error of what was added comes with a later image, or with the record.
    """

    def __init__(self, process: OutputProcess) -> None:
        self._process = process

    def add(self, frame: Frame, step: Step) -> None:
        """See `RunOutputs.add`."""
        # Nothing written tells of the map, which is as large as a thousand images' posteriors.
        posterior = unchecked_replace(step.posterior, mapped=None)
        self._process.send("add", frame, replace(step, posterior=posterior))

    def finish(
        self, *, skipped: Mapping[str, int], images: ImageCounts, at_end: Mapping[str, Poses] | None = None
    ) -> RunRecord:
        """Complete the files; gives the record, with the peak memory of this process and the other one in all.

        Args:
            skipped: See `RunOutputs.record`, like the others.
            images: What became of the images that the sequence states.
            at_end: Poses of the methods that see the whole run at once.
        """
        record: RunRecord = self._process.ask("finish", skipped, images, at_end or {})
        return replace(record, peak_rss_mb=(record.peak_rss_mb or 0.0) + peak_rss_mb())


@contextmanager
def outputs_beside(
    directory: Path,
    settings: LocalizerConfig,
    *,
    seed: int,
    recording: bool,
    view: bool,
    particles: int,
    place: Place | None = None,
) -> Iterator[OutputsBeside]:
    """The outputs of a run for a `with` block; what is not finished by its end is removed.

    Args:
        directory: See `RunOutputs`, like the others.
        settings: Of the filter, for the baselines.
        seed: For the baselines.
        recording: Whether to write `recording.rrd`.
        view: Whether to open the Rerun viewer.
        particles: How many particles of each image go into `estimate.mcap`.
        place: Where the run happens, for the viewer.
    """
    with output_process() as process:
        process.send("begin", settings, seed, directory, recording, view, particles, place)
        yield OutputsBeside(process)


def write_pictures(record: RunRecord, directory: Path, *, title: str) -> list[Path]:
    """See `vapor.reporting.pictures.write_pictures`."""
    with output_process() as process:
        return process.ask("pictures", record, directory, title)


def write_page(path: Path, page: Page) -> None:
    """See `vapor.reporting.html.page.write_page`."""
    with output_process() as process:
        process.ask("page", path, page)
