"""One step of the particle filter: predict or initialize, measure, add births, correct by gravity, reduce, describe.

Each stage takes a belief and gives the next one; nothing is changed in place.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from filtering.agreement import disagrees, follow_agreement, following
from filtering.association import Correlation, correct, evidence, gate
from filtering.belief import Belief
from filtering.births import BIRTHS
from filtering.cameras import CameraMemory
from filtering.config import LocalizerConfig
from filtering.errors import VaporTrackError
from filtering.estimate import Estimate, Mode, Status, describe_modes
from filtering.hypotheses import (
    RIGHT,
    Hypotheses,
    birth,
    concatenate,
    log_sum,
    odometry_bias_of,
    with_drift,
    with_source,
)
from filtering.measurement_noise import MeasurementNoise
from filtering.mixture_reduction import reduce_mixture, resample
from filtering.motion import Odometry, OdometryBias, require_odometry
from filtering.observation import Observation, View
from filtering.posterior import PosePosterior
from filtering.prediction import Gap, across_gap, gap_motion, leaps, moved, unknown_velocity, usual_speed, with_regimes
from filtering.prediction import predict as predict_hypotheses
from filtering.resampling import copied
from filtering.unchecked import unchecked_replace
from filtering.vertical import Vertical, VerticalMemory, corrected_by


def step(belief: Belief, observation: Observation, config: LocalizerConfig) -> tuple[Belief, Estimate]:
    """The belief one step later, and its estimate.

    Raises:
        VaporTrackError: the odometry is invalid (`require_odometry`), which a first step does not use, or no view has
            any place at a first step.
    """
    views = observation.ranked_views
    informative = [view for view in views if not view.posterior.is_uninformative]
    belief = predict(belief, observation.odometry, observation.elapsed_s, config, sees=bool(informative))
    novelty = 0.0
    if needs_initialization(belief, views):
        belief = initialize(belief, views, config)  # from the first of these views, all of which is new
        informative, novelty = informative[1:], 1.0
    belief = with_cameras(belief, informative, config)
    used: list[UsedView] = []
    for view in informative:
        after, used_view = measure(belief, view, config)
        if disagrees(belief, view.camera, config):  # its views are followed, as it may recover, but do not count
            belief = belief.with_camera(view.camera, after.cameras[view.camera])
        else:
            belief = after
            used.append(used_view)
    novelty = max([novelty, *(each.novelty for each in used)])
    belief = add_births(belief, used, novelty, config)
    belief = measure_vertical(belief, observation.vertical)
    if informative or novelty > 0.0:
        belief = reduce(belief, config)
    belief = follow_agreement(belief, [one.agreement for one in used], views, config)
    log_likelihood = sum((one.log_likelihood for one in used), 0.0)
    belief, estimate = describe(belief, views, novelty, config, log_likelihood=log_likelihood)
    if views:
        belief = unchecked_replace(belief, normalized_distance=0.0)
    return belief, estimate


def predict(
    belief: Belief, odometry: Odometry | None, elapsed_s: float, config: LocalizerConfig, *, sees: bool
) -> Belief:
    """Move the belief by odometry, or across a gap of `elapsed_s` seconds without any; `sees`: to an image."""
    if belief.hypotheses is None:
        return belief
    if odometry is None:
        return _across_gap(belief, Gap.of(None, elapsed_s, config.gap.velocity), config)
    require_odometry(odometry)
    if not odometry.knows_translation:
        return _across_gap(belief, Gap.of(odometry, elapsed_s, config.gap.velocity), config)
    noise, usual = noise_of(belief), belief.usual_m_per_s
    belief = unchecked_replace(belief, usual_m_per_s=usual_speed(usual, odometry))
    if config.odometry_failures_per_s > 0.0 and leaps(odometry, usual, noise):
        return _across_gap(belief, Gap.of(None, odometry.duration_s, config.gap.velocity), config)
    hypotheses = hypotheses_of(belief)
    if belief.drift is not None:  # a gap has ended
        hypotheses = with_drift(hypotheses, *belief.drift)
    bias, velocity = config.odometry_bias, unknown_velocity(noise, config.gap)
    likely = odometry.rescaled(odometry_bias_of(hypotheses)[0][0])
    after = {name: camera.predict(likely) for name, camera in belief.cameras.items()}
    distances, vertical = _by_source(after, belief.vertical)
    if sees:  # without images a failure would not show
        since_s = belief.unseen_s + odometry.duration_s
        rates = config.odometry_failures_per_s, config.odometry_failure_s
        hypotheses = with_regimes(hypotheses, odometry, bias, noise, since_s, *rates)
    after_motion = moved(hypotheses, odometry, bias, velocity, distances)
    return unchecked_replace(
        belief,
        hypotheses=after_motion,
        cameras={name: camera.later(odometry.duration_s) for name, (camera, _) in after.items()},
        vertical=vertical,
        known=belief.known.carried(hypotheses, after_motion.poses, noise, config.modes),
        drift=None,
        unseen_s=belief.unseen_s + odometry.duration_s,
        gap_motion=None,
        normalized_distance=belief.normalized_distance + distances[0],
    )


def _across_gap(belief: Belief, gap: Gap, config: LocalizerConfig) -> Belief:
    """Move the belief without odometry: the drift of each hypothesis is the velocity of the camera until it returns."""
    elapsed_s = gap.known.duration_s
    hypotheses, drift = hypotheses_of(belief), belief.drift
    if drift is None:  # the gap begins
        mean, covariance = odometry_bias_of(hypotheses)
        drift = mean[1:], covariance[1:, 1:]
        hypotheses = unchecked_replace(hypotheses, regime=np.full(len(hypotheses), RIGHT))
        hypotheses = with_drift(hypotheses, np.zeros(6), np.eye(6))
    motion = gap_motion(hypotheses, belief.unseen_s, gap, config.gap)
    after = {name: camera.across_gap(motion) for name, camera in belief.cameras.items()}
    distances, vertical = _by_source(after, belief.vertical)
    forgets = config.gap.action == "forget"
    after_gap = across_gap(hypotheses, gap, distances)
    return unchecked_replace(
        belief,
        hypotheses=after_gap,
        cameras={name: camera.later(elapsed_s) for name, (camera, _) in after.items()},
        vertical=vertical,
        known=belief.known.carried(hypotheses, after_gap.poses, noise_of(belief), config.modes),
        drift=drift,
        agreement=0.0 if forgets else belief.agreement,
        unseen_s=belief.unseen_s + elapsed_s,
        provisional=belief.provisional or forgets,
        gap_motion=motion,
        normalized_distance=belief.normalized_distance + distances[0],
    )


def _by_source(
    after: Mapping[str, tuple[CameraMemory, list[float]]], vertical: VerticalMemory | None
) -> tuple[list[float], VerticalMemory | None]:
    """Distances that cameras moved, in the order of the sources in the state, and the memory of verticals then.

    Errors of a vertical last for lengths of the first camera's network.
    """
    numbered = {
        source.number: distance
        for camera, distances in after.values()
        for source, distance in zip(camera.sources, distances, strict=True)
    }
    if vertical is not None:
        vertical, numbered[vertical.number] = vertical.predict(numbered[0])
    return [numbered[number] for number in sorted(numbered)], vertical


@dataclass(frozen=True)
class UsedView:
    """A view after its measurement.

    Attributes:
        posterior: Of its image, for the reference frame, with the measurement noise scaled.
        camera: The memory of its camera after it.
        novelty: Of the view, in [0, 1].
        likelihood_power: Power of the image's likelihood, in [0, 1]: correlated images count once.
        log_likelihood: Of the belief, given the image: 0 where it fits all of it.
        agreement: The fraction of the belief that the image fits, in [0, 1].
    """

    posterior: PosePosterior
    camera: CameraMemory
    novelty: float
    likelihood_power: float
    log_likelihood: float
    agreement: float


def follow_mount(belief: Belief, view: View) -> Belief:
    """Move the camera of a view on its mount, where the extrinsics changed: it sees something else from there."""
    camera = belief.cameras[view.camera]
    if camera.has_extrinsics(view.reference_from_camera):
        return belief
    camera, moved = camera.moved_to(view.reference_from_camera)
    distances = np.zeros(belief.num_sources)
    distances[[source.number for source in camera.sources]] = moved
    hypotheses = predict_hypotheses(hypotheses_of(belief), Odometry.still(), OdometryBias(), distances.tolist())
    return unchecked_replace(belief.with_camera(view.camera, camera), hypotheses=hypotheses)


def measure(belief: Belief, view: View, config: LocalizerConfig) -> tuple[Belief, UsedView]:
    """Weight every hypothesis by an image, and correct it by each place that it may see.

    `evidence` decides which place, and `correct` where in it: densities split a hypothesis, and share the weight of
    those at one place. Between places they do not count: otherwise a wrong place with tight samples would outweigh the
    right one with loose samples.
    """
    belief = follow_mount(belief, view)
    before = belief.cameras[view.camera]
    camera, novelty, likelihood_power = before.observe(view.posterior)
    # The scale of the noise includes this image.
    posterior = view.posterior.inflated(*(source.scale.factor for source in camera.sources))
    posterior = posterior.seen_from(view.reference_from_camera)
    hypotheses = hypotheses_of(belief)
    correlations = [Correlation(source.number, source.tracker.normalized_distance) for source in before.sources]
    pairs = gate(hypotheses, posterior, correlations)
    known = belief.known.innovated(hypotheses, pairs, noise_of(belief), config.modes)
    found = evidence(hypotheses, posterior, pairs, config.outlier_places)
    camera = camera.after_view(found.agreement, following(camera.unseen_s, config))
    hypotheses = hypotheses.reweighted(likelihood_power * found.log_likelihood)
    # What is unassigned may be at any place of the image.
    assigned = (1.0 - belief.unassigned) * float(np.exp(log_sum(hypotheses.log_weights)))
    total = assigned + belief.unassigned
    hypotheses = correct(hypotheses, posterior, pairs, found.outlier).normalized()
    belief = unchecked_replace(
        belief.with_camera(view.camera, camera),
        hypotheses=hypotheses,
        unassigned=belief.unassigned / total,
        known=known,
        calibrated=posterior.calibrated,
    )
    return belief, UsedView(posterior, camera, novelty, likelihood_power, float(np.log(total)), found.agreement)


def measure_vertical(belief: Belief, vertical: Vertical | None) -> Belief:
    """Correct every hypothesis, newborn ones included, by gravity and height."""
    if vertical is None or vertical.degrees_of_freedom == 0 or belief.hypotheses is None:
        return belief
    hypotheses, memory = belief.hypotheses, belief.vertical
    if memory is None:
        hypotheses, memory = with_source(hypotheses), VerticalMemory(belief.num_sources, vertical.lengths)
    hypotheses = corrected_by(vertical, hypotheses, memory)
    return unchecked_replace(belief, hypotheses=hypotheses, vertical=memory.observe(vertical))


def add_births(belief: Belief, used: Sequence[UsedView], novelty: float, config: LocalizerConfig) -> Belief:
    """Let the places of the images take over what is unassigned, and more of the belief where the images cast doubt.

    Of the unassigned mass an image with outlier probability ε leaves ε, and what its weights lack to 1.
    """
    if not used or not config.has_births:
        return belief
    agreement = float(np.mean([one.agreement for one in used]))
    carried = BIRTHS[config.births](belief, novelty, agreement, config)
    unassigned = belief.unassigned + carried * (1.0 - belief.unassigned)
    parts = [hypotheses_of(belief).reweighted(_log(1.0 - unassigned))]
    for one in used:
        taken = one.likelihood_power / len(used) * unassigned * assigned_by(one.posterior)
        if taken > 0.0:
            parts.append(born_at(one.posterior, one.camera, belief, config).reweighted(_log(taken)))
            unassigned -= taken
    if len(parts) == 1:
        return unchecked_replace(belief, unassigned=unassigned)
    return unchecked_replace(belief, hypotheses=concatenate(parts).normalized(), unassigned=unassigned)


def assigned_by(posterior: PosePosterior) -> float:
    """Probability that an image shows the true place."""
    return (1.0 - posterior.outlier_probability) * float(posterior.weights.sum())


def reduce(belief: Belief, config: LocalizerConfig) -> Belief:
    """Prune light hypotheses, merge those that agree, and resample beyond `max_hypotheses`."""
    hypotheses, rng = hypotheses_of(belief), belief.rng
    reduced = reduce_mixture(hypotheses, divergence=config.merge_divergence, least_weight=config.least_weight)
    if len(reduced) > config.max_hypotheses:
        rng = copied(rng)
        reduced = resample(reduced, config.max_hypotheses, config.resampling, rng=rng)
    return unchecked_replace(belief, hypotheses=reduced, rng=rng)


# --- the beginning -------------------------------------------------------------------------------------


def needs_initialization(belief: Belief, views: Sequence[View]) -> bool:
    """Whether these views alone make the belief."""
    informative = not all(view.posterior.is_uninformative for view in views)
    return belief.hypotheses is None or (belief.provisional and informative)


def initialize(belief: Belief, views: Sequence[View], config: LocalizerConfig) -> Belief:
    """The belief of the first informative view; one of an out-of-distribution view is provisional.

    Raises:
        VaporTrackError: no view has any place.
    """
    informative = [view for view in views if not view.posterior.is_uninformative]
    candidates, provisional = (
        informative or [view for view in views if view.posterior.is_out_of_distribution],
        not informative,
    )
    first = next((view for view in candidates if view.posterior.weights.any()), None)
    if first is None:
        raise VaporTrackError("the first image has no place of any weight, expected at least one")
    agreement = 0.0 if provisional else 1.0
    new = unchecked_replace(
        belief.forgotten(),
        agreement=agreement,
        usual_agreement=agreement,
        provisional=provisional,
        calibrated=first.posterior.calibrated,
    )
    camera = CameraMemory.first_seen(first, 0, unknown=0.0, adapts=config.adapt_errors)
    new = new.with_camera(first.camera, camera)
    posterior = first.posterior.seen_from(first.reference_from_camera)
    unassigned = 1.0 - assigned_by(posterior) if config.has_births else 0.0
    return unchecked_replace(new, hypotheses=born_at(posterior, camera, new, config), unassigned=unassigned)


def with_cameras(belief: Belief, views: Sequence[View], config: LocalizerConfig) -> Belief:
    """The same with the correlated errors of every camera of these views, and of its landmarks, in the state."""
    before, adapts = belief.num_sources, config.adapt_errors
    for view in views:
        number, known_camera = belief.num_sources, belief.cameras.get(view.camera)
        # The first image of another camera is all new.
        camera = (
            CameraMemory.first_seen(view, number, unknown=1.0, adapts=adapts)
            if known_camera is None
            else known_camera.with_landmarks(view, number, unknown=1.0, adapts=adapts)
        )
        belief = belief.with_camera(view.camera, camera)
    hypotheses = hypotheses_of(belief)
    for _ in range(before, belief.num_sources):
        hypotheses = with_source(hypotheses)
    return unchecked_replace(belief, hypotheses=hypotheses)


def born_at(posterior: PosePosterior, camera: CameraMemory, belief: Belief, config: LocalizerConfig) -> Hypotheses:
    """Hypotheses at the places of one image alone."""
    network, *others = [source.number for source in camera.sources]
    landmarks = others[0] if others else None
    return birth(posterior, network, belief.num_sources, config.odometry_bias, belief.hypotheses, landmarks)


# --- the estimate --------------------------------------------------------------------------------------


def describe(
    belief: Belief, views: Sequence[View], novelty: float, config: LocalizerConfig, *, log_likelihood: float = 0.0
) -> tuple[Belief, Estimate]:
    """The estimate of a belief, and the belief with its modes known.

    Modes and status are in units of the first camera's noise.
    """
    hypotheses, noise = hypotheses_of(belief), noise_of(belief)
    found = describe_modes(hypotheses, noise, config.modes, calibrated=belief.calibrated)
    modes, known = belief.known.identify(found, hypotheses, noise, config.modes)
    modes = tuple(
        unchecked_replace(mode, weight=(1.0 - belief.unassigned) * mode.weight)
        for mode in _ordered(modes, known.best, config)
    )
    estimate = Estimate(
        modes,
        _status(modes[0], belief, noise, config),
        hypotheses.poses,
        hypotheses.pose_covariance + noise.constant_covariance(hypotheses.pose_covariance),
        hypotheses.log_weights,
        belief.unassigned,
        log_likelihood,
        belief.agreement,
        novelty,
        belief.normalized_distance,
        max((view.posterior.ood_score for view in views), default=0.0),
        float(odometry_bias_of(hypotheses)[0][0]),
        belief.gap_motion,
        tuple(
            view.camera for view in views if view.camera in belief.cameras and disagrees(belief, view.camera, config)
        ),
    )
    return unchecked_replace(belief, known=unchecked_replace(known, best=modes[0].identity)), estimate


def _ordered(modes: tuple[Mode, ...], best: int, config: LocalizerConfig) -> tuple[Mode, ...]:
    """The previous best mode stays first unless another clearly outweighs it."""
    for k, mode in enumerate(modes):
        if mode.identity == best and modes[0].weight < config.switch_ratio * mode.weight:
            return (mode, *modes[:k], *modes[k + 1 :])
    return modes


def _status(best: Mode, belief: Belief, noise: MeasurementNoise, config: LocalizerConfig) -> Status:
    if belief.agreement < config.lost_agreement or belief.unassigned > config.lost_unassigned:
        return "lost"
    sure = best.weight >= config.converged_weight and best.widest_std_m <= config.widest_std_m(noise)
    return "converged" if sure and belief.agreement >= config.converged_agreement else "ambiguous"


def noise_of(belief: Belief) -> MeasurementNoise:
    """The noise of the first camera of a belief that has begun."""
    return next(iter(belief.cameras.values())).noise


def hypotheses_of(belief: Belief) -> Hypotheses:
    """The hypotheses of a belief that has begun."""
    assert belief.hypotheses is not None
    return belief.hypotheses


def _log(weight: float) -> float:
    return float(np.log(weight)) if weight > 0.0 else -np.inf
