"""A new model on its held-out passes: the filter beside the single image, and what is wrong where it is no better."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Int64

from filtering.error_model import ErrorModel
from filtering.localizer import LocalizerConfig
from filtering.motion import Odometry
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from vapor.calibration.calibrate import NUM_SAMPLES, CalibrationResult
from vapor.calibration.familiarity import extract_features
from vapor.checkpoints.calibration import Calibration
from vapor.checkpoints.scene_scale import default_errors
from vapor.evaluation.belief import judge_belief
from vapor.evaluation.trajectory import REGIONS, is_right
from vapor.evaluation.validation import predict
from vapor.regressors.base import PoseRegressor
from vapor.regressors.familiarity import Familiarity
from vapor.tracking.methods import Followed, Passage, follow, posterior_of
from vapor.training_data.training_set import TrainingSet

METHODS = ("single_image", "kalman", "filter", "smoothed")
LEAST_PASS = 20  # images
_MOST_IMAGES = 600
_LEAST_JUDGED = 50
_WORSE_RIGHT, _WORSE_MEDIAN = 0.02, 1.1  # than the single image, in share of the images and times the median error
_LEAST_COVERAGE = 0.8  # of the 95 % region
_WIDER = (2.0, 4.0, 8.0, 16.0)  # variances that are tried
_HARDLY, _FEW, _SCALE = 0.2, 10.0, 0.1


@dataclass(frozen=True)
class Figures:
    """What one method was worth.

    Attributes:
        median_m: Error of position, metres.
        median_deg: Error of rotation, degrees.
        right: Share of the images within 0.3 m and 20°.
    """

    median_m: float
    median_deg: float
    right: float


@dataclass(frozen=True)
class TrainingCheck:
    """Filter and single image over held-out passes, the same that errors were fitted on.

    Attributes:
        images: Judged.
        passes: In so many passes, each begun anew.
        methods: By name, those of `METHODS`.
        converged: Share of the images called converged.
        wrong: Share of these beyond 0.3 m or 20°; None where none is.
        coverage: Share of these in the filter's 50, 90 and 95 % regions, by name; None where they are fewer than 50.
        inflation: Factor by which the variances of images were enlarged, as the fitted ones did not do.
        assumed: Whether errors in proportion to the scene took the place of the fitted ones, as those did not do.
        verdict: A sentence.
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
        """Whether its regions hold too few true poses."""
        return self.coverage is not None and self.coverage["95%"] < _LEAST_COVERAGE

    @property
    def rank(self) -> tuple[bool, float, bool]:
        """Of several the one with the greatest is kept, the first of equals: that it is no surer than it may be comes
        first. Which of two is worse by less says nothing: it is luck which wrong place a filter stays at."""
        held = 1.0
        if self.overconfident and self.coverage is not None:
            held = self.coverage["95%"]
        return not self.overconfident, held, not self.worse

    @property
    def as_json(self) -> dict[str, Any]:
        """For the model file."""
        return asdict(self)


def check(
    network: PoseRegressor,
    images: TrainingSet,
    judged: Bool[np.ndarray, " n"],
    result: CalibrationResult,
    familiarity: Familiarity | None,
    scene: Poses,
    *,
    seed: int,
    advance: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[TrainingCheck | None, Calibration]:
    """Run the filter over held-out passes, and choose errors with which it is no worse than the single image.

    Args:
        network: With its final weights.
        images: Recordings, n images, of which some are held out.
        judged: Those, (n,).
        result: What was calibrated.
        familiarity: What is familiar to the network.
        scene: Poses that outline it.
        seed: Of latent noise and the filter's draws.
        advance: Called with the number of images done and of all.

    Returns:
        The check, None without `LEAST_PASS` images in a row with odometry, and the calibration to keep.
    """
    fitted = result.calibration
    runs = list(_runs(images, judged))
    if not runs:
        return None, fitted
    runs = [(rows[: max(_MOST_IMAGES // len(runs), LEAST_PASS)], odometry) for rows, odometry in runs]
    total, done = sum(len(rows) for rows, _ in runs), 0
    seen: list[tuple[list[Poses], np.ndarray]] = []
    for rows, _ in runs:
        some, samples = images.select(rows), []
        for poses in predict(network, some, NUM_SAMPLES, seed):
            samples.append(poses)
            advance(done + len(samples), total)
        done += len(samples)
        scores = familiarity.unfamiliarity(extract_features(network, some)) if familiarity else np.zeros(len(rows))
        seen.append((samples, scores))

    def tried(errors: ErrorModel) -> list[Followed]:
        fit = fitted.odometry
        config = LocalizerConfig() if fit is None else replace(LocalizerConfig(), slow_errors=fit.slow_errors)
        followed = []
        for (rows, odometry), (samples, scores) in zip(runs, seen, strict=True):

            def posterior(
                image: int, samples: list[Poses] = samples, scores: np.ndarray = scores, errors: ErrorModel = errors
            ) -> PosePosterior:
                return posterior_of(samples[image], errors, float(scores[image]))

            passage = Passage(images.times_ns[rows], odometry[: len(rows)], images.poses[rows], posterior)
            passage = passage.restated(fit)
            rng = np.random.default_rng(seed)
            followed.append(follow(passage, errors, config, rng=rng, gaussian_sum=False))
        return followed

    followed, kept = tried(fitted.errors), fitted.errors
    found = _summed(followed)
    if found.worse or found.overconfident:
        others = [(factor, False, fitted.errors.inflated(factor)) for factor in _WIDER]
        others.append((1.0, True, default_errors(scene)))
        for inflation, assumed, errors in others:
            again = tried(errors)
            other = replace(_summed(again), inflation=inflation, assumed=assumed)
            if other.rank > found.rank:
                found, followed, kept = other, again, errors
            if not (found.worse or found.overconfident):
                break
    smoothed = [each.compared().poses["smoothed"] for each in followed]
    found = replace(found, methods={**found.methods, "smoothed": _figures(followed, smoothed)})
    return replace(found, verdict=_verdict(found, result)), replace(fitted, errors=kept)


def _runs(
    images: TrainingSet, judged: Bool[np.ndarray, " n"]
) -> Iterator[tuple[Int64[np.ndarray, " k"], tuple[Odometry | None, ...]]]:
    """Held-out images that odometry leads through, and the motion to each from the one before."""
    rows: list[int] = []
    motions: list[Odometry | None] = []
    for row in np.flatnonzero(judged).tolist():
        motion = _between(images, rows[-1], row) if rows else None
        if motion is None:
            if len(rows) >= LEAST_PASS:
                yield np.array(rows), tuple(motions)
            rows, motions = [], []
        rows.append(row)
        motions.append(motion)
    if len(rows) >= LEAST_PASS:
        yield np.array(rows), tuple(motions)


def _between(images: TrainingSet, first: int, last: int) -> Odometry | None:
    """Motion from one image to a later one, through those between; None where it is not known."""
    found: Odometry | None = None
    for step in images.odometry[first + 1 : last + 1]:
        if step is None:
            return None
        found = step if found is None else found.then(step)
    return found


def _summed(followed: Sequence[Followed]) -> TrainingCheck:
    """Without smoothing, of which nothing depends."""
    methods = {name: _figures(followed, [each.poses[name] for each in followed]) for name in METHODS[:-1]}
    passages = [each.passage for each in followed]
    said = [
        judge_belief(each.beliefs["filter"], of.times_ns, of.truth, converged_at_s=None, seam=None)["said_converged"]
        for each, of in zip(followed, passages, strict=True)
    ]
    said = [each for each in said if each["images"]]
    images, converged = sum(len(each.times_ns) for each in passages), sum(each["images"] for each in said)

    def share(of: Callable[[Mapping[str, Any]], float]) -> float:
        return sum(each["images"] * of(each) for each in said) / converged

    return TrainingCheck(
        images,
        len(passages),
        methods,
        converged / images,
        share(lambda each: each["wrong"]) if said else None,
        {name: share(lambda each, name=name: each["coverage"][name]) for name in REGIONS}
        if converged >= _LEAST_JUDGED
        else None,
    )


def _figures(followed: Sequence[Followed], poses: Sequence[Poses]) -> Figures:
    """Of the poses that a method found for each passage, (n,)."""
    passages = [(found, each.passage.truth) for found, each in zip(poses, followed, strict=True)]
    apart = [found.distance(truth) for found, truth in passages]
    moved_m, turned = (np.concatenate(part) for part in zip(*apart, strict=True))
    right = np.concatenate([is_right(found, truth) for found, truth in passages])
    return Figures(float(np.median(moved_m)), float(np.degrees(np.median(turned))), float(np.mean(right)))


def _verdict(found: TrainingCheck, result: CalibrationResult) -> str:
    single, ours = found.methods["single_image"], found.methods["filter"]
    told = f"right in {100 * ours.right:.0f} % of {found.images} held-out images, the single image in"
    told = f"the filter is {told} {100 * single.right:.0f} %"
    if found.inflation > 1.0:
        told += f"; variances of images are taken {found.inflation:.0f} times as large as they were found"
    if found.assumed:
        told += "; how images err is assumed, as what was found did worse"
    if not (found.worse or found.overconfident):
        return told
    what = "it is worse than the single image" if found.worse else "it is surer than it may be"
    return f"{told}. Beware: {what}; likely {_cause(found, result)}"


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
