"""Recordings read once for inspection; a few figures of each image are kept."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from filtering.motion import measured
from filtering.se3 import Poses
from sequences.datasets.frames import as_its_own, posed_frames
from sequences.datasets.listing import clipped, is_recording, list_images, none_among
from sequences.datasets.points import POINTS_OF_A_MODEL, SeenPoints
from sequences.errors import NoImageError, SequenceError
from sequences.frame import Frame
from sequences.inertial.sequence import InertialSequence
from sequences.inertial.topics import read_inertial
from sequences.options import OdometryUse, SequenceOptions, TruePoseUse
from sequences.reader import SequenceReader
from sequences.reading.counts import ImageCounts
from vapor.inspection.walk import Walk
from vapor.training_data.entries import name_entries, require_no_leakage
from vapor.training_data.training_set import TrainingError, TrainingSet


def read_walks(
    data: Sequence[Path | str],
    reading: SequenceOptions | None = None,
    *,
    see: Callable[[Frame], None] = lambda frame: None,
) -> list[Walk]:
    """Read recordings once, one image at a time.

    Data are `PATH` or `PATH@START:STOP`, as `train` takes them; true poses may be missing. `see` is called with every
    frame in order.

    Raises:
        TrainingError: no data, a bad range, two entries that share images, or a pose that is not finite.
        SequenceError: data that cannot be read.
    """
    if not data:
        raise TrainingError("no data, expected at least one file or folder")
    require_no_leakage(data)
    walks: list[Walk] = []
    for number, (name, (path, which)) in enumerate(name_entries(data).items()):
        source = Source(path, which, reading, first_point=number * POINTS_OF_A_MODEL)
        parts: dict[tuple[int, str], Walk] = {}
        for frame in source.frames():
            if frame.world_from_camera is not None and not frame.world_from_camera.is_finite():
                raise TrainingError(f"{name}: true pose at {frame.time_ns} ns is not finite")
            see(frame)
            part = frame.sequence, frame.camera_name
            if part not in parts:
                parts[part] = Walk(name, source)
            parts[part].take(frame, source.points_in(frame))
        several = len({number for number, _ in parts}) > 1
        for (number, camera), walk in parts.items():
            walk.name = name + (f", sequence {number + 1}" if several else "") + (f", {camera}" if camera else "")
            walks.append(walk)
    return walks


class Source:
    """The frames of one entry: a recording, whose true poses may be missing, or images on disk.

    Attributes are complete after `frames`.

    Attributes:
        recorded: Whether it is a recording.
        counts: None of images on disk.
        skipped: Images and unreadable messages that were left out, by reason.
        notices: Remarks on the data.
        assumed_hz: Rate assumed for want of stamps.
        lacks: Reasons why "true poses" or "odometry" are missing.
        unused_odometry: Topics of odometry that is recorded and cannot be used, with the number of their messages.
    """

    def __init__(self, path: Path, which: slice, reading: SequenceOptions | None, *, first_point: int = 0) -> None:
        self.counts: ImageCounts | None = None
        self.skipped: Counter[str] = Counter()
        self.notices: list[str] = []
        self.assumed_hz: int | None = None
        self.lacks: dict[str, str] = {}
        self.unused_odometry: dict[str, int] = {}
        self._path, self._which, self._reading = path, which, reading
        self._points: dict[int, SeenPoints] = {}
        self._first_point = first_point
        self.recorded = is_recording(path)

    def frames(self) -> Iterator[Frame]:
        """Frames of the entry, in order."""
        if not self.recorded:
            self.assumed_hz = list_images(self._path).assumed_hz
            self.lacks["odometry"] = "images on disk have none"
            posed = posed_frames(self._path, frames=self._which, options=self._reading)
            self._points = posed.seen_points()
            yield from posed
            self.skipped, self.notices = posed.skipped, posed.notices
            return
        reader = SequenceReader(self._path, self._reading, odometry="optional")
        if reader.resolved["ground_truth_topic"] == "":
            self._ask("true poses", odometry="optional", true_poses="required")
        if reader.base_from_camera is None:
            self._ask("odometry", odometry="required")
            self.unused_odometry = reader.unused_odometry
        self.counts = ImageCounts(0)
        if len(reader.camera_names) == 1:
            yield from self._of_camera(reader)
            return
        unusable: list[NoImageError] = []
        for name in reader.camera_names:
            alone = SequenceReader(self._path, self._reading, odometry="optional", only_camera=name)
            try:
                yield from map(as_its_own, self._of_camera(alone, f", {name}"))
            except NoImageError as error:
                unusable.append(error)
                self.notices.append(f"{name} is left out: {error}")
        if len(unusable) == len(reader.camera_names):
            raise unusable[0]

    def points_in(self, frame: Frame) -> SeenPoints | None:
        """Points of a reconstruction that a frame shows, which no other entry shows; None where there is none."""
        found = self._points.get(frame.time_ns) if frame.camera is not None else None
        return found and replace(found, point=found.point + self._first_point)

    def _of_camera(self, reader: SequenceReader, named: str = "") -> Iterator[Frame]:
        start, stop = self._which.start or 0, self._which.stop
        number = -1  # of images with a true pose, by which a range counts; of all images where none has one
        taken = 0
        samples, said = None, list[str]()
        if reader.camera_names[0] == reader.localized_camera:  # about whose axes an inertial unit is read
            localized = replace(self._reading or SequenceOptions(), image_topic=reader.localized_camera)
            samples, said = read_inertial(self._path, localized)
        inertial = InertialSequence(reader, samples, said)
        frames = iter(inertial)
        for frame in frames:
            number += "true poses" in self.lacks or frame.world_from_camera is not None
            if stop is not None and number >= stop:
                break
            if max(number, 0) >= start:
                motion = measured(frame.odometry) if taken else None
                yield replace(frame, odometry=motion, number=max(number, 0))
                taken += 1
        if (fewer := clipped(self._which, number + 1)) is not None:
            self.notices.append(f"{self._path}{named}: {fewer}")
        reader.stop()
        for _ in frames:  # none comes any more
            pass
        if not taken:
            posed = "true poses" not in self.lacks
            raise NoImageError(f"{self._path}: {none_among(self._which, number + 1, posed=posed)}")
        counts = reader.counts.taken(taken)
        assert self.counts is not None
        self.counts += counts
        few = [counts.warning] if counts.warning else []
        self.skipped += reader.skipped + (counts.skipped - reader.counts.skipped)
        self.notices += [notice for notice in [*inertial.notices, *few] if notice not in self.notices]

    def _ask(self, what: str, *, odometry: OdometryUse, true_poses: TruePoseUse = "optional") -> None:
        """Note why something is missing, if it is."""
        try:
            SequenceReader(self._path, self._reading, odometry=odometry, true_poses=true_poses)
        except SequenceError as error:
            self.lacks[what] = str(error.args[0]).removeprefix(f"{self._path}: ")


def posed_images(walks: Sequence[Walk]) -> TrainingSet | None:
    """The images of recordings as `train` has them, without pixels; None where none has a true pose."""
    walks = [walk for walk in walks if len(walk.poses)]
    if not walks:
        return None
    odometry = []
    for walk in walks:
        follows = np.concatenate([[False], walk.posed[:-1]])  # an image with a true pose
        odometry += [walk.odometry[i] if follows[i] else None for i in np.flatnonzero(walk.posed)]
    count = len(odometry)
    points = tuple(each for walk in walks for each in walk.seen_points)
    return TrainingSet(
        np.zeros((count, 1, 1, 3), np.uint8),
        np.arange(count),
        Poses.concatenate([walk.poses for walk in walks]),
        np.repeat(np.arange(len(walks)), [len(walk.poses) for walk in walks]),
        tuple(walk.name for walk in walks),
        (1, 1),
        np.concatenate([walk.times_ns[walk.posed] for walk in walks]),
        tuple(odometry),
        seen_points=points if any(points) else (),
        walks=tuple(_walk_numbers(walks)),
        numbers=np.concatenate([walk.numbers[walk.posed] for walk in walks]),
    )


def _walk_numbers(walks: Sequence[Walk]) -> Iterator[int]:
    """The number of the walk of each: the cameras of one recording are on one walk."""
    for number, walk in enumerate(walks):
        together = walk.source.recorded
        yield next(i for i, other in enumerate(walks) if i == number or (together and other.source is walk.source))
