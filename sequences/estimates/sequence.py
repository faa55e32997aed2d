"""Sequences without images: per frame the pose estimates of others, with odometry and true poses."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float64, Int64, Shaped

from filtering.errors import counted, quoted
from filtering.motion import MotionNoise, Odometry, WhiteNoise
from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.estimates.pose_files import Direction, FrameName, PoseFile, frames_by, natural_order, read_poses
from sequences.files import Rows
from sequences.frame import ASSUMED_HZ, BASE_FROM_CAMERA, Frame, Trajectory
from sequences.odometry import OdometryNoise, simulate_odometry
from sequences.reading.counts import NO_ESTIMATE, ImageCounts, uncovered
from sequences.trajectories.interpolation import MAX_ODOMETRY_GAP_S, MAX_TRUE_POSE_GAP_S, interpolate, odometry_between
from sequences.trajectories.pose_lines import require_columns

HYPOTHESIS = np.dtype([("file", np.int64), ("weight", np.float64), ("world_from_camera", np.float64, (4, 4))])
"""One hypothesis of a frame: number of the file from 0, weight above 0 in any unit, homogeneous matrix."""
_NO_ODOMETRY = "no odometry of its sequence"
_SAME_CLOCK_S = 0.05
_NO_IMAGE = np.zeros((0, 0, 3), np.uint8)
_MAX_OFFSET_S = 1e10  # between two clocks, one of which began in 1970


@dataclass(frozen=True)
class EstimateOptions:
    """How to read estimates."""

    direction: Direction | None = None
    """Which way the poses of named frames map, in all files. TUM trajectories are camera-to-world."""
    columns: str | None = None
    """Names of the columns of the files of estimates, as one word in quotation marks, such as "name qw qx qy qz tx ty
    tz _ _ weight": time in place of name for stamps in seconds, _ for ignored columns. With a weight, such as the
    number of inliers, a frame may have several lines, which are its hypotheses. Default: as above."""
    odometry_columns: str | None = None
    """Names of the columns of odometry, or of the true poses that it is simulated from, independent of --columns.
    Default: names, TUM text, or EuRoC's data.csv."""
    ground_truth_columns: str | None = None
    """Names of the columns of the true poses to compare with, likewise."""
    time_offset_s: float | Literal["auto"] = 0.0
    """Seconds to add to the stamps of estimates; auto finds them, file by file, by comparing their rotation with
    odometry's."""
    unit_m: float = 1.0
    """The unit of length of all files, in metres: 0.001 where they are in millimetres."""
    rate_hz: float = float(ASSUMED_HZ)
    """Named frames have no stamps: how many there are in a second."""
    noise: OdometryNoise = field(default_factory=OdometryNoise)
    """Of simulated odometry."""
    motion_noise: MotionNoise = field(default_factory=MotionNoise)
    """Of recorded odometry, whose text states none."""
    allow_few_images: bool = False
    """Localize also where odometry covers fewer than one in ten of the estimated frames."""

    def __post_init__(self) -> None:
        for name in ("columns", "odometry_columns", "ground_truth_columns"):
            require_columns(f"--{name.replace('_', '-')}", getattr(self, name))
        if self.time_offset_s != "auto" and not abs(self.time_offset_s) <= _MAX_OFFSET_S:
            raise SequenceError(f"time_offset_s is {self.time_offset_s}, expected at most {_MAX_OFFSET_S:g} or auto")
        if not 1e-3 <= self.rate_hz <= 1e6:
            raise SequenceError(f"rate_hz is {self.rate_hz}, expected between 0.001 and 1e6")
        if not 1e-6 <= self.unit_m <= 1e6:
            raise SequenceError(f"unit_m is {self.unit_m}, expected between 1e-6 and 1e6")


@dataclass(frozen=True)
class EstimatedFrame(Frame):
    """A frame with estimates instead of an image, which is empty.

    Attributes:
        estimates: Hypotheses of all files, file by file, of dtype `HYPOTHESIS`, (h,), h ≥ 1.
    """

    estimates: Shaped[np.ndarray, " h"] = field(kw_only=True)


@dataclass(frozen=True)
class OdometryTrack:
    """Odometry of the body in one sequence: stamps (k,), poses (k,), twist covariances (k, 6, 6), zero if unknown."""

    times_ns: Int64[np.ndarray, " k"]
    odom_from_base: Poses
    twist_covariances: Float64[np.ndarray, "k 6 6"]

    def covers(self, time_ns: int) -> bool:
        """Whether the body's pose is known."""
        asked = np.array([time_ns], np.int64)
        return bool(interpolate(self.times_ns, self.odom_from_base, asked, max_gap_s=MAX_ODOMETRY_GAP_S)[1][0])

    def between(self, start_ns: int, end_ns: int, motion_noise: WhiteNoise) -> Odometry:
        """Motion of the camera between two covered times; the noise is that of odometry without covariances."""
        return odometry_between(
            self.times_ns,
            self.odom_from_base,
            self.twist_covariances,
            start_ns,
            end_ns,
            base_from_camera=BASE_FROM_CAMERA,
            motion_noise=motion_noise,
        )


class EstimateSequence:
    """Frames that at least one file has an estimate of, in order of time.

    Frames whose names begin differently are of different sequences. These follow each other with a second between, and
    the first frame of each has no odometry. A frame without any estimate is left out; the odometry of the next one
    reaches across it.

    Args:
        estimates: Files of estimates, one for each method; one pose a frame, or several with weights.
        odometry: Poses of the camera in any frame: only their relative motion counts.
        simulate_odometry_from: True poses to simulate odometry from, where there is none.
        ground_truth: True poses; None for those that the odometry is simulated from.
        options: How to read the files.
        seed: Seed of simulated odometry.

    Raises:
        SequenceError: a file cannot be used, odometry is given twice or not at all, or no frame is left.
    """

    def __init__(
        self,
        estimates: Sequence[Path],
        *,
        odometry: Path | None = None,
        simulate_odometry_from: Path | None = None,
        ground_truth: Path | None = None,
        options: EstimateOptions | None = None,
        seed: int = 0,
    ) -> None:
        if not estimates:
            raise SequenceError("no file of estimates, expected at least one")
        if (odometry is None) == (simulate_odometry_from is None):
            raise SequenceError(
                "a filter needs odometry: expected either a file of it, or true poses to simulate it from"
            )
        self._options = options or EstimateOptions()
        if ground_truth is None and self._options.ground_truth_columns is not None:
            raise SequenceError("--ground-truth-columns without --ground-truth, expected a file that has them")
        source_path = simulate_odometry_from or odometry or Path()
        asked = [(path, self._options.columns) for path in estimates]
        asked.append((source_path, self._options.odometry_columns))
        if ground_truth is not None:
            asked.append((ground_truth, self._options.ground_truth_columns))
        self._has_names = _have_names(asked)
        self.notices: list[str] = []
        self.files = [self._read(path, self._options.columns) for path in estimates]
        source = self._read(source_path, self._options.odometry_columns)
        truth = source if simulate_odometry_from is not None else None
        if ground_truth is not None:
            truth = self._read(ground_truth, self._options.ground_truth_columns)
        self.path = self.files[0].path
        for file in [*self.files, *([] if truth is None else [truth])]:
            _require_common(file, source)
        self._set_clocks(source, truth)
        given = [*self.files, source, *([] if truth is None else [truth])]
        self.counts = ImageCounts(0)
        self._times_ns = _frame_stamps(given, self._options.rate_hz)
        self._frames = sorted({frame for file in self.files for frame in file.frames}, key=natural_order)
        self._hypotheses = _by_frame(self.files)
        self._truth = truth
        self._all = source if truth is None else truth  # the frames that there could be estimates of
        self._tracks = self._odometry(source, None if simulate_odometry_from is None else seed)
        self.odometry_description = f"recorded: {source.path.name}"
        if simulate_odometry_from is not None:
            settings = self._options.noise.settings
            self.odometry_description = f"simulated from {source.path.name}: {settings}, seed {seed}"
        self.num_images = len(self._frames)

    @property
    def skipped(self) -> Counter[str]:
        """How many frames of the latest iteration were left out, by reason."""
        return self.counts.skipped

    def __iter__(self) -> Iterator[EstimatedFrame]:
        unseen = 0 if self._all.timed else len(set(self._all.frames) - set(self._frames))
        self.counts = ImageCounts(self.num_images + unseen, self.num_images + unseen)
        self.counts.skipped += Counter({NO_ESTIMATE: unseen})
        true_poses, known = self._true_poses()
        previous: tuple[str, int] | None = None
        for i, frame in enumerate(self._frames):
            time_ns, track = self._times_ns[frame], self._tracks.get(frame.sequence)
            if track is None or not track.covers(time_ns):
                self.counts.skipped[_NO_ODOMETRY if track is None else uncovered(time_ns, track.times_ns)] += 1
                continue
            motion = None
            if previous is not None and previous[0] == frame.sequence:
                motion = track.between(previous[1], time_ns, self._options.motion_noise)
            previous = frame.sequence, time_ns
            self.counts.used += 1
            truth = true_poses[i] if true_poses is not None and known[i] else None
            yield EstimatedFrame(time_ns, _NO_IMAGE, motion, truth, estimates=self._hypotheses[frame])
        if previous is None:
            found = ", ".join(f"{count} × {reason}" for reason, count in self.skipped.items())
            raise SequenceError(f"{self.path}: no frame is left: {found}, expected odometry for some")

    @property
    def interval_s(self) -> float:
        """Median time between frames of a sequence, in seconds; infinite where no sequence has two."""
        times_ns = np.array([self._times_ns[frame] for frame in self._frames], np.int64)
        sequence = np.array([frame.sequence for frame in self._frames])
        steps = np.diff(times_ns)[sequence[1:] == sequence[:-1]]
        return float(np.median(steps)) * 1e-9 if len(steps) else np.inf

    @property
    def speed_m_per_s(self) -> float:
        """Median speed of the camera by odometry, m/s; 0 where no sequence has two poses."""
        speeds = [
            np.linalg.norm(np.diff(track.odom_from_base.translation, axis=0), axis=1) / (np.diff(track.times_ns) * 1e-9)
            for track in self._tracks.values()
            if len(track.times_ns) > 1
        ]
        return float(np.median(np.concatenate(speeds))) if speeds else 0.0

    def _read(self, path: Path, columns: str | None) -> PoseFile:
        # The direction is that of named frames: files of stamps are always camera-to-world.
        beside = self._has_names and frames_by(path, columns)[0] == "stamps"
        rows = Rows("poses")
        file = read_poses(path, None if beside else self._options.direction, columns, rows)
        self.notices += rows.notices
        return replace(file, poses=Poses(file.poses.rotation, file.poses.translation * self._options.unit_m))

    def _set_clocks(self, source: PoseFile, truth: PoseFile | None) -> None:
        """Add the time offset to the stamps of estimates; notice clocks that differ by the rotations."""
        asked = self._options.time_offset_s
        if not source.timed:
            if asked != 0.0:
                raise SequenceError(
                    f"{self.path}: frames by names, which have no clock, expected stamps with --time-offset-s"
                )
            return
        from sequences.trajectories.time_offset import offset_of_clocks  # loads SciPy's signals, which takes a while

        track, offsets_s = _best(source), []
        for i, file in enumerate(self.files):
            stamps = set(file.frames)
            others_s = [offsets_s[k] for k in range(i) if not stamps.isdisjoint(self.files[k].frames)]
            try:
                offset_s, notices = offset_of_clocks(asked, track, _best(file), str(file.path))
            except SequenceError:
                if not others_s:
                    raise
                offset_s, notices = others_s[0], []
            # Files that name the same frames by the same clock: each frame stays one.
            offsets_s.append(
                next((other_s for other_s in others_s if abs(other_s - offset_s) < _SAME_CLOCK_S), offset_s)
            )
            self.notices += notices
        for i, (file, offset_s) in enumerate(zip(self.files, offsets_s, strict=True)):
            shift_ns = round(offset_s * 1e9)
            frames = tuple(frame._replace(number=frame.number + shift_ns) for frame in file.frames)
            self.files[i] = replace(file, frames=frames)
        if truth is not None and truth is not source:
            self.notices += offset_of_clocks(0.0, track, _best(truth), str(truth.path))[1]

    def _odometry(self, source: PoseFile, seed: int | None) -> dict[str, OdometryTrack]:
        """One track for each sequence, of the body, in whose axes noise is stated; simulated with a seed."""
        rng = None if seed is None else np.random.default_rng(seed)
        tracks = {}
        for sequence in dict.fromkeys(frame.sequence for frame in source.frames):
            rows = [i for i, frame in enumerate(source.frames) if frame.sequence == sequence]
            times_ns = np.array([self._times_ns[source.frames[i]] for i in rows], np.int64)
            poses = source.poses[rows] @ BASE_FROM_CAMERA.inverse()
            covariances = np.zeros((len(rows), 6, 6))  # unknown: the motion noise counts
            if rng is not None:
                poses, covariances = simulate_odometry(times_ns, poses, self._options.noise, rng=rng)
            tracks[sequence] = OdometryTrack(times_ns, poses, covariances)
        return tracks

    def _true_poses(self) -> tuple[Poses | None, np.ndarray]:
        if self._truth is None:
            return None, np.zeros(len(self._frames), bool)
        known_ns = np.array([self._times_ns[frame] for frame in self._truth.frames], np.int64)
        times_ns = np.array([self._times_ns[frame] for frame in self._frames], np.int64)
        # Stamps of true poses may lie between those of frames; names are the same or they are not.
        max_gap_s = MAX_TRUE_POSE_GAP_S if self._truth.timed else 0.0
        return interpolate(known_ns, self._truth.poses, times_ns, max_gap_s=max_gap_s)


def _have_names(files: Sequence[tuple[Path, str | None]]) -> bool:
    """Whether frames of any file have names. Raises SequenceError where names are no stamps, but another has stamps."""
    by = [(path, *frames_by(path, columns)) for path, columns in files]
    named = next((each for each in by if each[1] == "names"), None)
    timed = next((each for each in by if each[1] != "names"), None)
    if named is not None and timed is not None:
        raise SequenceError(
            f"{named[0]}: frames by names, but those of {timed[0]} by stamps: {quoted(named[2])} is no stamp, so it"
            f" cannot be placed in time beside {quoted(timed[2])}, expected all alike, or names that are stamps such as"
            " 1403636579763555584.png or 1305031102.175304.png"
        )
    return any(each[1] != "stamps" for each in by)


def _best(file: PoseFile) -> Trajectory:
    """Of each stamp the pose of the largest weight."""
    weights = np.ones(len(file.frames)) if file.weights is None else file.weights
    times_ns = np.array([frame.number for frame in file.frames], np.int64)
    order = np.lexsort((-weights, times_ns))
    found, first = np.unique(times_ns[order], return_index=True)
    return Trajectory(found, file.poses[order[first]])


def _require_common(file: PoseFile, other: PoseFile) -> None:
    """Raise SequenceError where no name of a file begins as one of another does."""
    if file.timed or not {frame.sequence for frame in file.frames}.isdisjoint(frame.sequence for frame in other.frames):
        return
    one, two = (
        f"{counted(len(set(each.frames)), 'name')} such as"
        f" {quoted(each.frames[0].sequence + str(each.frames[0].number))}"
        for each in (file, other)
    )
    raise SequenceError(
        f"{file.path} has {one}, {other.path} has {two}: none match, expected names that begin alike up to their number"
    )


def _by_frame(files: Sequence[PoseFile]) -> dict[FrameName, Shaped[np.ndarray, " h"]]:
    found: dict[FrameName, list[tuple[int, float, np.ndarray]]] = {}
    for number, file in enumerate(files):
        weights = np.ones(len(file.frames)) if file.weights is None else file.weights
        for frame, weight, matrix in zip(file.frames, weights.tolist(), file.poses.as_matrix(), strict=True):
            found.setdefault(frame, []).append((number, weight, matrix))
    return {frame: np.array(hypotheses, HYPOTHESIS) for frame, hypotheses in found.items()}


def _frame_stamps(files: Sequence[PoseFile], rate_hz: float) -> dict[FrameName, int]:
    """Nanoseconds of every frame: its own stamp, or by its number, a second between sequences."""
    frames = sorted({frame for file in files for frame in file.frames}, key=natural_order)
    if files[0].timed:
        return {frame: frame.number for frame in frames}
    stamps: dict[FrameName, int] = {}
    begin_ns, first, last = 0, 0, None
    for frame in frames:
        if last is None or frame.sequence != last.sequence:
            begin_ns, first = 0 if last is None else stamps[last] + 1_000_000_000, frame.number
        stamps[frame] = begin_ns + round((frame.number - first) * 1_000_000_000 / rate_hz)
        last = frame
    return stamps
