"""Spread, floor, tail and outliers of highest likelihood, for places of one reach."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from filtering.error_model import Six
from vapor.calibration.places import Places, as_six
from vapor.calibration.student_t import log_densities, log_sums

_STARTS = (0.003, 0.02, 0.1, 0.3)  # of the floor, in extents
_TRIES, _STEPS = 12, 80  # of the optimiser, from every start and from the best
_LOG_SPREAD, _LOG_FLOOR, _LOG_TAIL, _LOGIT_OUTLIERS = (-5.0, 4.0), (-9.0, 0.0), (0.7, 4.0), (-5.0, 0.0)
_LIMITS = (_LOG_SPREAD, *[_LOG_FLOOR] * 6, _LOGIT_OUTLIERS, _LOG_TAIL)
_PULL, _PULLED_TO = 1e-4, np.log(0.02)  # of the floor's logarithms, which decides where the data say nothing


@dataclass(frozen=True)
class FoundErrors:
    """The likeliest errors for one reach of a place.

    Attributes:
        score: Mean log likelihood, with the pull of the floor.
        parameters: Logarithms of spread and floor (in extents), logit of the outliers, logarithm of the tail, (9,).
    """

    score: float
    parameters: Tensor

    def settings(self, extent: float) -> dict[str, float | Six]:
        """Fields of the `ErrorModel`, of a scene of this extent in metres."""
        spread, floor, outliers, tail = (value.numpy() for value in _unpack(self.parameters))
        lengths = np.array([extent] * 3 + [1.0] * 3)
        return {
            "spread": float(spread),
            "floor": as_six(floor * lengths),
            "outlier_probability": float(1.0 / (1.0 + np.exp(-outliers))),
            "tail": float(tail),
        }


def _unpack(parameters: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Spread, floor (6,), logit of the outliers and tail."""
    return (
        parameters[0].clamp(*_LOG_SPREAD).exp(),
        parameters[1:7].clamp(*_LOG_FLOOR).exp(),
        parameters[7].clamp(*_LOGIT_OUTLIERS),
        parameters[8].clamp(*_LOG_TAIL).exp(),
    )


def most_likely_errors(places: Places, extent: float, flat: float, also: Tensor | None) -> FoundErrors:
    """Spread, floor, tail and outliers of highest likelihood, searched for from several starting points.

    Args:
        places: Of the images.
        extent: Of the scene, metres: lengths are searched for in proportion to it.
        flat: Log density of poses spread evenly over the scene, per m³ rad³.
        also: Parameters to start from as well, such as those found for places that reach a little less far.
    """
    unit = np.array([extent] * 3 + [1.0] * 3)
    residual = torch.from_numpy(places.residual / unit)
    covariance = torch.from_numpy(places.covariance / (unit[:, None] * unit) + 1e-12 * np.eye(6))
    fraction, image = torch.from_numpy(places.fraction), torch.from_numpy(places.image)
    log_unit = 3.0 * np.log(extent)

    low, high = (torch.tensor(limits, dtype=torch.float64) for limits in zip(*_LIMITS, strict=True))

    def loss(parameters: Tensor) -> tuple[float, Tensor]:
        """Negative mean log likelihood, with the pull of the floor, and its gradient."""
        spread, floor, outliers, tail = _unpack(parameters)
        terms, slopes = log_densities(residual, covariance, fraction, spread, floor, tail)
        log_places = log_sums(terms, image)
        out, right = torch.nn.functional.logsigmoid(outliers), torch.nn.functional.logsigmoid(-outliers)
        log_right = right + log_places - log_unit
        log_likelihood = torch.logaddexp(out + flat, log_right)
        by_right = (log_right - log_likelihood).exp()  # of each image: the chance that it is no outlier
        by_place = (terms - log_places[image]).exp() * by_right[image] / len(by_right)
        off = parameters[1:7] - _PULLED_TO
        gradient = torch.empty_like(parameters)
        gradient[[0, 1, 2, 3, 4, 5, 6, 8]] = -(by_place @ slopes)
        gradient[7] = by_right.mean() - right.exp()
        gradient[(parameters < low) | (parameters > high)] = 0.0
        gradient[1:7] += 2.0 * _PULL * off
        return float(_PULL * off.square().sum() - log_likelihood.mean()), gradient

    def search(start: Tensor, steps: int) -> tuple[float, Tensor]:
        parameters = start.clone().requires_grad_(True)
        optimiser = torch.optim.LBFGS(
            [parameters], max_iter=steps, line_search_fn="strong_wolfe", tolerance_grad=1e-4, tolerance_change=1e-7
        )

        def closure() -> float:
            value, parameters.grad = loss(parameters.detach())
            return value

        optimiser.step(closure)
        found = parameters.detach()
        value, _ = loss(found)
        return (value, found) if np.isfinite(value) and torch.isfinite(found).all() else (np.inf, start)

    starts = []
    for floor in _STARTS:
        angle = min(max(floor, 0.02), 0.2)
        logs = [0.0, *[np.log(floor)] * 3, *[np.log(angle)] * 3, -2.5, 1.8]
        starts.append(torch.tensor(logs, dtype=torch.float64))
    ends = [search(start, _TRIES) for start in (starts if also is None else [*starts, also])]
    value, parameters = min(ends, key=lambda end: end[0])
    better, refined = search(parameters, _STEPS)
    return FoundErrors(-better, refined) if better < value else FoundErrors(-value, parameters)
