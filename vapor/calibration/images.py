"""How a network's posteriors err, and how wide their kernels are: by maximum likelihood on held-out images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float32, Float64, Int64
from scipy.optimize import minimize
from scipy.stats import f as fisher
from torch import Tensor

from filtering.association import PLACE
from filtering.density import KernelDensity
from filtering.error_model import FOREIGN, LEAST_SCORE, ErrorModel, Six
from filtering.moments import group_moments
from filtering.posterior import find_places
from filtering.se3 import Poses
from vapor.checkpoints.scene_scale import LENGTH_RAD, RADIUS_RAD, flat_log_density, scene_extent

LEAST_IMAGES = 20
REGIONS = (0.5, 0.9, 0.95)

_RADII = np.geomspace(0.01, 0.32, 6)  # of a place, in extents of the scene
_AS_GOOD = 0.1  # nats an image: the widest place is taken that is no worse than the best by more
_NEAREST = 8  # places of an image that are fitted: those nearest to the true pose
_STARTS = (0.003, 0.02, 0.1, 0.3)  # of the floor, in extents
_TRIES, _STEPS = 12, 80  # of the optimiser, from every start and from the best
_LOG_SPREAD, _LOG_FLOOR, _LOG_TAIL, _LOGIT_OUTLIERS = (-5.0, 4.0), (-9.0, 0.0), (0.7, 4.0), (-5.0, 0.0)
_LIMITS = (_LOG_SPREAD, *[_LOG_FLOOR] * 6, _LOGIT_OUTLIERS, _LOG_TAIL)
_PULL, _PULLED_TO = 1e-4, np.log(0.02)  # of the floor's logarithms, where the data say nothing
_LEAST_OUTLIERS = 0.05  # neighbouring images err alike: none in 500 does not say that there are none
_POWERS = np.linspace(0.0, 1.5, 13)  # by which errors grow with the score
_LENGTHS = np.geomspace(0.003, 0.15, 10)  # over which errors last, in extents
_LENGTHS_RAD = (0.2, 0.4, 0.8, 1.6)
_CLEARLY = 1.01  # times the squares that another angle than the ordinary one must save
_SHARES = (0.5, 0.7)  # that last, of the variance
_LEAST_PAIRS, _MOST_PAIRS, _LEAST_IN_BIN, _LEAST_EFFECTIVE = 50, 10**6, 10, 30
_WAYS = np.append(0.0, np.geomspace(0.05, 1e4, 72))  # in lengths: bins of pairs of images
_WINDOW, _LEAST_CORRELATION = 4.0, 0.1
_NO_MISTAKE = 0.02  # of the images that find the true place less likely than not: with fewer none mistake it
_MISTAKEN = np.geomspace(0.125, 32.0, 17)  # lengths over which mistakes fade
_FARTHEST_LENGTHS, _LEAST_VOTE, _LEAST_MISTAKEN, _MOST_MISTAKEN = 100.0, 0.25, 4.0, 40.0
_ANOTHER_HOUR = 3.0  # times as far beyond one length mistakes reach where the light is another than on held-out passes
_ALIKE = 10.0  # images that say that all axes err alike
_UNSEEN = 2.0  # over the number of images: share of the variance that may be an error that lasts through all
_UNSURE = 10.0  # images by which the variances of a fit to few are too small

_NARROWEST, _WIDEST = (5e-4, 3e-3), (0.1, 1.0)  # kernels: extents, radians
_BLOCK = 50  # images at a time: 50 × 2000 float32 fit the cache


@dataclass(frozen=True)
class Change:
    """What one fit changed.

    Attributes:
        what: In words.
        before: Values by the name of their setting.
        after: Likewise.
        gain: Log likelihood gained, nats per held-out image; None where it is no likelihood that decides.
    """

    what: str
    before: dict[str, float | Six]
    after: dict[str, float | Six]
    gain: float | None = None


@dataclass(frozen=True)
class Way:
    """How far the camera came between images, and which belong to one pass.

    Attributes:
        number: Of the pass that each image is from, none of them in two parts, (n,).
        metres: Come from the first image of its pass, (n,).
        radians: Turned likewise, (n,).
    """

    number: Int64[np.ndarray, " n"]
    metres: Float64[np.ndarray, " n"]
    radians: Float64[np.ndarray, " n"]

    @staticmethod
    def along(poses: Poses, number: Int64[np.ndarray, " n"]) -> Way:
        """The way along poses (n,) of numbered passes, each in order of time."""
        begins = np.diff(number, prepend=number[:1] - 1) != 0
        steps = poses[:-1].distance(poses[1:])
        metres, radians = (np.cumsum(np.append(0.0, step)) for step in steps)
        first = np.flatnonzero(begins)[np.cumsum(begins) - 1]
        return Way(number, metres - metres[first], radians - radians[first])

    def __getitem__(self, indices: Int64[np.ndarray, " k"]) -> Way:
        return Way(self.number[indices], self.metres[indices], self.radians[indices])


@dataclass(frozen=True)
class Seen:
    """Images that the network has looked at.

    Attributes:
        samples: Posterior samples of each, world_from_camera, (m,) each.
        truth: True poses, world_from_camera, (n,).
        score: How unlike those of the training it is (`PosePosterior.unfamiliarity`), (n,); None where nobody knows.
    """

    samples: Sequence[Poses]
    truth: Poses
    score: Float64[np.ndarray, " n"] | None = None


@dataclass(frozen=True)
class ErrorFit:
    """What images with true poses say of the errors of their posteriors.

    Attributes:
        errors: The model.
        changes: What was fitted.
        coverage: Share of the images whose true pose lies in the 50, 90 and 95 % region of the likeliest place.
        effective_images: So many independent images are worth as much.
    """

    errors: ErrorModel
    changes: tuple[Change, ...]
    coverage: tuple[float, float, float]
    effective_images: float


def fit_errors(
    seen: Seen,
    way: Way,
    scene: Poses,
    before: ErrorModel,
    *,
    trained: Seen | None = None,
    same_conditions: bool = False,
) -> ErrorFit:
    """Fit how the posteriors of n images err.

    Places, spread, floor, tails and outliers are those of highest mean log likelihood

        log[ε flat + (1 − ε) Σₖ shareₖ t(true pose; placeₖ, spread Cₖ + diag(floor²), ν)].

    The wider place is taken where the likelihood hardly tells. By how much more unfamiliar images err comes from images
    that were trained on: the power of the score of highest likelihood. How long errors last comes from the
    products of the directions of normalised errors of two images, against the way between them, and for how long
    mistakes about the place do from what two images say for the true one. As neighbouring images err alike, the data
    are worth fewer images than there are: the fewer, the more alike the axes and the larger the variances.

    Args:
        seen: Held-out images, n.
        way: Between them.
        scene: Poses that outline the scene: all lengths are sought in proportion to it.
        before: Of which the rest is kept.
        trained: Images that were trained on, best those that others are compared with.
        same_conditions: Whether held-out images are of the hours, the light and the seasons of use.
    """
    samples, truth = seen.samples, seen.truth
    extent = scene_extent(scene)
    flat = flat_log_density(scene)
    tried = []
    parameters = None
    for radius in _RADII * extent:
        places = _Places.near(samples, truth, float(radius), RADIUS_RAD)
        found = _likeliest(places, extent, flat, parameters)
        parameters = found.parameters
        tried.append((float(radius), places, found))
    highest = max(found.score for _, _, found in tried)
    radius, places, found = next(entry for entry in reversed(tried) if entry[2].score >= highest - _AS_GOOD)
    errors = replace(
        before,
        radius_m=radius,
        radius_rad=RADIUS_RAD,
        flat_log_density=flat,
        **found.settings(extent),
    )
    evidence = places.evidence(errors)
    if seen.score is not None:
        if trained is not None and trained.score is not None:
            errors = _growing(errors, places, seen.score, trained, trained.score)
        places = places.grown(errors, seen.score)
        errors = replace(errors, **_likeliest(places, extent, flat, found.parameters).settings(extent))
    else:
        errors = replace(errors, unfamiliar_power=0.0)
    residual, told = places.residuals(errors)
    lasting = lasting_errors(residual, told, way, extent)
    effective = _effective_images(way, lasting)
    errors = _cautious(errors, effective)
    errors = replace(
        errors,
        outlier_share=max(errors.outlier_share, _LEAST_OUTLIERS),
        lasting_share=lasting.share,
        length_m=lasting.length_m,
        length_rad=lasting.length_rad,
        mistaken_lengths=_mistaken_lengths(evidence, way, lasting, same_conditions=same_conditions),
        typical_std=places.typical_std(errors),
    )
    formerly = _Places.near(samples, truth, before.radius_m, before.radius_rad)
    if seen.score is not None:
        formerly = formerly.grown(before, seen.score)
    gain = float((places.log_density(errors) - formerly.log_density(before)).mean())
    names = ("radius_m", "spread", "floor", "tail", "outlier_share", "unfamiliar_power")
    changes = (
        _change("errors of an image", names, before, errors, gain),
        _change("how long they last", ("lasting_share", "length_m", "length_rad", "mistaken_lengths"), before, errors),
    )
    return ErrorFit(errors, changes, places.coverage(errors), effective)


@dataclass(frozen=True)
class _Found:
    """The likeliest errors for one reach of a place.

    Attributes:
        score: Mean log likelihood, with the pull of the floor.
        parameters: Logarithms of spread and floor (in extents), logit of the outliers, logarithm of the tail, (9,).
    """

    score: float
    parameters: Tensor

    def settings(self, extent: float) -> dict[str, float | Six]:
        spread, floor, outliers, tail = (value.numpy() for value in _unpack(self.parameters))
        lengths = np.array([extent] * 3 + [1.0] * 3)
        return {
            "spread": float(spread),
            "floor": _six(floor * lengths),
            "outlier_share": float(1.0 / (1.0 + np.exp(-outliers))),
            "tail": float(tail),
        }


@dataclass(frozen=True)
class _Places:
    """Places of n images, those nearest to the true pose, by image.

    Attributes:
        residual: The true pose from each place, ξ = (v, ω), (p, 6).
        covariance: Of the samples, (p, 6, 6).
        share: Of the samples, (p,).
        image: Of which each is, in increasing order, every image at least once, (p,).
    """

    residual: Float64[np.ndarray, "p 6"]
    covariance: Float64[np.ndarray, "p 6 6"]
    share: Float64[np.ndarray, " p"]
    image: Int64[np.ndarray, " p"]

    @staticmethod
    def near(samples: Sequence[Poses], truth: Poses, radius_m: float, radius_rad: float) -> _Places:
        parts = []
        for poses in samples:
            label, count = find_places(poses, radius_m, radius_rad)
            own = np.flatnonzero(label >= 0)
            means, covariances, _ = group_moments(poses[own], np.ones(len(own)), label[own], count)
            parts.append((means, covariances, np.bincount(label[own], minlength=count) / len(poses)))
        image = np.repeat(np.arange(len(samples)), [len(share) for _, _, share in parts])
        means = Poses.concatenate([part for part, _, _ in parts])
        residual = (means.inverse() @ truth[image]).log()
        apart = np.linalg.norm(residual[:, :3], axis=1) / radius_m
        apart += np.linalg.norm(residual[:, 3:], axis=1) / radius_rad
        order = np.lexsort([apart, image])
        rank = np.arange(len(image)) - np.searchsorted(image, image)
        kept = order[rank < _NEAREST]
        covariance, share = (np.concatenate(part) for part in list(zip(*parts, strict=True))[1:])
        return _Places(residual[kept], covariance[kept], share[kept], image[kept])

    def grown(self, errors: ErrorModel, score: Float64[np.ndarray, " n"]) -> _Places:
        """The same as if every image were as familiar as those that the model is about: g⁻³ t(ξ/√g; Σ) is t(ξ; g Σ)."""
        growth = np.array([errors.growth(float(value)) for value in score])[self.image]
        return replace(self, residual=self.residual / np.sqrt(growth)[:, None], share=self.share / growth**3)

    def log_density(self, errors: ErrorModel) -> Float64[np.ndarray, " n"]:
        """Log density of the true pose of each image, per m³ rad³."""
        log_places = _log_sum(torch.from_numpy(self._log_terms(errors)), torch.from_numpy(self.image)).numpy()
        outliers = errors.outlier_share
        return np.logaddexp(np.log(outliers) + errors.flat_log_density, np.log1p(-outliers) + log_places)

    def evidence(self, errors: ErrorModel) -> Float64[np.ndarray, " n"]:
        """Log of how possible each image finds the true place, as the filter asks it (`associate`)."""
        covariance = errors.covariance(self.covariance)
        solved = np.linalg.solve(covariance, self.residual[..., None])[..., 0]
        squared = np.einsum("pi,pi->p", self.residual, solved)
        support = np.bincount(self.image, self.share * np.exp(-0.5 * squared / PLACE**2))
        possible = support / (support + errors.possible_share)
        return np.log(errors.outlier_share + (1.0 - errors.outlier_share) * possible)

    def residuals(self, errors: ErrorModel) -> tuple[Float64[np.ndarray, "n 6"], Bool[np.ndarray, " n"]]:
        """Errors of the likeliest places in standard deviations, far ones drawn in; and who has more than a flat one.

        Drawn in as an image of such errors counts: by the weight of a Student t distribution.
        """
        best = self._likeliest(errors)
        unit = np.asarray(self.typical_std(errors))
        covariance = errors.covariance(self.covariance[best]) / np.multiply.outer(unit, unit)
        values, vectors = np.linalg.eigh(covariance)
        normal = np.einsum("nij,nj->ni", np.swapaxes(vectors, 1, 2), self.residual[best] / unit)
        normal = np.einsum("nij,nj->ni", vectors, normal / np.sqrt(values))
        weight = (errors.tail + 6.0) / (errors.tail + np.square(normal).sum(axis=1))
        share = np.log1p(-errors.outlier_share) - np.log(errors.outlier_share)
        terms = torch.from_numpy(self._log_terms(errors))
        log_places = _log_sum(terms, torch.from_numpy(self.image)).numpy()
        return normal * np.sqrt(np.minimum(weight, 1.0))[:, None], log_places + share > errors.flat_log_density

    def coverage(self, errors: ErrorModel) -> tuple[float, float, float]:
        best = self._likeliest(errors)
        covariance = errors.covariance(self.covariance[best])
        solved = np.linalg.solve(covariance, self.residual[best][..., None])[..., 0]
        squared = np.einsum("ni,ni->n", self.residual[best], solved)
        fifty, ninety, most = (float((squared <= 6.0 * fisher.ppf(q, 6, errors.tail)).mean()) for q in REGIONS)
        return fifty, ninety, most

    def typical_std(self, errors: ErrorModel) -> Six:
        """Median over the images, of the likeliest place."""
        variances = np.diagonal(errors.covariance(self.covariance[self._likeliest(errors)]), axis1=1, axis2=2)
        return _six(np.sqrt(np.median(variances, axis=0)))

    def _likeliest(self, errors: ErrorModel) -> Int64[np.ndarray, " n"]:
        """Index of the place of each image in which its true pose is likeliest."""
        order = np.lexsort([-self._log_terms(errors), self.image])
        return order[np.flatnonzero(np.diff(self.image, prepend=-1))]

    def _log_terms(self, errors: ErrorModel) -> Float64[np.ndarray, " p"]:
        terms, _ = _log_places(
            torch.from_numpy(self.residual),
            torch.from_numpy(self.covariance),
            torch.from_numpy(self.share),
            torch.tensor(errors.spread, dtype=torch.float64),
            torch.tensor(errors.floor, dtype=torch.float64),
            torch.tensor(errors.tail, dtype=torch.float64),
        )
        return terms.numpy()


def _log_places(
    residual: Tensor, covariance: Tensor, share: Tensor, spread: Tensor, floor: Tensor, tail: Tensor
) -> tuple[Tensor, Tensor]:
    """Log of share times Student t density of each residual (p, 6), and its slopes (p, 8).

    The slopes are by the logarithms of spread, floor (6) and tail. Written out, they take half the time of automatic
    ones.
    """
    factor = torch.linalg.cholesky(spread * covariance + torch.diag(floor.square()))
    inverse = torch.cholesky_inverse(factor)
    solved = (inverse @ residual[..., None])[..., 0]
    squared = (residual * solved).sum(dim=1)
    half = (tail + 6.0) / 2.0
    log_volume = torch.diagonal(factor, dim1=1, dim2=2).log().sum(dim=1)
    log_constant = torch.lgamma(half) - torch.lgamma(tail / 2.0) - 3.0 * torch.log(tail * np.pi)
    log_far = torch.log1p(squared / tail)
    by_scale = solved[:, :, None] * solved[:, None, :] * (half / (tail + squared))[:, None, None] - 0.5 * inverse
    by_tail = 0.5 * (torch.digamma(half) - torch.digamma(tail / 2.0) - log_far) - 3.0 / tail
    by_tail += half * squared / (tail * (tail + squared))
    slopes = torch.cat(
        [
            spread * (by_scale * covariance).sum(dim=(1, 2))[:, None],
            2.0 * floor.square() * torch.diagonal(by_scale, dim1=1, dim2=2),
            tail * by_tail[:, None],
        ],
        dim=1,
    )
    return share.log() + log_constant - log_volume - half * log_far, slopes


def _log_sum(terms: Tensor, image: Tensor) -> Tensor:
    """Log of the sum of exponentials over the places of each image."""
    count = int(image[-1]) + 1
    top = torch.full((count,), -torch.inf, dtype=terms.dtype).scatter_reduce(0, image, terms.detach(), "amax")
    return top + torch.zeros(count, dtype=terms.dtype).scatter_add(0, image, (terms - top[image]).exp()).log()


def _unpack(parameters: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Spread, floor (6,), logit of the outliers and tail."""
    return (
        parameters[0].clamp(*_LOG_SPREAD).exp(),
        parameters[1:7].clamp(*_LOG_FLOOR).exp(),
        parameters[7].clamp(*_LOGIT_OUTLIERS),
        parameters[8].clamp(*_LOG_TAIL).exp(),
    )


def _likeliest(places: _Places, extent: float, flat: float, also: Tensor | None) -> _Found:
    """Spread, floor, tail and outliers of highest likelihood, from several starts and from parameters that are near."""
    unit = np.array([extent] * 3 + [1.0] * 3)
    residual = torch.from_numpy(places.residual / unit)
    covariance = torch.from_numpy(places.covariance / (unit[:, None] * unit) + 1e-12 * np.eye(6))
    share, image = torch.from_numpy(places.share), torch.from_numpy(places.image)
    log_unit = 3.0 * np.log(extent)

    low, high = (torch.tensor(limits, dtype=torch.float64) for limits in zip(*_LIMITS, strict=True))

    def loss(parameters: Tensor) -> tuple[float, Tensor]:
        """Negative mean log likelihood, with the pull of the floor, and its gradient."""
        spread, floor, outliers, tail = _unpack(parameters)
        terms, slopes = _log_places(residual, covariance, share, spread, floor, tail)
        log_places = _log_sum(terms, image)
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
    return _Found(-better, refined) if better < value else _Found(-value, parameters)


def _growing(
    errors: ErrorModel,
    places: _Places,
    score: Float64[np.ndarray, " n"],
    trained: Seen,
    trained_score: Float64[np.ndarray, " k"],
) -> ErrorModel:
    """The model with errors that grow with the score, as images held out and images trained on say together."""
    errors = replace(errors, unfamiliar_score=ordinary_score(score))
    known = _Places.near(trained.samples, trained.truth, errors.radius_m, errors.radius_rad)

    def likelihood(grown: ErrorModel) -> float:
        held_out = places.grown(grown, score).log_density(grown).mean()
        return float(held_out + known.grown(grown, trained_score).log_density(grown).mean())

    return max((replace(errors, unfamiliar_power=float(power)) for power in _POWERS), key=likelihood)


def ordinary_score(score: Float64[np.ndarray, " n"]) -> float:
    """The score of an ordinary image among n that are not foreign."""
    return float(np.clip(np.median(score), LEAST_SCORE, FOREIGN))


@dataclass(frozen=True)
class Lasting:
    """How long errors last.

    Attributes:
        share: Of their variance, that lasts while the view stays the same.
        length_m: Over which that fades to 1/e, metres.
        length_rad: Likewise, radians.
    """

    share: float
    length_m: float
    length_rad: float

    def lengths(
        self, metres: Float64[np.ndarray, " k"], radians: Float64[np.ndarray, " k"]
    ) -> Float64[np.ndarray, " k"]:
        """Ways in lengths."""
        return np.hypot(metres / self.length_m, radians / self.length_rad)


def lasting_errors(
    residual: Float64[np.ndarray, "n 6"], told: Bool[np.ndarray, " n"], way: Way, extent: float
) -> Lasting:
    """How long errors last, by the correlation of their directions along the way.

    Args:
        residual: Errors in standard deviations, (n, 6).
        told: Which of the images tell them.
        way: Between the images.
        extent: Of the scene, metres: lengths are sought in proportion to it.

    Least squares tell which share lasts, and how many metres change a view as much as how many radians. They see the
    larger of two errors, one that fades soon and one that does not; but what many images are worth is told by the sum
    of all correlations, to which the lengths are matched where there are enough images for that.
    """
    # Of their directions: images err more in one part of the scene than in another, which is not an error that lasts.
    direction = residual / np.maximum(np.linalg.norm(residual, axis=1, keepdims=True), 1e-300)
    first, second = _pairs(way, told)
    if len(first) < _LEAST_PAIRS:
        return Lasting(_SHARES[1], _LENGTHS[len(_LENGTHS) // 2] * extent, LENGTH_RAD)
    metres, radians = way.metres[second] - way.metres[first], way.radians[second] - way.radians[first]
    products = (direction[second] * direction[first]).sum(axis=1)
    weights = 1.0 / (second - first)  # neighbours as much as all that are ten times as far from each other

    def least_squares(length_rad: float) -> tuple[float, Lasting]:
        best, found = np.inf, Lasting(_SHARES[1], extent, length_rad)
        for length_m in _LENGTHS * extent:
            tried = Lasting(1.0, float(length_m), length_rad)
            kernel = np.exp(-tried.lengths(metres, radians))
            weight = max(float((weights * np.square(kernel)).sum()), 1e-300)
            share = float(np.clip((weights * kernel * products).sum() / weight, 0.0, 1.0))
            cost = float((weights * np.square(products - share * kernel)).sum())
            if cost < best:
                best, found = cost, replace(tried, share=float(np.clip(share, *_SHARES)))
        return best, found

    ordinary, found = least_squares(LENGTH_RAD)
    if _effective_images(way, found) < _LEAST_EFFECTIVE:
        return found
    others = [least_squares(length_rad) for length_rad in _LENGTHS_RAD if length_rad != LENGTH_RAD]
    best, other = min(others, key=lambda each: each[0])
    if _CLEARLY * best < ordinary:
        found = other
    # Where the camera hardly turns, any angle fits as well.
    costs = [ordinary, *(cost for cost, _ in others)]
    turns = max(costs) > _CLEARLY * min(costs)
    longer = _correlation_length(found.lengths(metres, radians), products) / found.share
    longer = float(np.clip(longer, _LENGTHS[0] * extent / found.length_m, _LENGTHS[-1] * extent / found.length_m))
    length_rad = min(longer * found.length_rad, _LENGTHS_RAD[-1]) if turns else found.length_rad
    return replace(found, length_m=longer * found.length_m, length_rad=length_rad)


def _correlation_length(ways: Float64[np.ndarray, " k"], products: Float64[np.ndarray, " k"]) -> float:
    """Integral over the way of the correlation that products of pairs so many lengths apart tell.

    It ends at a few times the length over which what lasts is seen to fade (Sokal's window), as what is farther is
    noise, or with the pairs.
    """
    bins = np.searchsorted(_WAYS, ways, side="right") - 1
    count = np.bincount(bins, minlength=len(_WAYS))
    mean = np.bincount(bins, products, minlength=len(_WAYS)) / np.maximum(count, 1)
    told = np.flatnonzero(count[:-1] >= _LEAST_IN_BIN)
    if len(told) == 0:
        return 1.0
    nearest = max(float(mean[told[0]]), _LEAST_CORRELATION)
    integral, correlation = 0.0, nearest
    for k in range(told[-1] + 1):
        correlation = float(mean[k]) if count[k] >= _LEAST_IN_BIN else correlation
        integral += correlation * float(_WAYS[k + 1] - _WAYS[k])
        if nearest * _WAYS[k + 1] >= _WINDOW * integral:
            break
    return integral


def _pairs(way: Way, told: Bool[np.ndarray, " n"]) -> tuple[Int64[np.ndarray, " k"], Int64[np.ndarray, " k"]]:
    """Pairs of images of one pass that are told of, the earlier first; of many images not the farthest apart."""
    firsts, seconds = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    for lag in range(1, min(len(told), _MOST_PAIRS // max(len(told), 1) + 1)):
        first = np.flatnonzero((way.number[lag:] == way.number[:-lag]) & told[lag:] & told[:-lag])
        firsts.append(first)
        seconds.append(first + lag)
    return np.concatenate(firsts), np.concatenate(seconds)


def _mistaken_lengths(
    evidence: Float64[np.ndarray, " n"], way: Way, lasting: Lasting, *, same_conditions: bool = False
) -> float:
    """Over how many lengths of errors images are one vote on where the camera is; 1 where none mistakes it.

    Along a pass the evidence of two images, so many lengths apart, correlates by a share that fades. A vote is worth
    less by the sum of an image's correlations with all others; what does not last is new with every image, and counts
    once a length where images are farther apart. Under other conditions than on held-out passes mistakes last
    longer: what is beyond one length is multiplied.
    """
    if len(evidence) < _LEAST_PAIRS or (evidence < np.log(0.5)).mean() < _NO_MISTAKE:
        return 1.0
    value = (evidence - evidence.mean()) / evidence.std()
    first, second = _pairs(way, np.ones(len(value), bool))
    steps = lasting.lengths(np.diff(way.metres), np.diff(way.radians))[np.diff(way.number) == 0]
    apart = lasting.lengths(way.metres[second] - way.metres[first], way.radians[second] - way.radians[first])
    near = apart < _FARTHEST_LENGTHS
    apart, products = apart[near], (value[first] * value[second])[near]
    if len(products) < _LEAST_PAIRS:
        return 1.0
    best, vote, new = np.inf, 1.0, min(float(np.median(steps)), 1.0)
    for lengths in _MISTAKEN:
        kernel = np.exp(-apart / lengths)
        weight = max(float(np.square(kernel).sum()), 1e-300)
        share = float(np.clip((kernel * products).sum() / weight, 0.0, 1.0))
        cost = float(np.square(products - share * kernel).mean())
        if cost < best:
            best, vote = cost, (1.0 - share) * new + 2.0 * share * float(lengths)
    if same_conditions:
        return float(np.clip(vote, _LEAST_VOTE, _MOST_MISTAKEN))
    return float(np.clip(1.0 + _ANOTHER_HOUR * (vote - 1.0), _LEAST_MISTAKEN, _MOST_MISTAKEN))


def _effective_images(way: Way, lasting: Lasting) -> float:
    """One for every pass, and one for every two lengths of its way, but no more than there are images."""
    steps = lasting.lengths(np.diff(way.metres), np.diff(way.radians))
    return 1.0 + float(np.where(np.diff(way.number) == 0, np.minimum(steps / 2.0, 1.0), 1.0).sum())


def _cautious(errors: ErrorModel, effective: float) -> ErrorModel:
    """Errors that were found on so many independent images, as far as that tells.

    An error that lasts through all of them is not seen: the fewer they are, the larger a share may never fade.
    """
    variances = np.square(errors.floor).reshape(2, 3)
    variances = (effective * variances + _ALIKE * variances.mean(axis=1, keepdims=True)) / (effective + _ALIKE)
    larger = (effective + _UNSURE) / effective
    return replace(
        errors,
        spread=larger * errors.spread,
        floor=_six(np.sqrt(larger * variances).ravel()),
        constant_share=min(1.0, ErrorModel().constant_share + _UNSEEN / effective),
    )


def _change(
    what: str, names: Sequence[str], before: ErrorModel, after: ErrorModel, gain: float | None = None
) -> Change:
    values, formerly = ({name: getattr(errors, name) for name in names} for errors in (after, before))
    return Change(what, formerly, values, gain)


def _six(values: np.ndarray) -> Six:
    a, b, c, d, e, f = (float(value) for value in values)
    return a, b, c, d, e, f


# --- kernel widths ---------------------------------------------------------------------------------


def fit_widths(
    samples: Sequence[Poses], truth: Poses, scene: Poses, before: tuple[float, float]
) -> tuple[tuple[float, float], Change]:
    """Kernel widths of the samples' density, metres and radians, of highest mean log likelihood.

    Args:
        samples: Posterior samples of each image, world_from_camera, (m,) each.
        truth: True poses, world_from_camera, (n,).
        scene: Poses that outline the scene.
        before: Widths to start from.
    """
    distances = _Distances.between(samples, truth)
    extent, log_flat = scene_extent(scene), np.log(_LEAST_OUTLIERS) + flat_log_density(scene)

    def score(widths: tuple[float, float]) -> float:
        log_density = distances.log_density(*widths) + np.log1p(-_LEAST_OUTLIERS)
        return float(np.logaddexp(log_flat, log_density).mean())

    bounds = [(low * unit, high * unit) for low, high, unit in zip(_NARROWEST, _WIDEST, (extent, 1.0), strict=True)]
    found = minimize(
        lambda x: -score((float(np.exp(x[0])), float(np.exp(x[1])))),
        np.log([np.clip(value, *bound) for value, bound in zip(before, bounds, strict=True)]),
        method="Nelder-Mead",
        bounds=np.log(bounds),
        options={"xatol": 0.01, "fatol": 1e-4},
    )
    width_m, width_rad = (float(width) for width in np.exp(found.x))
    names = "bandwidth_translation_m", "bandwidth_rotation_rad"
    formerly: dict[str, float | Six] = dict(zip(names, before, strict=True))
    values: dict[str, float | Six] = dict(zip(names, (width_m, width_rad), strict=True))
    return (width_m, width_rad), Change("kernel widths", formerly, values, score((width_m, width_rad)) - score(before))


@dataclass(frozen=True)
class _Distances:
    """Squared distances of true poses (n,) from the samples (n, m) of their images: computed once.

    Attributes:
        squared_m2: Of translation.
        squared_chord: 2 − 2 cos of the angle.
    """

    squared_m2: Float32[np.ndarray, "n m"]
    squared_chord: Float32[np.ndarray, "n m"]

    @staticmethod
    def between(samples: Sequence[Poses], truth: Poses) -> _Distances:
        apart = [poses.distance(truth[i]) for i, poses in enumerate(samples)]
        squared_m2 = np.array([np.square(metres) for metres, _ in apart], np.float32)
        return _Distances(squared_m2, np.array([2 - 2 * np.cos(radians) for _, radians in apart], np.float32))

    def log_density(self, width_m: float, width_rad: float) -> Float64[np.ndarray, " n"]:
        """Log of the kernel density at each true pose, (n,), per m³ rad³."""
        n, m = self.squared_m2.shape
        log_sum = np.empty(n)
        scale_m, scale_rad = np.float32(-0.5 / width_m**2), np.float32(-0.5 / width_rad**2)
        for start in range(0, n, _BLOCK):
            rows = slice(start, start + _BLOCK)
            exponent = self.squared_m2[rows] * scale_m
            exponent += self.squared_chord[rows] * scale_rad
            top = exponent.max(axis=1, keepdims=True)
            log_sum[rows] = top[:, 0] + np.log(np.exp(exponent - top).sum(axis=1), dtype=np.float64)
        kernel = KernelDensity(Poses.identity(1), width_m, width_rad)
        return log_sum - np.log(m) - kernel.log_normaliser[0]
