"""What faults change in what the methods are given: images that are missing or others, odometry that is wrong.

Each fault takes a replay of n images, and the images during which it lasts, at least one.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import replace
from functools import reduce

import numpy as np
from jaxtyping import Float64

from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.odometry import STATED_OVER_S, OdometryNoise, simulate_odometry
from vapor.benchmark.faults.timing import AHEAD_S, BEHIND_S, images_in
from vapor.benchmark.trials.replay import Replay


def no_images(replay: Replay, during: range) -> Replay:
    """The camera gives nothing, odometry continues: an image that says nothing moves the belief as `predict` does."""
    return _missing(replay, during)


def a_third(replay: Replay, during: range) -> Replay:
    """The camera gives a third of the images; odometry continues."""
    return _missing(replay, [image for image in during if (image - during.start) % 3])


def _missing(replay: Replay, images: Collection[int]) -> Replay:
    return shown(replay, images, lambda image: Poses.identity(0), np.zeros(len(replay.times_ns)))


def frozen(replay: Replay, during: range) -> Replay:
    """The last image is repeated, pixel by pixel: it says nothing, but is as unlike the training images as it was."""
    unfamiliarity = np.full(len(replay.times_ns), replay.unfamiliarity[max(during.start - 1, 0)])
    return shown(replay, during, lambda image: Poses.identity(0), unfamiliarity)


def shown(
    replay: Replay,
    during: Collection[int],
    posterior_poses: Callable[[int], Poses],
    unfamiliarity: Float64[np.ndarray, " n"],
) -> Replay:
    """Other images are shown.

    Args:
        replay: n images.
        during: The images that are replaced.
        posterior_poses: Posterior samples of the other images, by the number of the image that each replaces.
        unfamiliarity: Of the other images, (n,).
    """
    affected = np.isin(np.arange(len(replay.times_ns)), [*during])
    return replace(
        replay,
        posterior_poses=lambda image: (posterior_poses if image in during else replay.posterior_poses)(image),
        unfamiliarity=np.where(affected, unfamiliarity, replay.unfamiliarity),
    )


def standing_still(replay: Replay, during: range) -> Replay:
    """Odometry says that the camera does not move, with the covariance of a robot at rest."""
    return _reported(replay, during, lambda odometry: _at_rest(odometry.duration_s))


def tripled(replay: Replay, during: range) -> Replay:
    """Odometry says that the camera moves and turns three times as far, as slipping wheels do."""

    def three_times(odometry: Odometry) -> Odometry:
        return replace(odometry, previous_from_current=Poses.exp(3.0 * odometry.previous_from_current.log()))

    return _reported(replay, during, three_times)


def too_long(replay: Replay, during: range) -> Replay:
    """Odometry says that the camera moves a fifth further than it does."""

    def longer(odometry: Odometry) -> Odometry:
        motion = odometry.previous_from_current
        return replace(odometry, previous_from_current=Poses(motion.rotation, 1.2 * motion.translation))

    return _reported(replay, during, longer)


def set_back(replay: Replay, during: range) -> Replay:
    """The pose that odometry gives jumps to where it was at the first image, and continues from there."""
    before = [odometry.previous_from_current for odometry in replay.odometry[1 : during.start]]
    jump = reduce(Poses.__matmul__, before, Poses.identity()).inverse()

    def jumped(odometry: Odometry) -> Odometry:
        return replace(odometry, previous_from_current=jump @ odometry.previous_from_current)

    return _reported(replay, during[:1], jumped)


def late(replay: Replay, during: range) -> Replay:
    """The stamps of the odometry are 0.2 s behind those of the images: each image gets the motion of an earlier one."""
    behind = images_in(BEHIND_S, replay.times_ns)
    odometry = list(replay.odometry)
    for image in during:
        # For the first ones no earlier motion is known; the first image has none.
        odometry[image] = replay.odometry[max(image - behind, min(image, 1))]
    return replace(replay, odometry=tuple(odometry))


def ahead(replay: Replay, during: range) -> Replay:
    """The camera's clock jumps ahead by a second, and back at the end.

    Images get the motion of a second later. Those of the second after the end have stamps that occurred before: they
    are skipped, and the motion to the next one counts from the last stamp before them.
    """
    by = images_in(AHEAD_S, replay.times_ns)
    odometry = list(replay.odometry)
    odometry[during.start] = reduce(Odometry.then, replay.odometry[during.start : during.start + by + 1])
    odometry[during.start + 1 : during.stop] = replay.odometry[during.start + 1 + by : during.stop + by]
    odometry[during.stop : during.stop + by] = [Odometry(Poses.identity(), np.zeros((6, 6)), 0.0)] * by
    return _missing(replace(replay, odometry=tuple(odometry)), range(during.stop, during.stop + by))


def _reported(replay: Replay, during: range, change: Callable[[Odometry], Odometry]) -> Replay:
    """The same with the odometry changed, increment by increment."""
    odometry = [change(each) if image in during else each for image, each in enumerate(replay.odometry)]
    return replace(replay, odometry=tuple(odometry))


def _at_rest(duration_s: float) -> Odometry:
    """What the simulated odometry reports of a robot at rest."""
    times_ns = np.array([0, round(1e9 * STATED_OVER_S)], np.int64)
    _, twists = simulate_odometry(times_ns, Poses.identity(2), OdometryNoise(), rng=np.random.default_rng(0))
    return Odometry(Poses.identity(), twists[1] * STATED_OVER_S * duration_s, duration_s)
