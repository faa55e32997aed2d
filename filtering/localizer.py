"""The particle filter: image by image, from posterior samples and odometry to an estimate."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Generic

import numpy as np

from filtering.checked import CheckedPosterior
from filtering.errors import VaporTrackError, require_within
from filtering.estimate import Estimate, Mode, ModeConfig, Status, describe_modes, find_hypotheses
from filtering.motion import Odometry, require_odometry
from filtering.particles import Particles, log_mean
from filtering.posterior import ObservationModel, PosePosterior, Posterior
from filtering.proposal import Proposal, mixture_log_weights, propose
from filtering.recovery import Recovery, RecoveryConfig
from filtering.regularisation import KernelConfig
from filtering.sample_size import SampleSizeConfig, draw_enough
from filtering.se3 import Poses


@dataclass(frozen=True)
class LocalizerConfig:
    """Settings of the filter; the defaults serve a hand-held camera or a slow robot in a building."""

    num_particles: int | None = None
    """Particles that carry the belief; None for as many as it needs (see `sample_size`)."""
    injection_fraction: float = 0.1
    """φ: share of the particles that every image's posterior draws anew."""
    converged_weight: float = 0.9
    """Status is "converged" from this share of the belief in the best mode on."""
    converged_std_m: float = 0.5
    """And with at most this standard deviation of its position, in metres, along its widest axis."""
    converged_doubt: float = 0.25
    """And while the images cast no more doubt on the belief than this (0: none, 1: they contradict it). Without
    particles drawn from the images (φ = 0) nothing is doubted."""
    lost_log_evidence: float = 0.07
    """Status is "lost" while the running mean of the log evidence is below this (0: every image an outlier)."""
    evidence_decay: float = 0.9
    """Share of the running mean of the log evidence that an image leaves unchanged."""
    switch_ratio: float = 1.5
    """Another mode becomes the best one when it outweighs the present best by this factor."""
    sample_size: SampleSizeConfig = field(default_factory=SampleSizeConfig)
    """How many particles the belief needs."""
    kernels: KernelConfig = field(default_factory=KernelConfig)
    """How the belief is carried from image to image."""
    recovery: RecoveryConfig = field(default_factory=RecoveryConfig)
    """When the belief is doubted."""
    modes: ModeConfig = field(default_factory=ModeConfig)
    """What counts as one hypothesis."""

    def __post_init__(self) -> None:
        require_within(
            self,
            injection_fraction=(0.0, 0.99),
            converged_weight=(0.0, 1.0),
            converged_std_m=(0.0, 1e6),
            converged_doubt=(0.0, 1.0),
            lost_log_evidence=(-1e6, 1e6),
            evidence_decay=(0.0, 0.9999),
            switch_ratio=(1.0, 1e9),
        )
        if self.num_particles is not None:
            require_within(self, num_particles=(1, 10**7))

    @property
    def size(self) -> SampleSizeConfig:
        """How many particles: `num_particles` if given, else what the belief needs."""
        n = self.num_particles
        return self.sample_size if n is None else replace(self.sample_size, min_particles=n, max_particles=n)


class ParticleLocalizer(Generic[Posterior]):
    """Localizes a camera from images and odometry; the filter's one mutable object.

    Args:
        model: Maps an image to its posterior over poses; None where posteriors are at hand, for `update` alone.
        config: Settings of the filter.
        rng: Source of all randomness; the model's draws and the filter's come from two streams spawned from it.
    """

    def __init__(
        self,
        model: ObservationModel[Posterior] | None,
        config: LocalizerConfig | None = None,
        *,
        rng: np.random.Generator,
    ) -> None:
        self.model = model
        self.config = config or LocalizerConfig()
        self._model_rng, self._filter_rng = rng.spawn(2)
        self._belief: Particles | None = None
        self._label = np.empty(0, np.int64)
        self._best: Poses | None = None
        self._mean_log_evidence: float | None = None
        self._recovery = Recovery()

    def step(self, image: np.ndarray, odom: Odometry | None) -> Estimate:
        """Localize one image.

        Args:
            image: RGB, uint8, (H, W, 3).
            odom: Motion of the camera since the previous step. On the first step there is no previous image, and it
                is not used. None on a later step means that the motion is unknown: the belief starts anew.

        Raises:
            VaporTrackError: the image is refused by the model, the odometry is none (`require_odometry`), the posterior
                answers what is no density (`CheckedPosterior`), or no particle is left any weight. The localizer is
                then as it was before, so a step that is tried again with good input gives what it would have given.
        """
        before = self._model_rng.bit_generator.state
        try:
            return self.update(self.observe(image), odom)
        except BaseException:
            self._model_rng.bit_generator.state = before
            raise

    def observe(self, image: np.ndarray) -> Posterior:
        """The posterior of one image (H, W, 3), uint8 RGB: the first half of `step`, one call of the model.

        Raises:
            VaporTrackError: there is no model, or it refuses the image.
        """
        if self.model is None:
            raise VaporTrackError("this localizer has no observation model, expected posteriors through `update`")
        return self.model.observe(image, rng=self._model_rng)

    def update(self, posterior: PosePosterior, odom: Odometry | None) -> Estimate:
        """Localize one image whose posterior is at hand: the second half of `step`; raises as it does."""
        # All state but the generator's is replaced, never changed in place: a shallow copy is a full one.
        before, generator = dict(vars(self)), self._filter_rng.bit_generator.state
        try:
            return self._update(CheckedPosterior(posterior), odom)
        except BaseException:
            vars(self).update(before)
            self._filter_rng.bit_generator.state = generator
            raise

    def _update(self, posterior: CheckedPosterior, odom: Odometry | None) -> Estimate:
        if self._belief is None or odom is None:
            self._best = None
            particles, log_evidence = self._start(posterior)
        else:
            require_odometry(odom)
            if self._best is not None:
                self._best = self._best @ odom.previous_from_current
            particles, log_evidence = self._continue(self._belief, posterior, odom)
        particles = self._settle(particles, posterior, first=odom is None or self._belief is None)
        self._belief = particles
        modes = self._order(describe_modes(particles, self._label, self.config.modes))
        if self._best is not None and not self.config.modes.same_place(modes[0].world_from_camera, self._best):
            self._recovery = self._recovery.reset()  # the doubt has led to another place, which starts without it
        self._best = modes[0].world_from_camera
        return Estimate(
            modes,
            self._status(modes, log_evidence),
            particles.poses,
            particles.log_weights,
            particles.effective_sample_size,
            log_evidence,
        )

    def _start(self, posterior: PosePosterior) -> tuple[Particles, float]:
        """The first belief is the image's posterior, untempered, as no image before it shares its errors."""
        poses, _ = draw_enough(lambda size: posterior.sample(size, rng=self._filter_rng), self.config.size)
        particles, _ = Particles.from_unnormalised(poses, np.zeros(len(poses)))
        log_likelihood = posterior.log_likelihood(poses)
        self._recovery = Recovery()
        self._mean_log_evidence = None
        return particles, log_mean(log_likelihood)

    def _continue(self, belief: Particles, posterior: PosePosterior, odom: Odometry) -> tuple[Particles, float]:
        """Propagate, inject, weigh."""
        c = self.config
        proposal = propose(
            belief,
            self._label,
            odom,
            posterior,
            sample_size=c.size,
            injection_fraction=c.injection_fraction,
            kernels=c.kernels,
            rng=self._filter_rng,
        )
        log_likelihood = posterior.log_likelihood(proposal.poses)
        log_evidence = proposal.log_evidence(log_likelihood)
        num_moved = proposal.num_from_motion
        if num_moved < len(log_likelihood):
            self._recovery = self._recovery.update(log_evidence, log_mean(log_likelihood[num_moved:]), c.recovery)
        log_weights = self._weigh(proposal, log_likelihood)
        particles, _ = Particles.from_unnormalised(proposal.poses, log_weights)
        return particles, log_evidence

    def _weigh(self, proposal: Proposal, log_likelihood: np.ndarray) -> np.ndarray:
        """Log weights of the particles, not normalised, (n,)."""
        kidnap_probability = self._recovery.kidnap_probability(self.config.recovery)
        return mixture_log_weights(proposal, log_likelihood, kidnap_probability=kidnap_probability)

    def _settle(self, particles: Particles, posterior: CheckedPosterior, *, first: bool) -> Particles:
        """Find the hypotheses, and weigh each one's particles by what the image says of details, the shares kept.

        A first belief is the image's posterior, and has its details already.
        """
        log_detail = None if first else posterior.log_detail(particles.poses)
        detailed = particles if log_detail is None else particles.reweighted(log_detail)
        self._label = find_hypotheses(detailed, self.config.modes, rng=self._filter_rng)
        return particles if log_detail is None else detailed.keep_shares(particles, self._label)

    def _order(self, modes: tuple[Mode, ...]) -> tuple[Mode, ...]:
        """Keep the previous best mode first unless another clearly outweighs it."""
        if self._best is None or len(modes) == 1:
            return modes
        for k, mode in enumerate(modes):
            if self.config.modes.same_place(mode.world_from_camera, self._best):
                if modes[0].weight < self.config.switch_ratio * mode.weight:
                    return (mode, *modes[:k], *modes[k + 1 :])
                break
        return modes

    def _status(self, modes: tuple[Mode, ...], log_evidence: float) -> Status:
        if log_evidence == -np.inf:  # impossible everywhere; in the running mean it would stay for good
            return "lost"
        previous = log_evidence if self._mean_log_evidence is None else self._mean_log_evidence
        decay = self.config.evidence_decay
        self._mean_log_evidence = decay * previous + (1 - decay) * log_evidence
        if self._mean_log_evidence < self.config.lost_log_evidence:
            return "lost"
        best, c = modes[0], self.config
        sure = best.weight >= c.converged_weight and best.widest_std_m <= c.converged_std_m
        return "converged" if sure and self._recovery.doubt <= c.converged_doubt else "ambiguous"
