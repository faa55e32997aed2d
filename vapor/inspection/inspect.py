"""The whole inspection of recordings, which are read once, with a verdict."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from filtering.posterior import ObservationModel
from sequences.frame import Frame
from sequences.options import SequenceOptions
from vapor.inspection.camera import CameraCheck, CameraViews, usual_of
from vapor.inspection.clocks import ImageClock
from vapor.inspection.coverage import Coverage
from vapor.inspection.odometry import OdometryCheck, check_odometry
from vapor.inspection.predictions import Prediction, Predictions
from vapor.inspection.reading import posed_images, read_walks
from vapor.inspection.verdict import Verdict, verdict
from vapor.inspection.walk import Walk
from vapor.observation import VaporObservationModel
from vapor.pipeline.unrecognised import MOST_IMAGES, SeenImage, why_unrecognised
from vapor.reporting.record import EvenlySpaced
from vapor.training_data.checks import too_far

_MOST = 0.5  # of the images


@dataclass(frozen=True)
class Inspection:
    """The findings on recordings, at least one, and notices on their true poses.

    Without true poses there is no coverage, without both them and odometry no comparison of these.
    """

    walks: tuple[Walk, ...]
    coverage: Coverage | None
    odometry: OdometryCheck | None
    clocks: tuple[ImageClock, ...]
    cameras: Mapping[str, CameraCheck]
    predictions: Predictions | None
    notices: tuple[str, ...]
    verdict: Verdict

    @property
    def has_several(self) -> bool:
        """Whether the images are of several cameras, by their names."""
        return len(self.cameras) > 1

    def as_json(self) -> dict[str, Any]:
        """The content of `report.json`."""
        return {
            "walks": [walk.as_json() for walk in self.walks],
            "coverage": None if self.coverage is None else self.coverage.as_json(),
            "odometry": None if self.odometry is None else self.odometry.as_json(),
            "clocks": [asdict(clock) for clock in self.clocks],
            "camera": next(iter(self.cameras.values())).as_json(),
            **(
                {"cameras": {name: check.as_json() for name, check in self.cameras.items()}} if self.has_several else {}
            ),
            "model": None if self.predictions is None else self.predictions.as_json(self.coverage),
            "notices": list(self.notices),
            "verdict": {"answer": self.verdict.answer, **asdict(self.verdict)},
        }


def inspect(
    data: Sequence[Path | str],
    reading: SequenceOptions | None = None,
    *,
    model: ObservationModel | None = None,
    see: Callable[[Frame], None] = lambda frame: None,
    progress: Callable[[str, int, int | None], None] = lambda stage, done, total: None,
) -> Inspection:
    """Inspect recordings.

    Data are `PATH` or `PATH@START:STOP`, as `train` takes them; true poses and odometry may be missing. A model
    observes every image. `see` is called with every frame in order, `progress` with the
    stage, how much of it is done, and of how much.

    Raises:
        TrainingError: no data, a bad range, two entries that share images, or a pose that is not finite.
        SequenceError: data that cannot be read.
    """
    predicted: list[Prediction] = []
    some: EvenlySpaced[SeenImage] = EvenlySpaced(MOST_IMAGES)
    views: dict[str, CameraViews] = {}
    files = ExitStack()  # of the views
    rng, done, row = np.random.default_rng(0), count(1), count()

    def take(frame: Frame) -> None:
        progress("reading images", next(done), None)
        see(frame)
        if frame.camera_name not in views:
            file = files.enter_context(tempfile.TemporaryFile())  # noqa: SIM115 (the stack closes it)
            views[frame.camera_name] = CameraViews(usual, file)
        if frame.world_from_camera is not None:
            views[frame.camera_name].take(frame, next(row))
        if model is not None:
            some.add(lambda: (frame.image, frame.camera))
            predicted.append(Prediction.of(model.observe(frame.image, rng=rng)))

    usual = usual_of(data, reading)
    with files:
        walks = read_walks(data, reading, see=take)
        images = posed_images(walks)
        coverage = odometry = predictions = None
        notices: tuple[str, ...] = ()
        if images is not None:
            progress("comparing the passes", 0, None)
            coverage = Coverage(images)
            progress("comparing odometry with the true poses", 0, None)
            odometry = check_odometry(images)
            notices = tuple(too_far(images.poses))
        cameras = {
            name: each.check(images, lambda done, total: progress("fitting the camera", done, total))
            for name, each in views.items()
        }
    if model is not None:
        posed = np.concatenate([walk.posed for walk in walks])
        predictions = Predictions.of(predicted, images.poses if images is not None else walks[0].poses, posed)
        if predictions.out_of_distribution > _MOST and isinstance(model, VaporObservationModel):
            why = why_unrecognised(some.items, model.ood_score, model.is_verified)
            predictions = replace(predictions, why_out_of_distribution=why)
    clocks = tuple(ImageClock.of(walk) for walk in walks)
    found = verdict(walks, coverage, odometry, clocks, predictions, cameras)
    return Inspection(tuple(walks), coverage, odometry, clocks, cameras, predictions, notices, found)
