"""Predictions of a model for recorded images: ambiguity, errors, and images that it does not know."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64

from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from vapor.evaluation.trajectory import is_right
from vapor.inspection.coverage import Coverage

_NOWHERE = Poses(np.full((3, 3), np.nan), np.full(3, np.nan))
_COUNTED = 0.1  # of the samples, for a place to count
_REACH = 0.9  # of the samples, within the spread
_LEAST_IMAGES = 3  # of a place that errs
_WRONG_FRACTION = 0.5  # of its images


class Prediction(NamedTuple):
    """Figures of one image's posterior.

    The places hold at least a tenth of the samples each; the spread, metres, is the distance from the best place within
    which nine tenths of the samples are. The best place is world_from_camera, and NaN where there is none.
    """

    places: int
    spread_m: float
    best: Poses
    ood_score: float

    @staticmethod
    def of(posterior: PosePosterior) -> Prediction:
        """The figures of one posterior."""
        best, centre = _NOWHERE, posterior.samples.translation.mean(axis=0)
        if len(posterior.weights):
            best = posterior.means[int(np.argmax(posterior.weights))]
            centre = best.translation
        apart_m = np.linalg.norm(posterior.samples.translation - centre, axis=1)
        places = int((posterior.weights >= _COUNTED).sum())
        return Prediction(places, float(np.quantile(apart_m, _REACH)), best, posterior.ood_score)


@dataclass(frozen=True)
class WeakPlace:
    """Images of a cell of the map, looking one way, most of which the model gets wrong.

    The position is their middle in the world, metres; `places` is the median number of places that the model finds
    possible, `passes` the number of passes that show it.
    """

    position: tuple[float, float, float]
    looking: str
    images: int
    median_m: float
    places: int
    passes: int

    def __str__(self) -> str:
        x, y, z = self.position
        passes = "one pass" if self.passes == 1 else f"{self.passes} passes"
        return (
            f"near ({x:.1f}, {y:.1f}, {z:.1f}) m, looking {self.looking}: median error {self.median_m:.2g} m over"
            f" {self.images} image{'s' * (self.images != 1)} of {passes},"
            f" {self.places} place{'s' * (self.places != 1)} possible"
        )


@dataclass(frozen=True)
class Predictions:
    """Predictions of a model for n images, of which k have true poses (`posed`, (n,)).

    Errors, metres, are of the best places (k,), and NaN without a place; `right` is within 0.3 m and 20°. Why most
    images look unlike the training images stands in `why_out_of_distribution`, which is empty where they do not.
    """

    places: Int64[np.ndarray, " n"]
    spread_m: Float64[np.ndarray, " n"]
    ood_score: Float64[np.ndarray, " n"]
    error_m: Float64[np.ndarray, " k"]
    right: Bool[np.ndarray, " k"]
    posed: Bool[np.ndarray, " n"]
    best: Poses
    why_out_of_distribution: str = ""

    @staticmethod
    def of(predicted: Sequence[Prediction], truth: Poses, posed: Bool[np.ndarray, " n"]) -> Predictions:
        """Compare predictions of images (n,) with the k true poses."""
        best = Poses.stack([each.best for each in predicted])[np.flatnonzero(posed)]
        error_m, right = np.full(len(truth), np.nan), np.zeros(len(truth), bool)
        known = best.is_finite()
        error_m[known] = best[known].distance(truth[known])[0]
        right[known] = is_right(best[known], truth[known])
        places, spread_m, _, ood_score = zip(*predicted, strict=True)
        return Predictions(
            np.array(places, np.int64), np.array(spread_m), np.array(ood_score), error_m, right, posed, best
        )

    def weak_places(self, coverage: Coverage) -> list[WeakPlace]:
        """Places where most images are wrong, from the most of them down."""
        passes = {
            (cell.storey, cell.column, cell.row, sector): number
            for cell in coverage.passes
            for sector, number in cell.looked.items()
        }
        keys = np.column_stack([coverage.storey, coverage.cells, coverage.sectors])
        groups, group = np.unique(keys, axis=0, return_inverse=True)
        group, found = group.ravel(), []
        for number, (storey, column, row, sector) in enumerate(groups.tolist()):
            own = np.flatnonzero(group == number)
            wrong = int((~self.right[own]).sum())
            if wrong < _LEAST_IMAGES or wrong < _WRONG_FRACTION * len(own):
                continue
            x, y, z = np.median(coverage.images.poses.translation[own], axis=0).tolist()
            errors_m = np.where(np.isnan(self.error_m[own]), np.inf, self.error_m[own])
            median_m = float(np.median(errors_m))
            place = WeakPlace(
                (x, y, z),
                coverage.direction(sector),
                len(own),
                median_m if np.isfinite(median_m) else 0.0,
                int(np.median(self.places[self.posed][own])),
                passes[storey, column, row, sector],
            )
            found.append((wrong, place))
        return [place for _, place in sorted(found, key=lambda each: -each[0])]

    @property
    def ambiguous(self) -> float:
        """Fraction of the images that may be in several places."""
        return float((self.places > 1).mean())

    @property
    def out_of_distribution(self) -> float:
        """Fraction of the images that look like those of another place."""
        return float((self.ood_score > 1.0).mean())

    def as_json(self, coverage: Coverage | None) -> dict[str, Any]:
        """Figures for the report."""
        known = self.error_m[~np.isnan(self.error_m)]
        return {
            "images": len(self.places),
            "ambiguous": self.ambiguous,
            "out_of_distribution": self.out_of_distribution,
            "why_out_of_distribution": self.why_out_of_distribution,
            "median_spread_m": float(np.median(self.spread_m)),
            "median_ood_score": float(np.median(self.ood_score)),
            "median_error_m": float(np.median(known)) if len(known) else None,
            "right": float(self.right.mean()) if len(self.right) else None,
            "weak_places": []
            if coverage is None
            else [vars(place) | {"description": str(place)} for place in self.weak_places(coverage)],
        }
