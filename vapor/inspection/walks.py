"""Recordings as they are inspected: read once, image by image, of which a few numbers each are kept."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64

from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.datasets.frames import posed_frames
from sequences.datasets.listing import is_recording, list_images
from sequences.errors import SequenceError
from sequences.frame import Frame
from sequences.options import OdometryUse, SequenceOptions, TruePoseUse
from sequences.reader import SequenceReader
from sequences.reading.counts import ImageCounts
from vapor.inspection.looks import Look, Looks, look_at
from vapor.inspection.turns import outline, turn_between
from vapor.training_data.training_set import TrainingError, TrainingSet, name_entries

_GAP_STEPS, _GAP_S = 3.0, 0.25  # longer than so many usual steps, and than so long
_LEAST_RUN = 3  # images that are one and the same
_RIPE = 50  # images with odometry or poses, to say whether blur comes with turns


@dataclass(frozen=True)
class Walk:
    """One recording of n images, without its pixels.

    Attributes:
        name: Of its file or folder.
        times_ns: Stamps, (n,).
        sizes: Width and height of images, pixels, and how many have them.
        looks: How its images look.
        turns: How far the view turned since the image before, rotation vectors (see `turn_between`), (n, 3).
        posed: Which of them have a true pose, (n,).
        poses: These k poses, world_from_camera.
        odometry: Motion since the image before, n of them; None where it is not known.
        counts: What became of the images of the recording, those that were not asked for among the skipped ones; None
            of images on disk.
        skipped: What was left out in reading, by reason: images, and messages that are none.
        notices: What the reader says of odometry and true poses.
        assumed_hz: The rate that stamps were made up with; None where they were recorded.
        lacks: What was not found, "true poses" and "odometry", and why.
        recorded: Whether it is a recording, rather than images on disk.
    """

    name: str
    times_ns: Int64[np.ndarray, " n"]
    sizes: Mapping[tuple[int, int], int]
    looks: Looks
    turns: Float64[np.ndarray, "n 3"]
    posed: Bool[np.ndarray, " n"]
    poses: Poses
    odometry: tuple[Odometry | None, ...]
    counts: ImageCounts | None
    skipped: Mapping[str, int]
    notices: tuple[str, ...]
    assumed_hz: int | None
    lacks: Mapping[str, str]
    recorded: bool

    def __len__(self) -> int:
        return len(self.times_ns)

    @property
    def seconds(self) -> Float64[np.ndarray, " n"]:
        """Since the first image, (n,)."""
        return (self.times_ns - self.times_ns[0]) * 1e-9

    @property
    def gaps(self) -> list[tuple[float, float]]:
        """Where no image is for long: seconds since the first image, and how long, from the longest down."""
        if self.assumed_hz is not None or len(self) < 3:
            return []
        steps = np.diff(self.seconds)
        long = np.flatnonzero(steps > max(_GAP_STEPS * float(np.median(steps)), _GAP_S))
        found = [(float(self.seconds[i]), float(steps[i])) for i in long]
        return sorted(found, key=lambda gap: -gap[1])

    @property
    def frozen(self) -> list[tuple[int, int]]:
        """First and last of images in a row that are one and the same, three at least."""
        begins = np.flatnonzero(~self.looks.repeated)
        lengths = np.diff([*begins.tolist(), len(self)])
        return [
            (int(begin), int(begin + length - 1))
            for begin, length in zip(begins, lengths, strict=True)
            if length >= _LEAST_RUN
        ]

    @property
    def path_m(self) -> float | None:
        """How far the camera came, by true poses or else by odometry; None without either."""
        if len(self.poses):
            return float(np.linalg.norm(np.diff(self.poses.translation, axis=0), axis=1).sum())
        moved = [np.linalg.norm(step.previous_from_current.translation) for step in self.odometry if step is not None]
        return float(np.sum(moved)) if moved else None

    @property
    def blur_comes_with(self) -> str | None:
        """ "turns" or "speed", by which of the two is larger in blurred images; None where that cannot be said."""
        known = np.array([step is not None and step.duration_s > 0 for step in self.odometry])
        if known.sum() >= _RIPE:
            steps = [step for step, is_known in zip(self.odometry, known, strict=True) if step is not None and is_known]
            rates = np.stack([step.previous_from_current.log() / step.duration_s for step in steps])
            blurred = self.looks.blurred[known]
        elif len(self.poses) >= _RIPE and self.assumed_hz is None:
            at = np.flatnonzero(self.posed)
            seconds = np.maximum(np.diff(self.seconds[at]), 1e-9)
            rates = (self.poses[:-1].inverse() @ self.poses[1:]).log() / seconds[:, None]
            blurred = self.looks.blurred[at[1:]]
        else:
            return None
        if not blurred.any() or blurred.all():
            return None
        speed, turn = (np.linalg.norm(rates[:, part], axis=1) for part in (slice(0, 3), slice(3, 6)))
        grown = [float(np.median(rate[blurred]) / max(np.median(rate[~blurred]), 1e-9)) for rate in (speed, turn)]
        if max(grown) < 1.2:
            return None
        return "turns" if grown[1] >= grown[0] else "speed"

    def as_json(self) -> dict[str, Any]:
        """Figures for the report."""
        steps = np.diff(self.seconds)
        looks = self.looks
        return {
            "name": self.name,
            "images": len(self),
            "images_with_true_pose": int(self.posed.sum()),
            "images_with_odometry": sum(step is not None for step in self.odometry),
            "duration_s": float(self.seconds[-1]),
            "rate_hz": float(1.0 / np.median(steps)) if len(steps) and self.assumed_hz is None else None,
            "sizes": {f"{w} x {h}": count for (w, h), count in self.sizes.items()},
            "path_m": self.path_m,
            "sharpness": float(np.median(looks.sharpness)),
            "blurred": float(looks.blurred.mean()),
            "blur_comes_with": self.blur_comes_with,
            "dark": float(looks.dark.mean()),
            "blown_out": float(looks.blown.mean()),
            "brightness_jumps": np.flatnonzero(looks.jumps).tolist(),
            "frozen_images": [list(run) for run in self.frozen],
            "gaps": [{"at_s": at_s, "seconds": long_s} for at_s, long_s in self.gaps],
            "counts": None if self.counts is None else self.counts.as_json(),
            "skipped": dict(self.skipped),
            "notices": list(self.notices),
            "lacks": dict(self.lacks),
        }


Seen = Callable[[Frame], None]


def read_walks(
    data: Sequence[Path | str],
    reading: SequenceOptions | None = None,
    *,
    see: Seen = lambda frame: None,
    progress: Callable[[int], None] = lambda done: None,
) -> list[Walk]:
    """Read recordings once, one image at a time.

    Args:
        data: Each `PATH` or `PATH@START:STOP`, as `train` takes them; true poses may be missing.
        reading: What to read of recordings; None for all of it, as found.
        see: Called with every frame, in order.
        progress: Called with the number of images read so far.

    Raises:
        TrainingError: no data, a bad range, or a pose that is not finite.
        SequenceError: data that cannot be read.
    """
    if not data:
        raise TrainingError("no data, expected at least one file or folder")
    walks: list[Walk] = []
    done = 0
    for name, (path, which) in name_entries(data).items():
        source = _Source(path, which, reading)
        parts: dict[int, _Part] = {}
        for frame in source.frames():
            if frame.world_from_camera is not None and not frame.world_from_camera.is_finite():
                raise TrainingError(f"{name}: true pose at {frame.time_ns} ns is not finite")
            see(frame)
            parts.setdefault(frame.sequence, _Part()).take(frame)
            done += 1
            progress(done)
        for number, part in parts.items():
            walks.append(part.walk(name if len(parts) == 1 else f"{name}, sequence {number + 1}", source))
    return walks


class _Source:
    """Where the frames of one entry come from: a recording, whose true poses may be missing, or images on disk.

    Attributes:
        counts, skipped, notices, assumed_hz, lacks, recorded: As of `Walk`; complete after `frames`.
    """

    def __init__(self, path: Path, which: slice, reading: SequenceOptions | None) -> None:
        self.counts: ImageCounts | None = None
        self.skipped: Counter[str] = Counter()
        self.notices: list[str] = []
        self.assumed_hz: int | None = None
        self.lacks: dict[str, str] = {}
        self._path, self._which, self._reading = path, which, reading
        self.recorded = is_recording(path)

    def frames(self) -> Iterator[Frame]:
        """Frames of the entry, in order."""
        if not self.recorded:
            self.assumed_hz = list_images(self._path).assumed_hz
            self.lacks["odometry"] = "images on disk have none"
            posed = posed_frames(self._path, frames=self._which)
            yield from posed
            self.skipped, self.notices = posed.skipped, posed.notices
            return
        reader = SequenceReader(self._path, self._reading, odometry="optional")
        if reader.resolved["ground_truth_topic"] == "":
            self._ask("true poses", odometry="optional", true_poses="required")
        if reader.base_from_camera is None:
            self._ask("odometry", odometry="required")
        start, stop = self._which.start or 0, self._which.stop
        number = -1  # of images with a true pose, by which a range counts; of all images where none has one
        taken = 0
        frames = iter(reader)
        for frame in frames:
            number += "true poses" in self.lacks or frame.world_from_camera is not None
            if stop is not None and number >= stop:
                break
            if max(number, 0) >= start:
                yield replace(frame, odometry=frame.odometry if taken else None)
                taken += 1
        reader.stop()
        for _ in frames:  # none comes any more
            pass
        if not taken:
            raise SequenceError(f"{self._path}: no image in {start}:{stop}, expected at least one; it has {number + 1}")
        self.counts = reader.counts.taken(taken)
        few = [self.counts.warning] if self.counts.warning else []
        self.skipped = reader.skipped + (self.counts.skipped - reader.counts.skipped)
        self.notices = [*reader.notices, *few]

    def _ask(self, what: str, *, odometry: OdometryUse, true_poses: TruePoseUse = "optional") -> None:
        """Note why something is not found, where it is not."""
        try:
            SequenceReader(self._path, self._reading, odometry=odometry, true_poses=true_poses)
        except SequenceError as error:
            self.lacks[what] = str(error.args[0]).removeprefix(f"{self._path}: ")


@dataclass
class _Part:
    """Frames of one recording as they come, without their pixels but for the outline of the last."""

    times_ns: list[int] = field(default_factory=list)
    looks: list[Look] = field(default_factory=list)
    turns: list[np.ndarray] = field(default_factory=list)
    last: np.ndarray | None = None
    poses: list[Poses | None] = field(default_factory=list)
    odometry: list[Odometry | None] = field(default_factory=list)

    def take(self, frame: Frame) -> None:
        self.times_ns.append(frame.time_ns)
        self.looks.append(look_at(frame.image))
        seen = outline(frame.image)
        self.turns.append(turn_between(seen if self.last is None else self.last, seen))
        self.last = seen
        self.poses.append(frame.world_from_camera)
        self.odometry.append(frame.odometry)

    def walk(self, name: str, source: _Source) -> Walk:
        known = [pose for pose in self.poses if pose is not None]
        return Walk(
            name,
            np.array(self.times_ns, np.int64),
            Counter((look.width, look.height) for look in self.looks),
            Looks.of(self.looks),
            np.stack(self.turns),
            np.array([pose is not None for pose in self.poses]),
            Poses.stack(known) if known else Poses.identity(0),
            tuple(self.odometry),
            source.counts,
            source.skipped,
            tuple(source.notices),
            source.assumed_hz,
            source.lacks,
            source.recorded,
        )


def posed_images(walks: Sequence[Walk]) -> TrainingSet | None:
    """What `train` would have of recordings, but for the pixels; None where no image has a true pose."""
    walks = [walk for walk in walks if len(walk.poses)]
    if not walks:
        return None
    odometry = [
        step if before else None
        for walk in walks
        for step, before, is_posed in zip(
            walk.odometry, [False, *walk.posed[:-1].tolist()], walk.posed.tolist(), strict=True
        )
        if is_posed
    ]
    count = len(odometry)
    return TrainingSet(
        np.zeros((count, 1, 1, 3), np.uint8),
        np.arange(count),
        Poses.concatenate([walk.poses for walk in walks]),
        np.repeat(np.arange(len(walks)), [len(walk.poses) for walk in walks]),
        tuple(walk.name for walk in walks),
        (1, 1),
        np.concatenate([walk.times_ns[walk.posed] for walk in walks]),
        tuple(odometry),
    )
