"""Which mode is which from step to step, and how far the places of an image are from where each was expected."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float64, Int64

from filtering.association import Pairs
from filtering.estimate import Innovation, Mode, ModeConfig
from filtering.hypotheses import Hypotheses
from filtering.measurement_noise import MeasurementNoise
from filtering.se3 import Poses
from filtering.unchecked import unchecked_replace


def _no_numbers() -> Float64[np.ndarray, " 0"]:
    return np.zeros(0)


def _no_counts() -> Int64[np.ndarray, " 0"]:
    return np.zeros(0, np.int64)


@dataclass(frozen=True)
class KnownModes:
    """The k modes of the last estimate, moved since as the belief was, and those that became too light to report.

    Attributes:
        poses: world_from_camera, batch (k,).
        log_weights: At the last estimate, (k,).
        identities: Of each, (k,).
        squared: Normalised innovation squared of the images since, (k,).
        images: Number of these images, (k,).
        best: Identity of the best one; -1 before the first estimate.
        next_identity: The first that was never given.
    """

    poses: Poses = field(default_factory=lambda: Poses.identity(0))
    log_weights: Float64[np.ndarray, " k"] = field(default_factory=_no_numbers)
    identities: Int64[np.ndarray, " k"] = field(default_factory=_no_counts)
    squared: Float64[np.ndarray, " k"] = field(default_factory=_no_numbers)
    images: Int64[np.ndarray, " k"] = field(default_factory=_no_counts)
    best: int = -1
    next_identity: int = 0

    def __len__(self) -> int:
        return len(self.identities)

    def forgotten(self) -> KnownModes:
        """None, but no identity is given again."""
        return KnownModes(next_identity=self.next_identity)

    def carried(self, before: Hypotheses, after: Poses, noise: MeasurementNoise, config: ModeConfig) -> KnownModes:
        """The same after each has moved as the heaviest hypothesis in its place, or as the nearest where none is there.

        Args:
            before: n hypotheses before the motion.
            after: Their poses after it, batch (n,).
            noise: Of the first camera.
            config: Which hypotheses make one mode.
        """
        if len(self) == 0:
            return self
        moves = self._heaviest(before, noise, config)
        lone = (moves < 0).nonzero()[0]
        if len(lone):
            metres_sq, turned = self.poses[lone].squared_distances(before.poses)
            moves[lone] = np.argmin(metres_sq + turned, axis=1)
        return unchecked_replace(self, poses=after[moves] @ before.poses[moves].between(self.poses))

    def innovated(
        self, belief: Hypotheses, pairs: Sequence[Pairs], noise: MeasurementNoise, config: ModeConfig
    ) -> KnownModes:
        """The same with the normalised innovation squared of one more image: that of the place nearest to the heaviest
        hypothesis of each mode, before the image corrects it.

        Args:
            belief: Hypotheses before the correction.
            pairs: Of these and the image's places.
            noise: Of the first camera.
            config: Which hypotheses make one mode.
        """
        if len(self) == 0:
            return self
        squared = np.full(len(belief), np.inf)
        for each in pairs:
            np.minimum.at(squared, each.hypothesis, each.squared)
        heaviest = self._heaviest(belief, noise, config)
        of_mode = np.where(heaviest >= 0, squared[heaviest], np.inf)
        near = np.isfinite(of_mode)
        return unchecked_replace(self, squared=self.squared + np.where(near, of_mode, 0.0), images=self.images + near)

    def identify(
        self, modes: tuple[Mode, ...], belief: Hypotheses, noise: MeasurementNoise, config: ModeConfig
    ) -> tuple[tuple[Mode, ...], KnownModes]:
        """The same modes with their identities and innovations, and the modes known after them, `best` as before.

        A mode goes on where a mode is in its place now. The heaviest goes on first, in the nearest mode: so the
        identity of the heavier stays where two merge. A mode that is not reported stays known while a hypothesis is in
        its place.

        Args:
            modes: Of an estimate, by falling weight.
            belief: Their hypotheses.
            noise: Of the first camera.
            config: Which hypotheses make one mode.
        """
        poses = Poses.stack([mode.world_from_camera for mode in modes])
        reach = config.reach(noise, np.array([mode.covariance for mode in modes]))
        each = Poses(poses.rotation[:, None], poses.translation[:, None])
        offset = each.between(self.poses).log() / reach[:, None]
        metres, radians = offset[..., :3], offset[..., 3:]
        apart = np.maximum(np.vecdot(metres, metres), np.vecdot(radians, radians))
        known = _nearest(apart.tolist(), self.log_weights)
        found, next_identity = [], self.next_identity
        for mode, of in zip(modes, known, strict=True):
            if of < 0:
                found.append(unchecked_replace(mode, identity=next_identity))
                next_identity += 1
                continue
            images = int(self.images[of])
            innovation = Innovation(float(self.squared[of]), 6 * images) if images else None
            found.append(unchecked_replace(mode, identity=int(self.identities[of]), innovation=innovation))
        identities = np.array([mode.identity for mode in found])
        log_weights = np.log(np.maximum([mode.weight for mode in modes], 1e-300))
        unreported = (apart > 1.0).all(axis=0).nonzero()[0]
        if len(unreported):
            rest = unchecked_replace(
                self,
                poses=self.poses[unreported],
                log_weights=self.log_weights[unreported],
                identities=self.identities[unreported],
            )
            heaviest = rest._heaviest(belief, noise, config)
            kept = (heaviest >= 0).nonzero()[0][: config.max_modes]
            poses = Poses.concatenate([poses, belief.poses[heaviest[kept]]])
            identities = np.concatenate([identities, rest.identities[kept]])
            log_weights = np.concatenate([log_weights, belief.log_weights[heaviest[kept]]])
        count = len(identities)
        return tuple(found), KnownModes(
            poses, log_weights, identities, np.zeros(count), np.zeros(count, np.int64), self.best, next_identity
        )

    def _heaviest(self, belief: Hypotheses, noise: MeasurementNoise, config: ModeConfig) -> Int64[np.ndarray, " k"]:
        """The heaviest hypothesis in the place of each, nearer to it than to another one; -1 where there is none."""
        metres_sq, turned = self.poses.squared_distances(belief.poses)
        reach = config.reach(noise, belief.pose_covariance)
        apart = np.maximum(metres_sq / reach[:, :3].max(axis=1) ** 2, turned / reach[:, 3:].max(axis=1) ** 2)
        own: Bool[np.ndarray, "k n"] = (apart <= 1.0) & (apart == apart.min(axis=0))
        heaviest = np.where(own, belief.log_weights, -np.inf).argmax(axis=1)
        return np.where(own.any(axis=1), heaviest, -1)


def _nearest(apart: list[list[float]], log_weights: Float64[np.ndarray, " k"]) -> list[int]:
    """For each of m modes the known one that goes on in it, at most 1 apart; -1 for none."""
    known = [-1] * len(apart)
    for of in (-log_weights).argsort(kind="stable").tolist():
        free = [k for k, other in enumerate(known) if other < 0 and apart[k][of] <= 1.0]
        if free:
            known[min(free, key=lambda k: apart[k][of])] = of
    return known
