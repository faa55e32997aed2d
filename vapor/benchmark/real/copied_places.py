"""Rows of ambiguity: a real place stands in the map several times, and one part of it once only.

No recording of storeys that look alike is in reach. So the images of a place are trained on two or three times, each
time at another height and in another light, with other noise and another crop; of one part only the copy that the
camera walks in is trained on. Images are real, copies are not.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, UInt8

from filtering.config import LocalizerConfig
from filtering.errors import VaporTrackError
from filtering.motion import Odometry
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from sequences.datasets.frames import posed_frames
from sequences.frame import BASE_FROM_CAMERA, Frame
from sequences.reader import SequenceReader
from sequences.visual_odometry.odometry import USUAL_DEPTH_M, VisualOdometry
from sequences.writer import SequenceWriter
from vapor.benchmark.real.row import Draw, Row, RowContext, simulated_motions
from vapor.benchmark.real.trained_network import record_posteriors, trained_model, training_code
from vapor.benchmark.recordings.storage import FileSettings, load_recording, seen_digest
from vapor.cache import digest
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.checkpoints.file_format import load_checkpoint
from vapor.tracking.follow import Segment
from vapor.training.config import TrainConfig
from vapor.training.presets import PRESETS
from vapor.training.train import train_on
from vapor.training_data.entries import parse_entry

_GAIN, _GAMMA, _NOISE, _WINDOW = (0.7, 1.1), (0.75, 1.35), 4.0, 0.95
_SHORTEST_S = 4.0  # before the part that is there once
_AFTER_S = 2.0  # in which it must be known where the camera is
_LEFT_S, _LONGEST_S = 1.0, 15.0  # in which a walk goes on after that, at least and at most


@dataclass(frozen=True)
class CopiedPlaces(Row):
    """A place of others' images that stands in the map several times; the camera walks in one of the copies.

    Attributes:
        training: Folders of the data, `PATH@START:STOP`.
        walk: Folder of the data whose images are walked through, forwards or backwards, from any of them.
        unique: Which of poses, as the data state them, belong to the part that is there once, (n,).
        offsets_m: Where each copy stands.
        own: The copy that the camera walks in.
        rate_hz: Images a second of the walk, whose data have no stamps to be trusted.
        config: How to train: as `train` does without options.
        visual_of: The row whose model and images it shares, but with odometry made from these; empty: it is simulated.
    """

    training: tuple[str, ...]
    walk: str
    unique: Callable[[Poses], Bool[np.ndarray, " n"]]
    offsets_m: tuple[tuple[float, float, float], ...]
    own: int
    rate_hz: float
    config: TrainConfig = PRESETS["auto"]
    visual_of: str = ""

    @property
    def group(self) -> str:
        """The row with simulated odometry."""
        return self.visual_of or self.name

    @property
    def needs(self) -> tuple[str, ...]:
        """Folders of the data that must be there."""
        return tuple(dict.fromkeys([*(entry.split("@")[0] for entry in self.training), self.walk]))

    def prepare(self, context: RowContext, seed: int) -> dict[str, Any]:
        """Copy, train, and record the posterior of every image, once for all draws."""
        checkpoint = load_checkpoint(self._trained(context))
        settings = self._recording(context, checkpoint)
        recorded = record_posteriors(context, settings, self._walked(context), checkpoint)
        return {**recorded, "seed": seed}

    def draw(self, context: RowContext, seed: int) -> Draw:
        """A walk that begins anywhere and goes on to the part that is there once, and beyond."""
        checkpoint = load_checkpoint(self._trained(context))
        recording = load_recording(self._recording(context, checkpoint), context.folder("recordings"))
        noise = checkpoint.calibration.errors
        truth = recording.path.world_from_camera
        rng = np.random.default_rng([seed, 2])
        images, first = self._walk(self._unique(truth, self.own), rng)
        times_ns = np.rint(np.arange(len(images)) * 1e9 / self.rate_hz).astype(np.int64)
        simulated = simulated_motions(times_ns, truth[images], rng=rng)
        since = times_ns - times_ns[first]
        after = since >= round(_AFTER_S * 1e9)

        def posterior(image: int) -> PosePosterior:
            return recording.observed(int(images[image])).posterior(checkpoint, noise)

        evaluated = {"before": since < 0, f"{_AFTER_S:g} s after": after & (np.cumsum(after) == 1), "after": after}

        def draw_of(motions: Sequence[Odometry | None], localizer: LocalizerConfig) -> Draw:
            segment = Segment(times_ns, (None, *motions[1:]), truth[images], posterior)
            return Draw(segment, noise, localizer, evaluated, in_sequences=False)

        localizer = context.config.localizer
        if not self.visual_of:
            return draw_of(simulated, localizer).with_model(checkpoint)
        motions = self._visual_motions(self._walked(context), images, times_ns, checkpoint)
        return draw_of(motions, replace(localizer, odometry_bias=VisualOdometry.bias))

    def _visual_motions(
        self, walked: Path, images: np.ndarray, times_ns: np.ndarray, checkpoint: Checkpoint
    ) -> list[Odometry | None]:
        """Motion since the previous image, by the images of a walk alone, as `run` makes it."""
        reader = SequenceReader(walked)
        seen, camera = list(reader), reader.camera
        assert camera is not None
        depth_m = USUAL_DEPTH_M if checkpoint.landmarks is None else checkpoint.landmarks.map.depth_m
        odometry = VisualOdometry(camera, usual_depth_m=depth_m)
        return [
            odometry.step(seen[image].image, time_ns, camera)
            for image, time_ns in zip(images.tolist(), times_ns.tolist(), strict=True)
        ]

    def _walk(self, unique: Bool[np.ndarray, " n"], rng: np.random.Generator) -> tuple[np.ndarray, int]:
        """The images of a walk, and which of them is the first of the part that is there once."""
        n = len(unique)
        seconds = np.array([_SHORTEST_S, _AFTER_S + _LEFT_S, _AFTER_S + _LONGEST_S])
        before, least, most = np.rint(seconds * self.rate_hz).astype(int).tolist()
        walks = []
        for order in (np.arange(n), np.arange(n)[::-1]):
            for start in range(n):
                rest = order[start:]
                ahead = np.flatnonzero(unique[rest])
                if len(ahead) and ahead[0] >= before and len(rest) >= ahead[0] + least:
                    walks.append((rest[: ahead[0] + most], int(ahead[0])))
        if not walks:
            raise VaporTrackError(
                f"{self.walk}: no walk of {n} images, expected {_SHORTEST_S:g} s before the part that is there once,"
                f" and {_AFTER_S + _LEFT_S:g} s from its first image on, at {self.rate_hz:g} images a second"
            )
        return walks[rng.integers(len(walks))]

    def _unique(self, truth: Poses, copy: int) -> Bool[np.ndarray, " n"]:
        return self.unique(Poses(truth.rotation, truth.translation - np.array(self.offsets_m[copy])))

    def _copies(self, data: Path) -> dict[str, list[Frame]]:
        """The training images of each copy, by names for them."""
        copies: dict[str, list[Frame]] = {}
        for entry in self.training:
            path, frames = parse_entry(data / entry)
            read = list(posed_frames(path, frames=frames))
            for copy in range(len(self.offsets_m)):
                copies[f"{entry}, copy {copy}"] = list(self._copied(read, copy, only_common=copy != self.own))
        return {name: frames for name, frames in copies.items() if frames}

    def _copied(self, frames: list[Frame], copy: int, *, only_common: bool) -> Iterator[Frame]:
        look = np.random.default_rng([copy, 3])
        gain, gamma = look.uniform(*_GAIN), look.uniform(*_GAMMA)
        left, top = look.uniform(size=2)
        noise = np.random.default_rng([copy, 4])
        offset = np.array(self.offsets_m[min(copy, len(self.offsets_m) - 1)])
        for frame in frames:
            pose = frame.world_from_camera
            if pose is None or (only_common and self.unique(Poses.stack([pose]))[0]):
                continue
            height, width = frame.image.shape[:2]
            size = round(_WINDOW * width), round(_WINDOW * height)
            at = round(left * (width - size[0])), round(top * (height - size[1]))
            image = frame.image[at[1] : at[1] + size[1], at[0] : at[0] + size[0]]
            yield replace(
                frame,
                image=_in_other_light(image, gain, gamma, noise),
                camera=None if frame.camera is None else frame.camera.cropped(*at, *size),
                world_from_camera=Poses(pose.rotation, pose.translation + offset),
            )

    @cached_property
    def _settings(self) -> dict[str, Any]:
        content = {
            "training": self.training,
            "walk": self.walk,
            "offsets_m": self.offsets_m,
            "own": self.own,
            "look": [_GAIN, _GAMMA, _NOISE, _WINDOW],
            "config": self.config.settings(),
            "code": training_code(type(self).__module__, "vapor.benchmark.real.rows"),
        }
        return json.loads(json.dumps(content))

    def _trained(self, context: RowContext) -> Path:
        return trained_model(
            context,
            self.group,
            self._settings,
            lambda file: train_on(self._copies(context.data), file, self.config),
        )

    def _walked(self, context: RowContext) -> Path:
        """The images of the walk as the copy gives them that the camera walks in, at another time than in training."""
        file = context.folder("sequences") / f"{self.group}-{digest(self._settings)}.mcap"
        if not file.is_file():
            read = list(posed_frames(context.data / self.walk))
            seen = list(self._copied(read, len(self.offsets_m), only_common=False))
            offset = np.array(self.offsets_m[self.own]) - np.array(self.offsets_m[-1])
            base_from_camera, known = BASE_FROM_CAMERA, np.eye(6) * 1e-6
            camera = seen[0].camera
            assert camera is not None
            with SequenceWriter(file, camera=camera, base_from_camera=base_from_camera) as writer:
                for number, frame in enumerate(seen):
                    pose = frame.world_from_camera
                    assert pose is not None
                    pose = Poses(pose.rotation, pose.translation + offset)
                    time_ns = round(number * 1e9 / self.rate_hz)
                    writer.write_odometry(time_ns, pose @ base_from_camera.inverse(), known)
                    writer.write_true_pose(time_ns, pose)
                    writer.write_image(time_ns, frame.image)
        return file

    def _recording(self, context: RowContext, checkpoint: Checkpoint) -> FileSettings:
        seen, c = seen_digest(checkpoint), context.config
        return FileSettings(self.group, digest(self._settings), seen, 0, c.num_samples, precision=c.precision)


def _in_other_light(
    image: UInt8[np.ndarray, "h w 3"], gain: float, gamma: float, rng: np.random.Generator
) -> UInt8[np.ndarray, "h w 3"]:
    table = 255.0 * gain * (np.arange(256) / 255.0) ** gamma
    lit = cv2.LUT(np.ascontiguousarray(image), table.astype(np.float32))
    return np.clip(lit + _NOISE * rng.standard_normal(image.shape, np.float32), 0.0, 255.0).astype(np.uint8)
