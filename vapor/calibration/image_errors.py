"""The fit of how a network's posteriors err, by maximum likelihood on held-out images."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from filtering.error_model import ErrorModel
from filtering.se3 import Poses
from vapor.calibration.change import Change, change_of
from vapor.calibration.lasting_errors import effective_images, lasting_errors
from vapor.calibration.lasting_mistakes import mistaken_lengths
from vapor.calibration.maximum_likelihood import FoundErrors, most_likely_errors
from vapor.calibration.observations import Observations
from vapor.calibration.places import Places, as_six
from vapor.calibration.travel import Travel
from vapor.calibration.unfamiliarity import growing_errors
from vapor.checkpoints.scene_scale import RADIUS_RAD, flat_log_density, scene_extent

LEAST_IMAGES = 20
"""Images that are needed for a fit."""
LEAST_OUTLIERS = 0.05
"""Least probability of outliers: as neighbouring images err alike, none in 500 does not say that there are none."""
_RADII = np.geomspace(0.01, 0.32, 6)  # of a place, in extents of the scene
_AS_GOOD = 0.1  # nats an image, by which the likelihood may be below the highest for a wider place to be taken
_ALIKE = 10.0  # images: the weight of the assumption that all axes err alike
_UNSEEN = 2.0  # over the number of images: fraction of the variance that may be an error that lasts through all
_UNSURE = 10.0  # over the number of images: by how much the variances of a fit are too small


@dataclass(frozen=True)
class ErrorFit:
    """How the posteriors of images with true poses err.

    Attributes:
        errors: The model.
        changes: What was fitted.
        coverage: Fraction of the images whose true pose lies in the 50, 90 and 95 % region of the likeliest place.
        effective_images: How many independent images are worth as much.
    """

    errors: ErrorModel
    changes: tuple[Change, ...]
    coverage: tuple[float, float, float]
    effective_images: float


def fit_errors(
    held_out: Observations,
    travel: Travel,
    scene: Poses,
    before: ErrorModel,
    *,
    trained: Observations | None = None,
    same_conditions: bool = False,
) -> ErrorFit:
    """Fit how the posteriors of n images err.

    Places, spread, floor, tails and outliers are those of highest mean log likelihood

        log[ε flat + (1 − ε) Σₖ fractionₖ t(true pose; placeₖ, spread Cₖ + diag(floor²), ν)].

    Where the likelihood hardly tells one reach of places from another, the wider one is taken. By how much more
    unfamiliar images err comes from images that were trained on: the power of the score of highest likelihood. How long
    errors last comes from the products of the directions of normalised errors of two images, against how far the camera
    came between them, and how long mistakes about the place last from what two images say for the true one. As
    neighbouring images err alike, the data are worth fewer images than there are: the fewer, the more alike the axes
    and the larger the variances.

    Args:
        held_out: Held-out images, n.
        travel: Of the camera, between them.
        scene: Poses that outline the scene: all lengths are searched for in proportion to it.
        before: The model so far, of which all else is kept.
        trained: Images that were trained on, best those that others are compared with.
        same_conditions: Whether held-out images are of the hours, the light and the seasons of use.
    """
    extent = scene_extent(scene)
    flat = flat_log_density(scene)
    radius, places, found = _widest_places(held_out, extent, flat)
    errors = replace(
        before,
        radius_m=radius,
        radius_rad=RADIUS_RAD,
        flat_log_density=flat,
        **found.settings(extent),
    )
    evidence = places.evidence(errors)
    if held_out.score is not None:
        if trained is not None and trained.score is not None:
            errors = growing_errors(errors, places, held_out.score, trained, trained.score)
        places = places.grown(errors, held_out.score)
        errors = replace(errors, **most_likely_errors(places, extent, flat, found.parameters).settings(extent))
    else:
        errors = replace(errors, unfamiliar_power=0.0)
    residual, usable = places.residuals(errors)
    lasting = lasting_errors(residual, usable, travel, extent)
    effective = effective_images(travel, lasting)
    errors = cautious(errors, effective)
    errors = replace(
        errors,
        outlier_probability=max(errors.outlier_probability, LEAST_OUTLIERS),
        lasting_fraction=lasting.fraction,
        length_m=lasting.length_m,
        length_rad=lasting.length_rad,
        mistaken_lengths=mistaken_lengths(evidence, travel, lasting, same_conditions=same_conditions),
        typical_std=places.typical_std(errors),
    )
    formerly = Places.near(held_out.samples, held_out.truth, before.radius_m, before.radius_rad)
    if held_out.score is not None:
        formerly = formerly.grown(before, held_out.score)
    gain = float((places.log_density(errors) - formerly.log_density(before)).mean())
    names = ("radius_m", "spread", "floor", "tail", "outlier_probability", "unfamiliar_power")
    changes = (
        change_of("errors of an image", names, before, errors, gain),
        change_of(
            "how long they last", ("lasting_fraction", "length_m", "length_rad", "mistaken_lengths"), before, errors
        ),
    )
    return ErrorFit(errors, changes, places.coverage(errors), effective)


def _widest_places(held_out: Observations, extent: float, flat: float) -> tuple[float, Places, FoundErrors]:
    """The widest reach of places whose likelihood is nearly the highest, these places, and their errors."""
    tried = []
    parameters = None
    for radius in _RADII * extent:
        places = Places.near(held_out.samples, held_out.truth, float(radius), RADIUS_RAD)
        found = most_likely_errors(places, extent, flat, parameters)
        parameters = found.parameters
        tried.append((float(radius), places, found))
    highest = max(found.score for _, _, found in tried)
    return next(entry for entry in reversed(tried) if entry[2].score >= highest - _AS_GOOD)


def cautious(errors: ErrorModel, effective: float) -> ErrorModel:
    """Larger errors, and axes more alike, the fewer independent images they were found on.

    An error that lasts through all of them is not seen: the fewer they are, the larger the fraction that may never
    fade.
    """
    variances = np.square(errors.floor).reshape(2, 3)
    variances = (effective * variances + _ALIKE * variances.mean(axis=1, keepdims=True)) / (effective + _ALIKE)
    larger = (effective + _UNSURE) / effective
    return replace(
        errors,
        spread=larger * errors.spread,
        floor=as_six(np.sqrt(larger * variances).ravel()),
        constant_fraction=min(1.0, ErrorModel().constant_fraction + _UNSEEN / effective),
    )
