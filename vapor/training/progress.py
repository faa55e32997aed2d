"""What a training tells on its way, and its result."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

from vapor.calibration.calibrate import CalibrationResult
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.evaluation.validation import Validation
from vapor.training.check_result import TrainingCheck


@dataclass(frozen=True)
class Progress:
    """Where a training stands.

    Attributes:
        stage: "reading" of images, "holding out" of some, "training", "landmarks", "calibrating", "checking" or
            "training on everything".
        done: Images read or held out, steps done since the training's start, interrupted or not, or held-out images
            seen.
        total: Steps or images in all; None while reading.
        epoch: The current epoch, from 1.
        epochs: Of so many.
        loss: Mean training loss of this epoch so far.
        learning_rate: Of the last step.
        seconds: Of training since its start, interrupted or not, reading and evaluation left out.
        left_s: Of training still to come, about.
        validation: Figures of the last epoch that was evaluated.
        best: Figures of the best epoch.
        notes: What was held out and why, told once before the first step.
    """

    stage: Literal[
        "reading", "holding out", "training", "landmarks", "calibrating", "checking", "training on everything"
    ]
    done: int
    total: int | None = None
    epoch: int = 0
    epochs: int = 0
    loss: float | None = None
    learning_rate: float | None = None
    seconds: float = 0.0
    left_s: float = 0.0
    validation: Validation | None = None
    best: Validation | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class TrainResult:
    """A finished training.

    Attributes:
        checkpoint: The model that was written.
        history: Figures of every epoch that was evaluated.
        best: Figures of the epoch that was kept; None without held-out images.
        seconds: Of training since its start, interrupted or not, reading and evaluation left out.
        images_seen: Likewise.
        calibration: What was calibrated at the end, and what that gained; None where it was not asked for.
        check: The filter on the held-out passes; None without any, or without odometry through them.
        skipped: Images and poses of all data that were left out in reading, by reason.
        notices: What a person should know of the data.
    """

    checkpoint: Checkpoint
    history: tuple[Validation, ...]
    best: Validation | None
    seconds: float
    images_seen: int
    calibration: CalibrationResult | None = None
    check: TrainingCheck | None = None
    skipped: Mapping[str, int] = field(default_factory=dict)
    notices: tuple[str, ...] = ()


ProgressCallback = Callable[[Progress], None]
