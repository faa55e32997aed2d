"""The faults of the benchmark: when they begin, how long they last, and the effect of each on images or odometry."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from types import MappingProxyType
from typing import Literal

import numpy as np
from jaxtyping import Int64

from filtering.estimate import Status
from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.odometry import STATED_OVER_S, OdometryNoise, simulate_odometry
from vapor.benchmark.recordings.storage import Observed
from vapor.benchmark.trials.replay import Replay

CONVERGED_S = 5.0
"""The filter has been converged for this long when a fault begins."""

FAULT_S = 5.0
"""How long a fault lasts."""

SETTLED_S = 5.0
"""This long after its end all should be as if it had not been."""

REMAINING_S = 10.0
"""At least this much of the walk is left after its end."""

NOTICED_S = 3.0
"""A fault that can be noticed should be noticed this long after its beginning."""

LONG_S = 1.0
"""To be confident of a wrong place for longer than this is a failure."""

BEHIND_S = 0.2
"""How late the stamps of late odometry are."""

AHEAD_S = 1.0
"""How far a clock jumps."""


def find_moment(status: Sequence[Status], times_ns: Int64[np.ndarray, " n"]) -> int | None:
    """The first image before which the filter was converged for `CONVERGED_S`, with time left for a fault and beyond.

    Args:
        status: Of the filter without a fault, (n,).
        times_ns: Stamps (n,), more or less evenly spaced.

    Returns:
        Its number, or None.
    """
    converged = np.array([each == "converged" for each in status])
    if len(converged) < 2:
        return None
    step_ns = float(np.median(np.diff(times_ns)))
    for image in range(image_after(CONVERGED_S, 0, times_ns), len(converged)):
        since = image_after(-CONVERGED_S, image, times_ns)
        left_ns = times_ns[-1] - times_ns[image] + step_ns
        if left_ns >= (FAULT_S + REMAINING_S) * 1e9 - step_ns / 2 and converged[since:image].all():
            return image
    return None


def images_in(duration_s: float, times_ns: Int64[np.ndarray, " n"]) -> int:
    """How many images there are in so many seconds of more or less evenly spaced stamps (n,), n ≥ 2."""
    return round(duration_s * 1e9 / float(np.median(np.diff(times_ns))))


def image_after(duration_s: float, image: int, times_ns: Int64[np.ndarray, " n"]) -> int:
    """The first of n ≥ 2 images at least so many seconds after one of them, by stamps that may jitter; n if none is."""
    jitter_ns = float(np.median(np.diff(times_ns))) / 2.0
    return int(np.searchsorted(times_ns, times_ns[image] + duration_s * 1e9 - jitter_ns))


def no_images(replay: Replay, during: range) -> Replay:
    """The camera gives no images, odometry continues: an uninformative image moves the belief as `predict` does."""
    return _missing(replay, during)


def a_third(replay: Replay, during: range) -> Replay:
    """The camera gives a third of the images; odometry continues."""
    return _missing(replay, [image for image in during if (image - during.start) % 3])


def _missing(replay: Replay, images: Collection[int]) -> Replay:
    return shown(replay, images, lambda image: Observed(Poses.identity(0), 0.0))


def frozen(replay: Replay, during: range) -> Replay:
    """The last image is repeated, pixel by pixel. It is uninformative, and its score stays."""
    last = replay.observed(max(during.start - 1, 0))
    return shown(replay, during, lambda image: Observed(Poses.identity(0), last.ood_score))


def shown(replay: Replay, during: Collection[int], observed: Callable[[int], Observed]) -> Replay:
    """Other images are shown: their answers by the number of the image that each replaces."""
    return replace(replay, observed=lambda image: (observed if image in during else replay.observed)(image))


def standing_still(replay: Replay, during: range) -> Replay:
    """Odometry reports that the camera does not move, with the covariance of a robot at rest."""
    return _reported(replay, during, lambda odometry: _at_rest(odometry.duration_s))


def tripled(replay: Replay, during: range) -> Replay:
    """Odometry reports that the camera moves and turns three times as far, as slipping wheels do."""

    def three_times(odometry: Odometry) -> Odometry:
        return replace(odometry, previous_from_current=Poses.exp(3.0 * odometry.previous_from_current.log()))

    return _reported(replay, during, three_times)


def too_long(replay: Replay, during: range) -> Replay:
    """Odometry reports that the camera moves a fifth further than it does."""

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
    """The simulated odometry of a robot at rest."""
    times_ns = np.array([0, round(1e9 * STATED_OVER_S)], np.int64)
    _, twists = simulate_odometry(times_ns, Poses.identity(2), OdometryNoise(), rng=np.random.default_rng(0))
    return Odometry(Poses.identity(), twists[1] * STATED_OVER_S * duration_s, duration_s)


NONE = "none"
"""The name of the run without a fault."""

Film = Literal["black", "noise", "upside-down", "elsewhere", "three-times"]
"""Images that the network sees instead of those of the walk; the last: all of them, and two more after each."""


@dataclass(frozen=True)
class Fault:
    """Something that breaks.

    Attributes:
        meaning: What, as the tables call it.
        cause: Its change of a replay, or the film that the camera shows instead.
        lasts: For `FAULT_S`, to the end of the walk, or throughout the walk.
    """

    meaning: str
    cause: Callable[[Replay, range], Replay] | Film
    lasts: Literal["a while", "to the end", "throughout"] = "a while"

    def during(self, begin: int, times_ns: Int64[np.ndarray, " n"]) -> range:
        """The images of a walk that are affected, where the fault begins at one of them."""
        if self.lasts == "a while":
            return range(begin, image_after(FAULT_S, begin, times_ns))
        return range(0 if self.lasts == "throughout" else begin, len(times_ns))


# To add a fault: a name, its label in tables, and a function above or the name of a film.
FAULTS: Mapping[str, Fault] = MappingProxyType(
    {
        "black": Fault("black images", "black"),
        "frozen": Fault("a frozen image", frozen),
        "upside-down": Fault("images upside down", "upside-down"),
        "no-images": Fault("no images", no_images),
        "standing-still": Fault("odometry stands still", standing_still),
        "tripled": Fault("odometry tripled", tripled),
        "reset": Fault("odometry back at its origin", set_back),
        "scale": Fault("odometry 20 % long", too_long),
        "scale-throughout": Fault("odometry 20 % long, always", too_long, "throughout"),
        "late": Fault("odometry 0.2 s late, always", late, "throughout"),
        "ahead": Fault("camera's clock 1 s ahead", ahead),
        "a-third": Fault("a third of images, always", a_third, "throughout"),
        "three-times": Fault("3 times the images, always", "three-times", "throughout"),
        "elsewhere": Fault("another scene, to the end", "elsewhere", "to the end"),
        "noise": Fault("noise, to the end", "noise", "to the end"),
        "turned-over": Fault("upside down, to the end", "upside-down", "to the end"),
    }
)
"""Faults by name."""
