"""Held-out images by the landmarks that the images show on which the network was trained."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from filtering.se3 import Poses
from vapor.calibration.calibrate import NUM_SAMPLES
from vapor.calibration.familiarity import extract_features
from vapor.calibration.lasting_errors import LastingErrors, effective_images
from vapor.calibration.travel import Travel
from vapor.calibration.verification import SeenPlaces, fit_verification
from vapor.checkpoints.calibration import Calibration
from vapor.checkpoints.thinning import spaced
from vapor.evaluation.validation import predict
from vapor.landmarks.localize import LandmarkLocalizer, VerifiedPose
from vapor.landmarks.verify import Verification
from vapor.regressors.base import PoseRegressor
from vapor.regressors.familiarity import Familiarity
from vapor.tracking.passage import posterior_of
from vapor.training.config import TrainConfig
from vapor.training.holding_out import Split
from vapor.training.landmarks import FoundLandmarks
from vapor.training_data.passes import pass_numbers
from vapor.training_data.training_set import TrainingSet

_IMAGES = 200
_NEAR = 0.25, 0.2  # depths and radians: a verified pose so near to the true one is of the right place


@dataclass(frozen=True)
class HeldOutLandmarks:
    """What verifies held-out images.

    Attributes:
        localizer: By what trained images show.
        verification: What it says of a place that landmarks verify it.
    """

    localizer: LandmarkLocalizer
    verification: Verification

    @staticmethod
    def of(
        landmarks: FoundLandmarks,
        network: PoseRegressor,
        split: Split,
        calibration: Calibration,
        familiarity: Familiarity | None,
        config: TrainConfig,
    ) -> HeldOutLandmarks:
        """Find on the held-out images what a verified place is worth."""
        held = HeldOutLandmarks(landmarks.without(split.training), Verification())
        rows = np.flatnonzero(split.held_out_mask)
        rows = rows[spaced(len(rows), _IMAGES)]
        if not len(rows):
            return held
        some = split.source.select(rows)
        scores = familiarity.unfamiliarity(extract_features(network, some)) if familiarity else np.zeros(len(rows))
        seen, depth_m = [], landmarks.built.material.depth_m
        for row, samples, score in zip(rows, predict(network, some, NUM_SAMPLES, config.seed), scores, strict=True):
            posterior = posterior_of(samples, calibration.errors, float(score))
            found = held.found(split.source, int(row), posterior.means[np.argsort(-posterior.weights, kind="stable")])
            if found:
                truth = split.source.poses[int(row)]
                seen.append(SeenPlaces.of(posterior, found, truth, near_m=_NEAR[0] * depth_m, near_rad=_NEAR[1]))
        errors = calibration.errors
        longer = max(errors.mistaken_lengths, 1.0)
        lasting = LastingErrors(1.0, longer * errors.length_m, longer * errors.length_rad)
        travel = Travel.along(split.source.poses, pass_numbers(split.source))[rows]
        return HeldOutLandmarks(held.localizer, fit_verification(seen, effective_images(travel, lasting)))

    def found(self, images: TrainingSet, row: int, proposed: Poses | None = None) -> list[VerifiedPose]:
        """The poses that landmarks verify of an image."""
        if not len(images.views):
            return []
        return self.localizer.localize(self.localizer.features(images.views[images.rows[row]]), proposed)
