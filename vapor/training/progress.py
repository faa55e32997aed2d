"""Progress of a training, its result, and the check of the new model."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

from vapor.calibration.calibrate import CalibrationResult
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.evaluation.validation import Validation

_WORSE_RIGHT, _WORSE_MEDIAN = 0.02, 1.1  # than the single image: fraction of the images, and times the median error
_LEAST_COVERAGE = 0.8  # of the 95 % region
_HARDLY, _FEW, _SCALE = 0.2, 10.0, 0.1


@dataclass(frozen=True)
class Progress:
    """Progress of a training.

    Attributes:
        stage: Present stage.
        done: Number of images or steps of this stage done; steps count from the first start of an interrupted training.
        total: Steps or images of this stage; None while reading.
        epoch: The current epoch of this stage, from 1.
        epochs: Epochs of this stage.
        loss: Mean training loss of this epoch so far.
        validation: Figures of the last epoch that was evaluated; None in the training on everything, of which none is.
        notes: The choice of held-out images with its reasons, once before the first step.
        left_s: Seconds that this stage's epochs left will take, by the time of some first steps and of the epochs so
            far; once before the first epoch, too. None where it is not known: the number of epochs was given, or a
            training goes on.
    """

    stage: Literal[
        "reading",
        "holding out",
        "training",
        "landmarks",
        "localizing by landmarks",
        "calibrating",
        "checking",
        "training on everything",
    ]
    done: int
    total: int | None = None
    epoch: int = 0
    epochs: int = 0
    loss: float | None = None
    validation: Validation | None = None
    notes: tuple[str, ...] = ()
    left_s: float | None = None


@dataclass(frozen=True)
class TrainResult:
    """A finished training.

    Attributes:
        checkpoint: The model that was written.
        history: Figures of every epoch that was evaluated.
        best: Figures of the epoch that was kept; None without held-out images.
        seconds: Duration of all epochs, without reading and evaluation; the time before an interruption counts.
        images_seen: Number of images in all epochs.
        calibration: Calibration at the end; None where it was not configured.
        check: The filter on the held-out passes; None without such passes, or without odometry through them.
        skipped: Number of images and poses that were skipped in reading, by reason.
        notices: Facts about the data for the user.
        evaluated: Number of held-out images that `best` is of.
        evidence: What these images are of, and so what figures on them are worth.
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
    evaluated: int = 0
    evidence: str = ""


ProgressCallback = Callable[[Progress], None]


@dataclass(frozen=True)
class Figures:
    """Median errors of a method, and the fraction of images that it has within 0.3 m and 20°."""

    median_m: float
    median_deg: float
    right: float


@dataclass(frozen=True)
class TrainingCheck:
    """Filter and single image over the held-out passes that errors were fitted on.

    Attributes:
        images: Images evaluated.
        passes: Passes, in each of which the filter starts with an empty belief.
        methods: Figures by the names of `METHODS`.
        converged: Fraction of the images with status converged.
        wrong: Fraction of the converged images beyond 0.3 m or 20°; None where no image is converged.
        coverage: Fraction of the converged images in the filter's 50, 90 and 95 % regions, by name; None where fewer
            than 50 images are converged.
        inflation: Factor by which the fitted variances of images were too small.
        assumed: Whether errors in proportion to the scene replace the fitted ones, which did worse.
        verdict: A sentence that compares the filter with the single image, with the likely cause where it is worse.
    """

    images: int
    passes: int
    methods: Mapping[str, Figures]
    converged: float
    wrong: float | None
    coverage: Mapping[str, float] | None
    inflation: float = 1.0
    assumed: bool = False
    verdict: str = ""

    @property
    def worse(self) -> bool:
        """Whether the filter is worse than the single image."""
        single, ours = self.methods["single_image"], self.methods["filter"]
        return ours.right < single.right - _WORSE_RIGHT or ours.median_m > _WORSE_MEDIAN * single.median_m

    @property
    def overconfident(self) -> bool:
        """Whether the filter's regions hold too few true poses."""
        return self.coverage is not None and self.coverage["95%"] < _LEAST_COVERAGE

    @property
    def rank(self) -> tuple[bool, float, bool]:
        """The check with the greatest rank is kept, of equal ones the first.

        Overconfidence counts most. By how much a filter is worse is luck: it depends on the wrong place where it stays.
        """
        held = 1.0
        if self.overconfident and self.coverage is not None:
            held = self.coverage["95%"]
        return not self.overconfident, held, not self.worse


def verdict(found: TrainingCheck, result: CalibrationResult) -> str:
    """A sentence on a check, given the calibration before it."""
    single, ours = found.methods["single_image"], found.methods["filter"]
    text = f"right in {100 * ours.right:.0f} % of {found.images} held-out images, the single image in"
    text = f"the filter is {text} {100 * single.right:.0f} %"
    if found.inflation > 1.0:
        text += f"; variances of images are taken {found.inflation:.0f} times as large as they were found"
    if found.assumed:
        text += "; errors of images are assumed, as those found did worse"
    if not (found.worse or found.overconfident):
        return text
    fault = "it is worse than the single image" if found.worse else "it is overconfident"
    return f"{text}. Beware: {fault}; likely {_cause(found, result)}"


def _cause(found: TrainingCheck, result: CalibrationResult) -> str:
    odometry = result.calibration.odometry
    if found.methods["single_image"].right < _HARDLY:
        return "because the network hardly knows the place: record more of it, or train for longer"
    if odometry is not None and abs(odometry.scale) > _SCALE:
        return (
            f"because odometry and true poses disagree ({100 * odometry.scale:+.0f} % in distance): check extrinsics"
            " and stamps"
        )
    if 0.0 < result.effective_images < _FEW:
        return (
            f"because the held-out images are worth only {result.effective_images:.0f} independent ones: record another"
            " pass"
        )
    return "because errors last longer than any held-out pass shows: record passes on another day or in other light"
