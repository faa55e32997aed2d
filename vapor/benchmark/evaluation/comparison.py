"""Every tracking method over the same images, and what each was worth against the truth."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Int64

from filtering.estimate import Mode
from filtering.floors import Floors
from filtering.se3 import Poses
from sequences.frame import Trajectory
from vapor.benchmark.evaluation.lengths import scaled_belief, scaled_mode, scaled_poses
from vapor.evaluation.consistency import evaluate_belief, truth_among_modes
from vapor.evaluation.floors import evaluate_floor, floor_accuracy
from vapor.evaluation.trajectory import evaluate_trajectory
from vapor.tracking.follow import Followed
from vapor.tracking.loop import Belief
from vapor.tracking.methods import METHODS, in_order


@dataclass(frozen=True)
class Comparison:
    """What every method made of a passage of n images.

    Attributes:
        times_ns: Stamps, (n,).
        truth: True poses, batch (n,).
        poses: Poses of every method by its name in `METHODS`, world_from_camera, batches (n,).
        beliefs: What the filter and each baseline believed, by name.
        image_modes: Places of each image's posterior alone, (n,).
        particles: Median number of particles of the filter.
        step_ms: Median milliseconds of a step of the filter.
        kidnap_index: First image after the camera was carried off; None where it was not.
    """

    times_ns: Int64[np.ndarray, " n"]
    truth: Poses
    poses: dict[str, Poses]
    beliefs: dict[str, Belief]
    image_modes: tuple[tuple[Mode, ...], ...]
    particles: int
    step_ms: float
    kidnap_index: int | None = None

    def figures(
        self,
        images: Bool[np.ndarray, " n"] | None = None,
        *,
        floor_height_m: float | None = None,
        floors: Floors | None = None,
    ) -> dict[str, Any]:
        """What every method was worth, as JSON.

        Args:
            images: Which images count, at least one; None for all.
            floor_height_m: From floor to floor, in the unit of the poses, where floors look alike.
            floors: Of the building, where there are several, in the unit of the poses.

        Returns:
            `images`, `methods` (see `evaluate_trajectory`), `belief` of the baselines and of the filter (see
            `evaluate_belief`), `image_truth_among_modes` (of the single images' posteriors), `particles` and `step_ms`.
            Where floors look alike, `methods` have `floor` (see `evaluate_floor`), and `belief` has `on_floor`. Where
            there are several, `methods` have `floor_accuracy`.
        """
        every = np.ones(len(self.times_ns), bool)
        at = np.flatnonzero(every if images is None else images)
        times_ns, truth = self.times_ns[at], self.truth[at]
        methods = {
            name: evaluate_trajectory(
                Trajectory(times_ns, poses[at]),
                Trajectory(times_ns, truth),
                # Whoever is carried off has no one moment from which on all is right.
                tracking=METHODS[name].can_converge and self.kidnap_index is None,
            )
            for name, poses in in_order(self.poses).items()
        }
        if floor_height_m is not None:
            for name, each in methods.items():
                each["floor"] = evaluate_floor(self.poses[name][at], truth, floor_height_m)
        if floors is not None:
            for name, each in methods.items():
                each["floor_accuracy"] = floor_accuracy(self.poses[name][at], truth, floors)
        belief = {
            name: evaluate_belief(
                Belief([each.modes[i] for i in at.tolist()], [each.status[i] for i in at.tolist()]),
                times_ns,
                truth,
                converged_at_s=methods[name].get("converged_at_s"),
                kidnap_index=self.kidnap_index,
                floor_height_m=floor_height_m,
            )
            for name, each in self.beliefs.items()
        }
        return {
            "images": len(at),
            "methods": methods,
            "belief": belief,
            "image_truth_among_modes": truth_among_modes([self.image_modes[i] for i in at.tolist()], truth),
            "particles": self.particles,
            "step_ms": self.step_ms,
        }

    def scaled(self, factor: float) -> Comparison:
        """The same where all lengths are multiplied by a factor: evaluated in metres, or in another unit."""
        return replace(
            self,
            truth=scaled_poses(self.truth, factor),
            poses={name: scaled_poses(each, factor) for name, each in self.poses.items()},
            beliefs={name: scaled_belief(belief, factor) for name, belief in self.beliefs.items()},
            image_modes=tuple(tuple(scaled_mode(mode, factor) for mode in modes) for modes in self.image_modes),
        )


def compare(followed: Followed) -> Comparison:
    """Every method over a passage: those that went from image to image, and those that see it as a whole."""
    return Comparison(
        followed.passage.times_ns,
        followed.passage.truth,
        followed.poses | followed.poses_at_end(),
        followed.beliefs,
        followed.image_modes,
        followed.particles,
        followed.step_ms,
        followed.kidnap_index,
    )
