"""Calibration of a network on held-out images: kernel widths, how its posteriors err, and the odometry of its scene."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import torch

from filtering.se3 import Poses
from vapor.calibration.change import Change
from vapor.calibration.familiarity import EXEMPLARS, extract_features
from vapor.calibration.image_errors import LEAST_IMAGES, fit_errors
from vapor.calibration.kernel_widths import fit_widths
from vapor.calibration.observations import Observations
from vapor.calibration.odometry import fit_first_odometry
from vapor.calibration.travel import Travel
from vapor.checkpoints.calibration import Calibration
from vapor.checkpoints.scene_scale import spaced
from vapor.evaluation.validation import predict
from vapor.regressors.base import PoseRegressor
from vapor.regressors.familiarity import Familiarity
from vapor.threads import limited_threads
from vapor.training_data.ground import pass_numbers, some_runs
from vapor.training_data.training_set import TrainingSet

NUM_SAMPLES = 1000  # an image, as in use: fewer want wider kernels

Advance = Callable[[int, int], None]


@dataclass(frozen=True)
class CalibrationResult:
    """A calibration and where it comes from.

    Attributes:
        calibration: The values.
        changes: One for each fit.
        images: Held-out images that they are fitted on; 0 where there were too few.
        effective_images: How many independent images are worth as much.
        coverage: Fraction of these images whose true pose lies in the 50, 90 and 95 % region of the place in which it
            is likeliest; None where nothing was fitted.
        odometry: Where the noise of the odometry was found: "held-out data", "training data" or "none".
        notes: What was kept, and why.
        skipped: Images and poses of the data that were left out in reading, by reason.
        notices: What a person should know of the model's file and of the data.
    """

    calibration: Calibration
    changes: tuple[Change, ...] = ()
    images: int = 0
    effective_images: float = 0.0
    coverage: tuple[float, float, float] | None = None
    odometry: str = "none"
    notes: tuple[str, ...] = ()
    skipped: Mapping[str, int] = field(default_factory=dict)
    notices: tuple[str, ...] = ()

    @property
    def provenance(self) -> dict[str, Any]:
        """JSON for the model file: all but the values themselves and what was left out."""
        return {key: value for key, value in asdict(self).items() if key not in ("calibration", "skipped", "notices")}


def calibrate(
    network: PoseRegressor,
    held_out: TrainingSet,
    prior_poses: Poses,
    calibration: Calibration,
    *,
    training: TrainingSet | None = None,
    familiarity: Familiarity | None = None,
    same_conditions: bool = False,
    max_images: int,
    seed: int,
    advance: Advance = lambda done, total: None,
) -> CalibrationResult:
    """Fit kernel widths and how posteriors err, and the noise of odometry where true poses come with some.

    Args:
        network: With its final weights.
        held_out: Images that it was not trained on, in order of time.
        prior_poses: Of the model, (n,): they outline the scene.
        calibration: Values to start from, and to keep where there is too little data.
        training: Data that it was trained on: their odometry is used where the held-out data have too little of it.
        familiarity: What is familiar to it: unfamiliar images err more, as held-out and trained ones tell together.
        same_conditions: Whether held-out images are of the hours, the light and the seasons of use: mistakes about the
            place then last as long as on them; else they are taken to last longer.
        max_images: At most so many images are used; of the odometry all.
        seed: Of latent noise.
        advance: Called with the number of images seen by the network and of all.
    """
    odometry, source = fit_first_odometry({"held-out data": held_out, "training data": training})
    calibration = replace(calibration, odometry=odometry or calibration.odometry)
    if len(held_out) < LEAST_IMAGES:
        note = (
            f"{len(held_out)} held-out images, at least {LEAST_IMAGES} are needed: errors of images kept as they were"
        )
        return CalibrationResult(calibration, odometry=source, notes=(note,))
    chosen = some_runs(len(held_out), max(max_images, LEAST_IMAGES))
    observed = [held_out.select(chosen)]
    if training is not None and familiarity is not None and network.memory is None:  # which errs on no image of it
        exemplars = spaced(len(training), EXEMPLARS)
        observed.append(training.select(exemplars[spaced(len(exemplars), len(chosen))]))
    total, done, found = sum(len(images) for images in observed), 0, []
    for images in observed:
        samples = []
        for poses in predict(network, images, NUM_SAMPLES, seed):
            samples.append(poses)
            advance(done + len(samples), total)
        done += len(samples)
        score = familiarity.unfamiliarity(extract_features(network, images)) if familiarity is not None else None
        found.append(Observations(samples, images.poses, score))
    samples, truth = found[0].samples, found[0].truth
    travel = Travel.along(held_out.poses, pass_numbers(held_out))[chosen]
    scene = Poses.concatenate([prior_poses, truth])
    with limited_threads(torch.get_num_threads()):
        before = calibration.bandwidth_translation_m, calibration.bandwidth_rotation_rad
        widths, wider = fit_widths(samples, truth, scene, before)
        trained = found[1] if len(found) > 1 else None
        fit = fit_errors(found[0], travel, scene, calibration.errors, trained=trained, same_conditions=same_conditions)
    return CalibrationResult(
        Calibration(*widths, fit.errors, calibration.odometry),
        (wider, *fit.changes),
        len(chosen),
        fit.effective_images,
        fit.coverage,
        source,
    )
