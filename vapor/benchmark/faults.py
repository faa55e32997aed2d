"""What a fault of camera or odometry does to a filter that knows where it is: the same walks without and with it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float64, Int64

from filtering.estimate import Status
from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.odometry import STATED_OVER_S, OdometryNoise, simulate_odometry
from vapor.benchmark.trials import Replay
from vapor.evaluation.trajectory import convergence_s, is_right
from vapor.tracking.belief import Belief

CONVERGED_S = 5.0
"""The filter has been converged for so long when a fault begins."""

FAULT_S = 5.0
"""How long a fault lasts."""

SETTLED_S = 5.0
"""So long after its end all should be as if it had not been."""

REMAINING_S = 10.0
"""At least so much of the walk is left after its end."""

NOTICED_S = 3.0
"""So long after its beginning a fault that can be noticed should be."""

LONG_S = 1.0
"""To be sure of a wrong place for longer than this is a failure."""

NONE = "none"
"""The name of the run without a fault."""

_AHEAD_S, _BEHIND_S = 1.0, 0.2  # that a clock jumps, and that one is late

Film = Literal["black", "noise", "upside-down", "elsewhere", "three-times"]
"""Images that are shown instead of those of the walk, as the network sees them; the last: all of them, and two more
after each."""


# What a fault changes. Each takes a replay of n images, and the images during which the fault lasts, one at least.


def no_images(replay: Replay, during: range) -> Replay:
    """The camera gives nothing, odometry goes on: an image that says nothing moves the belief as `predict` does."""
    return _missing(replay, during)


def a_third(replay: Replay, during: range) -> Replay:
    """The camera gives a third of the images; odometry goes on."""
    return _missing(replay, [image for image in during if (image - during.start) % 3])


def _missing(replay: Replay, images: Collection[int]) -> Replay:
    return shown(replay, images, lambda image: Poses.identity(0), np.zeros(len(replay.times_ns)))


def frozen(replay: Replay, during: range) -> Replay:
    """The image before is repeated, pixel by pixel: it says nothing, but is as unlike the training images as it was."""
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
        during: Of which images others are shown.
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
    """Odometry says that the camera does not move, with the covariance of a robot that stands."""
    return _reported(replay, during, lambda odometry: _at_rest(odometry.duration_s))


def tripled(replay: Replay, during: range) -> Replay:
    """Odometry says that the camera moves and turns three times as far, as wheels do that slip."""

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
    """The pose that odometry gives jumps to where it was at the first image, and goes on from there."""
    before = [odometry.previous_from_current for odometry in replay.odometry[1 : during.start]]
    jump = reduce(Poses.__matmul__, before, Poses.identity()).inverse()

    def jumped(odometry: Odometry) -> Odometry:
        return replace(odometry, previous_from_current=jump @ odometry.previous_from_current)

    return _reported(replay, during[:1], jumped)


def late(replay: Replay, during: range) -> Replay:
    """The stamps of the odometry are 0.2 s behind those of the images: each image gets the motion of one before."""
    behind = images_in(_BEHIND_S, replay.times_ns)
    odometry = list(replay.odometry)
    for image in during:
        # Of the first ones no earlier motion is known; that of the first image is none.
        odometry[image] = replay.odometry[max(image - behind, min(image, 1))]
    return replace(replay, odometry=tuple(odometry))


def ahead(replay: Replay, during: range) -> Replay:
    """The camera's clock jumps ahead by a second, and back at the end.

    Images get the motion of a second later. Those of the second after the end have stamps that were there already: they
    are skipped, and the motion to the next one is counted from the last stamp before.
    """
    by = images_in(_AHEAD_S, replay.times_ns)
    odometry = list(replay.odometry)
    odometry[during.start] = reduce(Odometry.then, replay.odometry[during.start : during.start + by + 1])
    odometry[during.start + 1 : during.stop] = replay.odometry[during.start + 1 + by : during.stop + by]
    odometry[during.stop : during.stop + by] = [Odometry(Poses.identity(), np.zeros((6, 6)), 0.0)] * by
    return _missing(replace(replay, odometry=tuple(odometry)), range(during.stop, during.stop + by))


def _reported(replay: Replay, during: range, change: Callable[[Odometry], Odometry]) -> Replay:
    """The same with odometry that is changed, increment by increment."""
    odometry = [change(each) if image in during else each for image, each in enumerate(replay.odometry)]
    return replace(replay, odometry=tuple(odometry))


def _at_rest(duration_s: float) -> Odometry:
    """What the simulated odometry reports of a robot that stands."""
    times_ns = np.array([0, round(1e9 * STATED_OVER_S)], np.int64)
    _, twists = simulate_odometry(times_ns, Poses.identity(2), OdometryNoise(), rng=np.random.default_rng(0))
    return Odometry(Poses.identity(), twists[1] * STATED_OVER_S * duration_s, duration_s)


@dataclass(frozen=True)
class Fault:
    """Something that breaks.

    Attributes:
        meaning: What, as the tables say it.
        cause: What it changes in a replay, or what the camera shows instead.
        lasts: For `FAULT_S`, to the end of the walk, or from its first image on.
    """

    meaning: str
    cause: Callable[[Replay, range], Replay] | Film
    lasts: Literal["a while", "to the end", "throughout"] = "a while"

    def during(self, begin: int, times_ns: Int64[np.ndarray, " n"]) -> range:
        """The images of a walk that are affected, where the fault begins at one of them."""
        if self.lasts == "a while":
            return range(begin, image_after(FAULT_S, begin, times_ns))
        return range(0 if self.lasts == "throughout" else begin, len(times_ns))


# To add one: a name, what the tables say, and a function of the replay or the name of a film.
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


def find_moment(status: Sequence[Status], times_ns: Int64[np.ndarray, " n"]) -> int | None:
    """The first image before which the filter was converged for `CONVERGED_S`, with time for a fault and after it.

    Args:
        status: Of the filter without a fault, (n,).
        times_ns: Stamps (n,), more or less evenly spaced.

    Returns:
        Its number, or None.
    """
    sure = np.array([each == "converged" for each in status])
    if len(sure) < 2:
        return None
    step_ns = float(np.median(np.diff(times_ns)))
    for image in range(image_after(CONVERGED_S, 0, times_ns), len(sure)):
        since = image_after(-CONVERGED_S, image, times_ns)
        left_ns = times_ns[-1] - times_ns[image] + step_ns
        if left_ns >= (FAULT_S + REMAINING_S) * 1e9 - step_ns / 2 and sure[since:image].all():
            return image
    return None


def judge(belief: Belief, times_ns: Int64[np.ndarray, " n"], truth: Poses, begin: int, during: range) -> dict[str, Any]:
    """What a method was worth with a fault.

    Args:
        belief: After each of n images.
        times_ns: Stamps (n,), more or less evenly spaced.
        truth: True poses, batch (n,).
        begin: Image at which the fault begins.
        during: Images that are affected.

    Returns:
        Shares of the images from `begin` on: `right`, `converged`, `lost`, `sure_and_wrong` ("converged" and not
        right). Shares of others: `right_after`, of those from `SETTLED_S` after a fault of `FAULT_S` on; `noticed`,
        "lost" from `NOTICED_S` after the beginning to the end of the fault, None where there is none; `lost_ever`, of
        all of the walk. Also `success`, as of a trial, and of all of the walk `longest_s`, the longest stretch of
        sure and wrong, and `longest_at_s`, when it began (None: never).
    """
    right = is_right(belief.best, truth)
    said = {name: np.array([status == name for status in belief.status]) for name in ("converged", "lost")}
    wrong = said["converged"] & ~right
    settled = image_after(FAULT_S + SETTLED_S, begin, times_ns)
    noticed = said["lost"][image_after(NOTICED_S, max(begin, during.start), times_ns) : during.stop]
    first, longest = longest_stretch(wrong)
    elapsed_s = (times_ns - times_ns[0]) / 1e9
    return {
        "success": convergence_s(times_ns, right) is not None,
        "right": float(right[begin:].mean()),
        "right_after": float(right[settled:].mean()),
        "converged": float(said["converged"][begin:].mean()),
        "lost": float(said["lost"][begin:].mean()),
        "noticed": float(noticed.mean()) if len(noticed) else None,
        "lost_ever": float(said["lost"].mean()),
        "sure_and_wrong": float(wrong[begin:].mean()),
        "longest_s": longest * float(np.median(np.diff(elapsed_s))),
        "longest_at_s": float(elapsed_s[first]) if longest else None,
    }


def longest_stretch(said: Bool[np.ndarray, " n"]) -> tuple[int, int]:
    """First image and length of the longest run of true ones, the first of several; length 0 where there is none."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], said, [False]]).astype(int)))
    first, length = edges[::2], edges[1::2] - edges[::2]
    if not len(first):
        return 0, 0
    longest = int(np.argmax(length))
    return int(first[longest]), int(length[longest])


def images_in(duration_s: float, times_ns: Int64[np.ndarray, " n"]) -> int:
    """How many images there are in so many seconds of more or less evenly spaced stamps (n,), n ≥ 2."""
    return round(duration_s * 1e9 / float(np.median(np.diff(times_ns))))


def image_after(duration_s: float, image: int, times_ns: Int64[np.ndarray, " n"]) -> int:
    """The first of n ≥ 2 images so many seconds after one of them or later, by stamps that may jitter; n for none."""
    jitter_ns = float(np.median(np.diff(times_ns))) / 2.0
    return int(np.searchsorted(times_ns, times_ns[image] + duration_s * 1e9 - jitter_ns))


def impossible(times_ns: Int64[np.ndarray, " n"]) -> list[str]:
    """Faults that would be none at the rate of these stamps: a delay of less than one image."""
    return [] if len(times_ns) > 1 and images_in(_BEHIND_S, times_ns) else ["late"]


def summarise_faults(results: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """What all walks add up to, by scene and fault, the run without a fault first.

    Returns:
        Of each `walks`, their number, and for each of `methods`: `successes`; the shares of `judge`, averaged over the
        walks; `longest_s`, of any walk; `unsuccessful`, names of walks; and `sure_and_wrong_walks`, the names of those
        that were so for longer than `LONG_S`, with from when on and how long, seconds.
    """
    groups: dict[str, dict[str, list[Mapping[str, Any]]]] = {}
    order = (NONE, *FAULTS)
    for result in sorted(results, key=lambda each: (each["scene"], order.index(each["fault"]), each["name"])):
        groups.setdefault(result["scene"], {}).setdefault(result["fault"], []).append(result)
    return {
        scene: {
            fault: {
                "walks": len(group),
                "methods": {name: _aggregate(group, name) for name in group[0]["methods"]},
            }
            for fault, group in faults.items()
        }
        for scene, faults in groups.items()
    }


def _aggregate(results: Sequence[Mapping[str, Any]], method: str) -> dict[str, Any]:
    parts = [(result["name"], result["methods"][method]) for result in results]
    shares = ("right", "right_after", "converged", "lost", "noticed", "lost_ever", "sure_and_wrong")
    known = {name: [part[name] for _, part in parts if part[name] is not None] for name in shares}
    return {
        "successes": sum(part["success"] for _, part in parts),
        **{name: float(np.mean(values)) if values else None for name, values in known.items()},
        "longest_s": max(part["longest_s"] for _, part in parts),
        "unsuccessful": [name for name, part in parts if not part["success"]],
        "sure_and_wrong_walks": {
            name: [part["longest_at_s"], part["longest_s"]] for name, part in parts if part["longest_s"] > LONG_S
        },
    }
