"""What a fault of camera or odometry does to a filter that knows where it is: the same walks without and with it."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, reduce
from itertools import islice
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float64, Int64

from filtering.errors import VaporTrackError, require_within
from filtering.estimate import Status
from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.odometry import STATED_OVER_S, OdometryNoise, simulate_odometry
from vapor.benchmark import RecordingsConfig, make_recordings, make_setups, paths
from vapor.evaluate import convergence_s, is_right
from vapor.methods import kept
from vapor.parallel import in_parallel
from vapor.recordings import RecordingSettings, load_recording
from vapor.trials import Replay, Setup, follow_trial, load_replay, trial_settings
from vapor.verdicts import Belief
from vapor.windows import Trial, trials_by_seed

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

_AHEAD_S = 1.0  # that a clock jumps
_MORE_IMAGES = 3  # for every one
_NOISE_IMAGES = 50  # that differ; walks share them
_BARREN = 20  # walks in a row without a moment for a fault, after which there is none to be hoped for

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
    behind = images_in(0.2, replay.times_ns)
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
            return range(begin, begin + images_in(FAULT_S, times_ns))
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


@dataclass(frozen=True)
class FaultsConfig(RecordingsConfig):
    """Settings of a benchmark of faults."""

    walks: int = 10
    """Walks of each scene, each without a fault and with every one."""
    faults: tuple[str, ...] = tuple(FAULTS)
    """Of camera, for five seconds: black, frozen, upside-down, no-images; of odometry: standing-still, tripled, reset,
    scale, and all the walk scale-throughout; of clocks: all the walk late, for five seconds ahead; of rates, all the
    walk: a-third, three-times; images of no place in the map, to the end: elsewhere, noise, turned-over."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_within(self, walks=(1, 10**6))
        least = round(10 * (CONVERGED_S + FAULT_S + REMAINING_S))
        if self.frames < least:
            raise VaporTrackError(
                f"frames is {self.frames}, expected at least {least}: {CONVERGED_S:g} s before a fault, {FAULT_S:g} s"
                f" with it, and {REMAINING_S:g} s after it"
            )
        for fault in self.faults:
            if fault not in FAULTS:
                raise VaporTrackError(f"unknown fault {fault!r}, expected one of {', '.join(FAULTS)}")
        if not self.faults or len(set(self.faults)) < len(self.faults):
            raise VaporTrackError(f"faults are {', '.join(self.faults) or 'none'}, expected each at most once, and one")


@dataclass(frozen=True)
class Walk:
    """A walk that faults may befall.

    Attributes:
        trial: Which.
        begin: The image at which faults begin.
        without: The result of the run without any, see `run_fault`.
    """

    trial: Trial
    begin: int
    without: Mapping[str, Any]

    @property
    def seed(self) -> int:
        """Of its recording."""
        return self.trial.pieces[0].seed


class FaultBenchmark:
    """The walks of a benchmark of faults, and where their results lie.

    Args:
        scenes: Names of scenes, each with the model to localize by: a file, or the name of one that ships.
        directory: For recordings and results; one that is interrupted goes on where it was.
        config: Settings.
        errors: What replaces numbers of the models' own error models, by name.

    Raises:
        VaporTrackError: a model or an error model that cannot be used.
    """

    def __init__(
        self, scenes: Mapping[str, str], directory: Path, config: FaultsConfig, errors: Mapping[str, Any]
    ) -> None:
        self.directory = directory
        self.config = config
        self._setups = make_setups(scenes, config, errors)

    def choose(self, progress: Callable[[int, int], None]) -> tuple[list[Walk], list[str]]:
        """The first walks, each of a seed of its own, that have a moment for a fault.

        Returns:
            The walks; and scene and seed of those that have none, though their "cue" trials are tried one by one.

        Raises:
            VaporTrackError: seed after seed has no such walk.
        """
        walks: list[Walk] = []
        unused: list[str] = []
        for scene, setup in self._setups.items():
            path = paths(setup, scene, "cue", self.directory / "recordings")
            c = self.config
            seeds = trials_by_seed(scene, "cue", first_seed=c.first_seed, frames=c.frames, path=path)
            found, refused = [], []
            while len(found) < c.walks:
                batch = {trials[0].pieces[0].seed: trials for trials in islice(seeds, c.walks - len(found))}
                wanted = {setup.recording(scene, "cue", trials[0].pieces[0]): setup for trials in batch.values()}
                for _ in make_recordings(wanted, self.directory / "recordings", c.workers):
                    pass
                jobs = [(trials, setup, self.directory) for trials in batch.values()]
                usable = [walk for walk in in_parallel(find_walk, jobs, c.workers) if walk is not None]
                found += sorted(usable, key=lambda walk: walk.seed)
                refused += sorted(batch.keys() - {walk.seed for walk in usable})
                progress(len(walks) + len(found), c.walks * len(self._setups))
                if not batch or len(refused) > _BARREN + len(found):
                    raise VaporTrackError(
                        f"{scene}: {len(found)} of {len(found) + len(refused)} walks from seed {c.first_seed} on are"
                        f" converged for {CONVERGED_S:g} s with {FAULT_S + REMAINING_S:g} s to go, expected {c.walks}"
                    )
            walks += found
            unused += [f"{scene} {seed}" for seed in refused]
        return walks, unused

    def record(self, walks: Sequence[Walk]) -> Iterator[tuple[int, int]]:
        """Show the networks the images of the faults; yields the number done and the number of all after each."""
        wanted = {
            settings: self._setups[walk.trial.scene]
            for walk in walks
            for fault in self.config.faults
            if (settings := self._film(walk, fault)) is not None
        }
        yield from make_recordings(wanted, self.directory / "recordings", self.config.workers)

    def localize(self, walks: Sequence[Walk]) -> Iterator[dict[str, Any]]:
        """The result of every walk with every fault, in no order; those that are there are not computed again."""
        jobs = [
            (walk.trial, walk.begin, fault, self._setups[walk.trial.scene], self._film(walk, fault), self.directory)
            for walk in walks
            for fault in self.config.faults
        ]
        yield from in_parallel(run_fault, jobs, self.config.workers)

    def _film(self, walk: Walk, fault: str) -> RecordingSettings | None:
        """The recording of what the camera shows during a fault; None where that is nothing or the walk itself."""
        cause, (piece,), scene = FAULTS[fault].cause, walk.trial.pieces, walk.trial.scene
        own = self._setups[scene].recording(scene, "cue", piece)
        shared = replace(own, seed=self.config.first_seed)
        if cause == "upside-down":
            return replace(own, part=(piece.start, piece.length), change="upside down")
        if cause == "three-times":
            part = (_MORE_IMAGES * piece.start, _MORE_IMAGES * (piece.length - 1) + 1)
            return replace(own, frames=_MORE_IMAGES * own.frames, rate_hz=_MORE_IMAGES * own.rate_hz, part=part)
        if cause == "black":
            return replace(shared, frames=1, change="black")
        if cause == "noise":
            return replace(shared, frames=_NOISE_IMAGES, change="uniform noise")
        if cause == "elsewhere":
            return replace(shared, scene="ceiling" if scene != "ceiling" else "staircase", frames=piece.length)
        return None


def find_walk(trials: Sequence[Trial], setup: Setup, directory: Path) -> Walk | None:
    """The first of the trials in which a fault may begin: see `find_moment`."""
    for trial in trials:
        without = run_without(trial, setup, directory)
        if without["begin"] is not None:
            return Walk(trial, without["begin"], without)
    return None


def run_without(trial: Trial, setup: Setup, directory: Path) -> dict[str, Any]:
    """Run a walk without a fault: as `run_fault`, with `begin` and `methods` None where no fault may begin."""

    def compute() -> dict[str, Any]:
        replay = load_replay(trial, setup, directory)
        beliefs = follow_trial(trial, setup, replay).beliefs
        begin = find_moment(beliefs["filter"].status, replay.times_ns)
        whole = range(len(replay.times_ns))
        return _result(trial, NONE, begin, None if begin is None else _judge_all(beliefs, replay, begin, whole))

    return _kept(trial, NONE, setup, directory, compute)


def run_fault(
    trial: Trial, begin: int, fault: str, setup: Setup, film: RecordingSettings | None, directory: Path
) -> dict[str, Any]:
    """Run a walk with a fault, or take the result that a run with the same settings and the same code left.

    Args:
        trial: The walk.
        begin: Image at which the fault begins.
        fault: Its name.
        setup: With which model and filter.
        film: The recording of what the camera shows during the fault; None where that is nothing or the walk itself.
        directory: With `recordings`; results are kept in `faults`.

    Returns:
        JSON: `name`, `scene`, `fault`, `begin`, and `methods`: see `judge`.

    Raises:
        VaporTrackError: a recording is missing or was made with other settings.
    """

    def compute() -> dict[str, Any]:
        replay = load_replay(trial, setup, directory)
        cause, during = FAULTS[fault].cause, FAULTS[fault].during(begin, replay.times_ns)
        faulty = cause(replay, during) if callable(cause) else _filmed(replay, during, cause, film, directory)
        # It may have more images; the fault begins at the same time.
        first = int(np.searchsorted(faulty.times_ns, replay.times_ns[begin]))
        during = FAULTS[fault].during(first, faulty.times_ns)
        judged = _judge_all(follow_trial(trial, setup, faulty).beliefs, faulty, first, during)
        return _result(trial, fault, begin, judged)

    more = {"begin": begin, "film": None if film is None else film.name}
    return _kept(trial, fault, setup, directory, compute, more)


def find_moment(status: Sequence[Status], times_ns: Int64[np.ndarray, " n"]) -> int | None:
    """The first image before which the filter was converged for `CONVERGED_S`, with time for a fault and after it.

    Args:
        status: Of the filter without a fault, (n,).
        times_ns: Stamps (n,), evenly spaced.

    Returns:
        Its number, or None.
    """
    before, later = images_in(CONVERGED_S, times_ns), images_in(FAULT_S + REMAINING_S, times_ns)
    for image in range(before, len(status) - later + 1):
        if all(each == "converged" for each in status[image - before : image]):
            return image
    return None


def judge(belief: Belief, times_ns: Int64[np.ndarray, " n"], truth: Poses, begin: int, during: range) -> dict[str, Any]:
    """What a method was worth with a fault.

    Args:
        belief: After each of n images.
        times_ns: Stamps (n,), evenly spaced.
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
    settled = begin + images_in(FAULT_S + SETTLED_S, times_ns)
    noticed = said["lost"][max(begin, during.start) + images_in(NOTICED_S, times_ns) : during.stop]
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
        "longest_s": longest * float(elapsed_s[1]),
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
    """How many images there are in so many seconds of evenly spaced stamps (n,), n ≥ 2."""
    return round(duration_s * 1e9 / int(times_ns[1] - times_ns[0]))


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


def _judge_all(beliefs: Mapping[str, Belief], replay: Replay, begin: int, during: range) -> dict[str, Any]:
    return {name: judge(belief, replay.times_ns, replay.truth, begin, during) for name, belief in beliefs.items()}


def _result(trial: Trial, fault: str, begin: int | None, methods: Mapping[str, Any] | None) -> dict[str, Any]:
    return {"name": trial.name, "scene": trial.scene, "fault": fault, "begin": begin, "methods": methods}


def _kept(
    trial: Trial,
    fault: str,
    setup: Setup,
    directory: Path,
    compute: Callable[[], dict[str, Any]],
    more: Mapping[str, Any] = MappingProxyType({}),
) -> dict[str, Any]:
    settings = trial_settings(trial, setup) | {"fault": fault, "faults_code": _code(), **more}
    return kept(directory / "faults" / f"{trial.name}-{fault}", settings, compute)


def _filmed(replay: Replay, during: range, cause: Film, film: RecordingSettings | None, directory: Path) -> Replay:
    """The replay with a film shown; a short one begins again, and one of the walk itself takes its place."""
    assert film is not None
    recording = load_recording(film, directory / "recordings")
    count = len(recording.times_ns)
    if cause == "three-times":
        odometry, truth = tuple(map(recording.motion, range(count))), recording.path.world_from_camera
        posterior_poses, unfamiliarity = recording.posterior_poses, recording.unfamiliarity
        return Replay(recording.times_ns, odometry, truth, posterior_poses, unfamiliarity, replay.cue_images)
    numbers = np.arange(len(replay.times_ns)) % count
    return shown(
        replay, during, lambda image: recording.posterior_poses(image % count), recording.unfamiliarity[numbers]
    )


@cache
def _code() -> str:
    """Digest of this file: faults that were changed are run again."""
    return hashlib.sha256(Path(__file__).read_bytes()).hexdigest()[:16]
