"""Held-out images by the landmarks that the images show on which the network was trained."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool

from filtering.mapped_views import MappedViews
from filtering.se3 import Poses
from vapor.calibration.calibrate import NUM_SAMPLES
from vapor.calibration.error_correlation import ErrorCorrelation, Travel, effective_images, mistaken_lengths
from vapor.calibration.familiarity import extract_features
from vapor.calibration.verification import SeenPlaces, evidence, fit_verification, none_right
from vapor.checkpoints.calibration import Calibration
from vapor.checkpoints.thinning import spaced
from vapor.evaluation.validation import predict
from vapor.landmarks.localize import LandmarkLocalizer, VerifiedPose
from vapor.landmarks.verify import Verification
from vapor.regressors.base import PoseRegressor
from vapor.regressors.familiarity import Familiarity
from vapor.tracking.follow import posterior_of
from vapor.training.config import TrainConfig
from vapor.training.holding_out import Split
from vapor.training.landmarks import FoundLandmarks
from vapor.training_data.passes import pass_numbers
from vapor.training_data.training_set import TrainingSet

_IMAGES = 200
_NEAR = 0.25, 0.2  # depths and radians: a verified pose so near to the true one is of the right place
_NONE_RIGHT = 0.05  # where nothing was held out
_NEW_VIEW = 0.5  # depths: a view that differs by less shows the same landmarks
_AROUND = 1.5  # depths or radians: what key images further away show is not looked for


@dataclass(frozen=True)
class HeldOutLandmarks:
    """What verifies held-out images.

    Attributes:
        localizer: By what trained images show.
        hidden: Poses of the key images that it lacks, (h,).
        verification: What it says of a place that landmarks verify it.
        none_right: Probability that none of the verified places of an image is the right one.
        mistaken_lengths: Over how many lengths of their errors verified places are mistaken for others.
    """

    localizer: LandmarkLocalizer
    hidden: Poses
    verification: Verification
    none_right: float = _NONE_RIGHT
    mistaken_lengths: float = 4.0

    @cached_property
    def mapped(self) -> MappedViews:
        """Where it can verify places."""
        return self.localizer.mapped(self.verification.reach, self.verification.elsewhere)

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
        localizer, hidden = landmarks.without(split.training)
        held = HeldOutLandmarks(localizer, hidden, landmarks.verification)
        rows = np.flatnonzero(split.held_out_mask)
        rows = rows[spaced(len(rows), _IMAGES)]
        if not len(rows):
            return held
        some = split.source.select(rows)
        scores = familiarity.unfamiliarity(extract_features(network, some)) if familiarity else np.zeros(len(rows))
        seen, which, depth_m = [], [], landmarks.built.material.depth_m
        for row, samples, score in zip(rows, predict(network, some, NUM_SAMPLES, config.seed), scores, strict=True):
            posterior = posterior_of(samples, calibration.errors, float(score))
            found = held.found(split.source, int(row), posterior.means[np.argsort(-posterior.weights, kind="stable")])
            if found:
                which.append(int(row))
                truth = split.source.poses[int(row)]
                seen.append(SeenPlaces.of(posterior, found, truth, near_m=_NEAR[0] * depth_m, near_rad=_NEAR[1]))
        if not seen:
            return held
        errors, own = calibration.errors, landmarks.verified.errors
        longer = max(errors.mistaken_lengths, 1.0)
        lasting = ErrorCorrelation(1.0, longer * errors.length_m, longer * errors.length_rad)
        travel = Travel.along(split.source.poses, pass_numbers(split.source))[np.array(which)]
        effective = effective_images(travel, lasting)
        verification, wrong = fit_verification(seen, effective, landmarks.verification), none_right(seen, effective)
        said = evidence(seen, verification, wrong, errors.possible_fraction)
        lengths = ErrorCorrelation(1.0, own.length_m, own.length_rad)
        mistaken = max(mistaken_lengths(said, travel, lengths), _NEW_VIEW * depth_m / own.length_m)
        return replace(held, verification=verification, none_right=wrong, mistaken_lengths=mistaken)

    def found(self, images: TrainingSet, row: int, proposed: Poses | None = None) -> list[VerifiedPose]:
        """The poses that landmarks verify of an image, which is as new to the map wherever it looks alike.

        Key images are hidden around the true pose. So that places which look alike have no advantage, the like are
        ignored there: in use, an image is new everywhere.
        """
        if not len(images.views):
            return []
        localizer, truth = self.localizer, images.poses[row]
        features = localizer.features(images.views[images.rows[row]])
        found = localizer.localize(features, proposed)
        ignored = np.zeros(len(localizer.landmarks.poses), bool)
        for each in found:
            ignored |= self._counterparts(each.world_from_camera, truth)
        return localizer.ignoring(ignored).localize(features, proposed) if ignored.any() else found

    def _counterparts(self, found: Poses, truth: Poses) -> Bool[np.ndarray, " n"]:
        """Key images around a pose that are there what hidden ones are around the true one: none if that is near."""
        localizer, depth_m = self.localizer, self.localizer.landmarks.depth_m
        ignored = np.zeros(len(localizer.landmarks.poses), bool)
        metres, radians = map(float, found.distance(truth))
        if not len(self.hidden) or (metres < _NEAR[0] * depth_m and radians < _NEAR[1]):
            return ignored
        around = np.flatnonzero(localizer.view_distances(found) < _AROUND)
        moved = (truth @ found.inverse()) @ localizer.landmarks.poses[around]
        views = (MappedViews(others, depth_m, 1.0, 0.0) for others in (self.hidden, localizer.landmarks.poses))
        apart = [each.distances(moved) for each in views]
        ignored[around] = apart[0] < apart[1]
        return ignored
