"""The model file at the end of a training: calibration and check on held-out images, and provenance."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any, Literal

from filtering.measurement_noise import MeasurementNoise
from filtering.se3 import Poses
from vapor.calibration.calibrate import CalibrationResult, calibrate
from vapor.calibration.ood_model import EXEMPLARS, learn_ood_model
from vapor.checkpoints.calibration import Calibration
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.checkpoints.scene_scale import MAX_PRIOR_POSES, default_errors, spaced
from vapor.evaluation.validation import predict
from vapor.landmarks.verify import Landmarks
from vapor.regressors.base import PoseRegressor
from vapor.regressors.ood_model import OodModel
from vapor.training.check import check
from vapor.training.config import TrainConfig
from vapor.training.holding_out import Split
from vapor.training.landmarks import FoundLandmarks, HeldOutLandmarks
from vapor.training.progress import TrainingCheck
from vapor.training.trainer import weights_of
from vapor.training_data.training_set import TrainingSet


@dataclass(frozen=True)
class HeldOutFindings:
    """Results on held-out images, and the landmarks of all images.

    `calibrated` is None where calibration was not configured, `check` without held-out passes with odometry.
    """

    calibration: Calibration
    calibrated: CalibrationResult | None = None
    check: TrainingCheck | None = None
    landmarks: Landmarks | None = None

    @property
    def provenance(self) -> dict[str, Any]:
        """JSON for the model file."""
        if self.calibrated is None:
            return {}
        return {"calibration": self.calibrated.provenance, "check": asdict(self.check) if self.check else None}


def calibrate_and_check(
    model: PoseRegressor,
    split: Split,
    config: TrainConfig,
    landmarks: FoundLandmarks | None,
    advance: Callable[[Literal["calibrating", "checking"], int, int], None],
) -> HeldOutFindings:
    """Calibrate a model on held-out images where that is configured, and run the filter over them.

    Args:
        model: The network with its final weights.
        split: The held-out images.
        config: Configuration of the training.
        landmarks: Landmarks of all images, if any.
        advance: Called with the stage, the number of images done and of all.
    """
    prior_poses = _prior_poses(model, split.training, config.seed)
    widths = config.bandwidth_translation_m, config.bandwidth_rotation_rad
    calibration = Calibration(*widths, default_errors(prior_poses))
    if not config.calibrate:
        if landmarks is None:
            return HeldOutFindings(calibration)
        of_everything = Landmarks(landmarks.built.landmarks, landmarks.verification)
        return HeldOutFindings(_with_verified(calibration, landmarks.verified.noise), landmarks=of_everything)
    ood_model = _ood_model(model, split, config)
    calibrated = calibrate(
        model,
        split.held_out,
        prior_poses,
        calibration,
        training=split.training,
        ood_model=ood_model,
        max_images=config.validation_images,
        seed=config.seed,
        advance=partial(advance, "calibrating"),
    )
    held = None
    if landmarks is not None:
        verified = landmarks.verified.noise
        calibration = _with_verified(calibrated.calibration, verified)
        held = HeldOutLandmarks.of(landmarks, model, split, calibration, prior_poses, ood_model, config)
        verified = replace(verified, outlier_probability=held.none_right, outlier_lengths=held.outlier_lengths)
        calibrated = replace(calibrated, calibration=_with_verified(calibration, verified))
    checked, calibration = check(
        model,
        split.source,
        split.held_out_mask,
        calibrated,
        ood_model,
        prior_poses,
        held,
        seed=config.seed,
        advance=partial(advance, "checking"),
    )
    of_everything = None
    if landmarks is not None and held is not None:
        of_everything = Landmarks(landmarks.built.landmarks, held.verification)
    return HeldOutFindings(calibration, calibrated, checked, of_everything)


def _with_verified(calibration: Calibration, verified: MeasurementNoise) -> Calibration:
    return replace(calibration, errors=replace(calibration.errors, verified=verified))


def model_checkpoint(
    model: PoseRegressor,
    learned: TrainingSet,
    split: Split,
    found: HeldOutFindings,
    config: TrainConfig,
    provenance: Mapping[str, Any],
) -> Checkpoint:
    """A finished model that learned from some images, ready to be written, with its provenance as JSON."""
    ood_model = _ood_model(model, split, config) if config.calibrate else None
    return Checkpoint(
        config.network,
        model.box,
        found.calibration,
        _prior_poses(model, learned, config.seed),
        weights_of(model),
        model.memory.cpu() if model.memory else None,
        training=json.loads(json.dumps({**provenance, "cameras": learned.cameras, **found.provenance})),
        ood_model=ood_model,
        camera=split.training.camera,
        landmarks=found.landmarks,
    )


def _ood_model(model: PoseRegressor, split: Split, config: TrainConfig) -> OodModel | None:
    training = split.training.select(spaced(len(split.training), EXEMPLARS))
    return learn_ood_model(model, training, split.evaluated(config.validation_images))


def _prior_poses(model: PoseRegressor, images: TrainingSet, seed: int) -> Poses:
    """A posterior sample of each of n evenly spaced images, world_from_camera, (n,)."""
    return Poses.concatenate(list(predict(model, images.select(spaced(len(images), MAX_PRIOR_POSES)), 1, seed)))
