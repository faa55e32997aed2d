"""The particle filter: image by image, from posteriors and odometry to an estimate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from filtering.association import associate
from filtering.cameras import SeenCamera, View
from filtering.config import LocalizerConfig
from filtering.error_model import ErrorModel
from filtering.errors import VaporTrackError
from filtering.estimate import Estimate, Mode, Status, describe_modes
from filtering.hypotheses import Hypotheses, born, concatenate, moved, reduced, widened, with_source, without_bias
from filtering.motion import Odometry, require_odometry
from filtering.posterior import ObservationModel, PosePosterior
from filtering.se3 import Poses

_ONLY = "camera"


class ParticleLocalizer:
    """Localizes a camera, or a rig of several, from images and odometry; the filter's one mutable object.

    Args:
        model: Maps an image to its posterior over poses; None where posteriors are at hand, for `update` alone.
        config: Settings of the filter.
        rng: Source of all randomness; the model's draws and the filter's come from two streams spawned from it.
    """

    def __init__(
        self, model: ObservationModel | None, config: LocalizerConfig | None = None, *, rng: np.random.Generator
    ) -> None:
        self.model = model
        self.config = config or LocalizerConfig()
        self._model_rng, self._filter_rng = rng.spawn(2)
        self._belief: Hypotheses | None = None
        self._cameras: dict[str, SeenCamera] = {}
        self._best: Poses | None = None
        self._agreement = 1.0  # of the latest images with the belief
        self._unseen_s = 0.0  # since an image that says something
        self._provisional = False  # the next image that says something replaces the belief
        self._way = 0.0
        self._last_image: np.ndarray | None = None

    def step(self, image: np.ndarray, odom: Odometry | None, *, elapsed_s: float = 1.0) -> Estimate:
        """Localize one image.

        Args:
            image: RGB, uint8, (H, W, 3).
            odom: Motion of the camera since the previous step. On the first step there is no previous image, and it
                is not used. None on a later step means that the motion is unknown: see `GapConfig`.
            elapsed_s: Seconds since the previous step; used where `odom` is None.

        Raises:
            VaporTrackError: the image is refused by the model, or as `update`. The localizer is then as it was before,
                so a step that is tried again with good input gives what it would have given.
        """
        before, last_image = self._model_rng.bit_generator.state, self._last_image
        try:
            return self.update(self.observe(image), odom, elapsed_s=elapsed_s)
        except BaseException:
            self._model_rng.bit_generator.state, self._last_image = before, last_image
            raise

    def observe(self, image: np.ndarray) -> PosePosterior:
        """The posterior of one image (H, W, 3), uint8 RGB: the first half of `step`, one call of the model.

        An image that equals the one before, pixel by pixel, comes from a camera that froze, and says nothing: no two
        exposures are equal. It stays as unlike the training images as it is: a black one is foreign however often it
        comes. What is no picture, uint8, may well come twice.

        Raises:
            VaporTrackError: there is no model, or it refuses the image.
        """
        if self.model is None:
            raise VaporTrackError("this localizer has no observation model, expected posteriors through `update`")
        posterior = self.model.observe(image, rng=self._model_rng)
        frozen = image.dtype == np.uint8 and self._last_image is not None and np.array_equal(self._last_image, image)
        self._last_image = np.array(image)
        if not frozen:
            return posterior
        nothing = PosePosterior.nothing(posterior.errors, posterior.samples)
        return replace(nothing, unfamiliarity=posterior.unfamiliarity)

    def update(
        self, seen: PosePosterior | Sequence[View], odom: Odometry | None, *, elapsed_s: float = 1.0
    ) -> Estimate:
        """Localize one moment whose posterior is at hand: the second half of `step`.

        Args:
            seen: What the camera says, or what several cameras of one moment say.
            odom: Motion since the previous step of what is localized: the camera, or with several the frame that their
                extrinsics lead to.
            elapsed_s: Seconds since the previous step; used where `odom` is None.

        Raises:
            VaporTrackError: the odometry is none (`require_odometry`), the elapsed time is negative, two views are of
                one camera, or no posterior has any place at a first step. The localizer is then as it was before.
        """
        views = [View(seen, Poses.identity(), _ONLY)] if isinstance(seen, PosePosterior) else list(seen)
        names = [view.camera for view in views]
        if len(set(names)) < len(names):
            raise VaporTrackError(f"views of cameras {', '.join(names)}, expected each once")
        if not 0.0 <= elapsed_s < np.inf:
            raise VaporTrackError(f"{elapsed_s} s since the previous step, expected a finite time of 0 s or more")
        # All state but the generator's is replaced, never changed in place: a shallow copy is a full one.
        before, generator = dict(vars(self)), self._filter_rng.bit_generator.state
        try:
            self._move(odom, elapsed_s)
            return self._look(views)
        except BaseException:
            vars(self).update(before)
            self._filter_rng.bit_generator.state = generator
            raise

    def predict(self, odom: Odometry | None, *, elapsed_s: float = 0.0) -> Estimate:
        """Move the belief without an image.

        Args:
            odom: Motion since the previous step; None where it is unknown, see `GapConfig`.
            elapsed_s: Seconds since the previous step; used where `odom` is None.

        Raises:
            VaporTrackError: there is no belief yet, or the odometry is none (`require_odometry`).
        """
        if self._belief is None:
            raise VaporTrackError("nothing to predict from: no image was localized yet")
        self._move(odom, elapsed_s)
        return self._look([])

    def forget(self) -> None:
        """Forget where the camera is: the next image that says something begins anew."""
        self._belief, self._best, self._cameras, self._last_image = None, None, {}, None
        self._agreement, self._unseen_s, self._provisional, self._way = 1.0, 0.0, False, 0.0

    def start_at(
        self, world_from_camera: Poses, covariance: Float64[np.ndarray, "6 6"], errors: ErrorModel
    ) -> Estimate:
        """Begin anew where somebody says that the camera is.

        Args:
            world_from_camera: One pose.
            covariance: Of ξ = (v, ω), metres and radians, in the tangent at the pose; positive definite.
            errors: How the images to come err.

        Raises:
            VaporTrackError: the pose or its covariance is none. The localizer is then as it was before.
        """
        pose = Poses.stack([world_from_camera])
        stated = PosePosterior(pose, np.asarray(covariance, np.float64)[None], np.ones(1), errors, pose)
        self.forget()
        self._start([View(stated, Poses.identity(), _ONLY)], provisional=False)
        belief = self._belief
        assert belief is not None
        # What was stated errs in its own way, not as the images do.
        self._belief = replace(belief, covariance=without_bias(belief.covariance, 0))
        return self._estimate(self._belief, 0.0, 0.0)

    def _move(self, odom: Odometry | None, elapsed_s: float) -> None:
        """Carry the belief to the present, on odometry or across a gap."""
        if self._belief is None:
            return
        gap = self.config.gap
        if odom is not None:
            require_odometry(odom)
            after = {name: camera.moved(odom) for name, camera in self._cameras.items()}
        else:
            if gap.action == "forget":
                self._provisional, self._agreement = True, 0.0
            likely = gap.speed_m_per_s * elapsed_s, gap.turn_rad_per_s * elapsed_s
            after = {name: camera.across_gap(*likely) for name, camera in self._cameras.items()}
            odom = Odometry(Poses.identity(), np.zeros((6, 6)), elapsed_s)
            self._belief = widened(self._belief, gap.covariance(elapsed_s))
        self._cameras = {name: camera for name, (camera, _) in after.items()}
        numbered = [
            (source.number, way)
            for camera, ways in after.values()
            for source, way in zip(camera.sources, ways, strict=True)
        ]
        ways = [way for _, way in sorted(numbered)]
        self._belief = moved(self._belief, odom, self.config.slow_errors, ways)
        self._way = ways[0] if ways else 0.0
        if self._best is not None:
            self._best = self._best @ odom.previous_from_current
        self._unseen_s += odom.duration_s

    def _look(self, views: Sequence[View]) -> Estimate:
        """Weigh and correct the belief by what is seen, and let a little of it begin anew there."""
        told = [view for view in views if not view.posterior.says_nothing]
        foreign = [view for view in views if view.posterior.is_foreign]
        novelty = 0.0
        if self._begins(views):
            self._start(told or foreign, provisional=not told)
            novelty, told = 1.0, told[1:]
        belief = self._known(told)
        fits: list[float] = []
        seen_by: list[tuple[PosePosterior, SeenCamera]] = []
        for view in told:
            before = self._cameras[view.camera].seen_through(view.reference_from_camera)
            camera, new_view, new = before.looked(view.posterior)
            novelty = max(novelty, new_view)
            self._cameras = self._cameras | {view.camera: camera}
            factors = [source.scale.factor for source in camera.sources]
            posterior = view.posterior.inflated(*factors).seen_from(view.reference_from_camera)
            network, *others = [(source.number, source.meter.way) for source in before.sources]
            landmarks = others[0] if others else None
            seen = associate(belief, posterior, network[0], novelty=new, way=network[1], landmarks=landmarks)
            seen_by.append((posterior, camera))
            belief = seen.hypotheses.with_log_weights(seen.hypotheses.log_weights)
            fits.append(seen.agreement)
        kidnapped = self._fraction_anew(novelty, float(np.mean(fits))) if fits else 0.0
        if kidnapped > 0.0:
            carried = replace(belief, log_weights=belief.log_weights + _log(1.0 - kidnapped))
            belief = concatenate([carried, *self._born(seen_by, belief, kidnapped)])
        if told or novelty > 0.0:
            belief = self._reduced(belief)
        self._belief = belief
        if fits or foreign:
            c = self.config
            follow = min(-np.expm1(-self._unseen_s / c.agreement_s), 1.0 / c.agreement_images)
            self._agreement += follow * (sum(fits) / (len(fits) + len(foreign)) - self._agreement)
            self._unseen_s = 0.0
        return self._estimate(belief, novelty, max((v.posterior.unfamiliarity for v in views), default=0.0))

    def _begins(self, views: Sequence[View]) -> bool:
        """Whether the belief is what these say, and nothing else."""
        return self._belief is None or (self._provisional and not all(view.posterior.says_nothing for view in views))

    def _fraction_anew(self, novelty: float, agreement: float) -> float:
        """The fraction of the belief that begins anew: the probability that the camera was carried off.

        Args:
            novelty: Of the view, in [0, 1].
            agreement: How much of the belief the images fit, in [0, 1].
        """
        doubt = 1.0 - min(1.0, agreement / self.config.converged_agreement)
        per_view = self.config.kidnap_per_view ** (1.0 - doubt) * self.config.max_kidnap_per_view**doubt
        return float(-np.expm1(-per_view * novelty))

    def _born(
        self, seen_by: Sequence[tuple[PosePosterior, SeenCamera]], belief: Hypotheses, fraction: float
    ) -> list[Hypotheses]:
        """What the views of cameras say, as if nothing else were known, with that fraction of the belief in all."""
        log_fraction = _log(fraction / len(seen_by))
        births = [self._begun(posterior, camera, belief) for posterior, camera in seen_by]
        return [replace(each, log_weights=each.log_weights + log_fraction) for each in births]

    def _begun(self, posterior: PosePosterior, camera: SeenCamera, belief: Hypotheses | None) -> Hypotheses:
        """What a camera's image says as if nothing else were known of where it is."""
        network, *others = [source.number for source in camera.sources]
        slow, landmarks = self.config.slow_errors, others[0] if others else None
        return born(posterior, network, self._num_sources, slow, belief, landmarks)

    @property
    def _num_sources(self) -> int:
        return sum(len(camera.sources) for camera in self._cameras.values())

    def _reduced(self, belief: Hypotheses) -> Hypotheses:
        c = self.config
        return reduced(
            belief,
            divergence=c.merge_divergence,
            least_weight=c.least_weight,
            most=c.max_hypotheses,
            rng=self._filter_rng,
        )

    def _start(self, views: Sequence[View], *, provisional: bool) -> None:
        """The first belief is what the first view says, with caution about how likely its places are."""
        first = next((view for view in views if len(view.posterior.weights)), None)
        if first is None:
            raise VaporTrackError("the first image says nothing about where the camera is, expected one that does")
        self._cameras, self._best, self._unseen_s = {}, None, 0.0
        self._agreement, self._provisional = 0.0 if provisional else 1.0, provisional
        self._add_camera(first)
        posterior = first.posterior.seen_from(first.reference_from_camera)
        self._belief = self._begun(posterior, self._cameras[first.camera], None)
        self._way = 0.0

    def _known(self, views: Sequence[View]) -> Hypotheses:
        """The belief, with room for the errors of every camera that is seen."""
        belief, known = self._belief, self._num_sources
        assert belief is not None
        for view in views:
            self._add_camera(view)
        for _ in range(known, self._num_sources):
            belief = with_source(belief)
        return belief

    def _add_camera(self, view: View) -> None:
        """Make room for the errors of a camera, and of the landmarks that it sees, where there is none yet."""
        # The first image of a camera is all new: it looks from a length away.
        unknown = 0.0 if self._belief is None else 1.0
        number, adapts = self._num_sources, self.config.adapt_errors
        seen = self._cameras.get(view.camera)
        camera = (
            SeenCamera.first_seen(view, number, unknown=unknown, adapts=adapts)
            if seen is None
            else seen.with_landmarks(view, number, unknown=unknown, adapts=adapts)
        )
        self._cameras = self._cameras | {view.camera: camera}

    def _estimate(self, belief: Hypotheses, novelty: float, unfamiliarity: float) -> Estimate:
        errors = next(iter(self._cameras.values())).errors
        modes = self._order(describe_modes(belief, errors, self.config.modes), errors)
        self._best = modes[0].world_from_camera
        return Estimate(
            modes,
            self._status(modes[0], errors),
            belief.poses,
            belief.pose_covariance + errors.constant_covariance(belief.pose_covariance),
            belief.log_weights,
            self._agreement,
            novelty,
            self._way,
            unfamiliarity,
        )

    def _order(self, modes: tuple[Mode, ...], errors: ErrorModel) -> tuple[Mode, ...]:
        """Keep the previous best mode first unless another clearly outweighs it."""
        if self._best is None or len(modes) == 1:
            return modes
        for k, mode in enumerate(modes):
            if self.config.modes.same_place(self._best, mode, errors):
                if modes[0].weight < self.config.switch_ratio * mode.weight:
                    return (mode, *modes[:k], *modes[k + 1 :])
                break
        return modes

    def _status(self, best: Mode, errors: ErrorModel) -> Status:
        c = self.config
        if self._agreement < c.lost_agreement:
            return "lost"
        widest = c.widest_std_m(errors)
        sure = best.weight >= c.converged_weight and best.widest_std_m <= widest
        return "converged" if sure and self._agreement >= c.converged_agreement else "ambiguous"


def _log(weight: float) -> float:
    return float(np.log(weight)) if weight > 0.0 else -np.inf
