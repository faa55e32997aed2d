"""Recordings as they are made: a sequence is rendered or read, and the network is asked about every image, once."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool

from filtering.errors import VaporTrackError
from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.atomic import workspace
from sequences.frame import Camera, Frame
from sequences.options import SequenceOptions
from sequences.paths import Stand
from sequences.reader import SequenceReader
from sequences.rendering.render import sees_cue
from sequences.scenes import find_scene
from sequences.synthesize import SyntheticSequence, synthesize, write_synthetic
from vapor.benchmark.ood_images import OUT_OF_DISTRIBUTION
from vapor.benchmark.recordings.storage import (
    PATH,
    SAMPLES,
    SETTINGS,
    CameraPath,
    FileSettings,
    RecordingSettings,
    Settings,
    to_rows,
    verified_arrays,
)
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.engines.engine import EngineName
from vapor.observation import VaporObservationModel
from vapor.threads import limited_threads

_NO_MOTION = Odometry(Poses.identity(), np.zeros((6, 6)), 0.0)


def make_recording(
    settings: RecordingSettings, checkpoint: Checkpoint, directory: Path, engine: EngineName = "auto"
) -> None:
    """Render a sequence to a file, read it as a user's would be, ask the network, and store the answers; once.

    The folder appears in `directory` when it is complete. The engine runs the network.

    Raises:
        VaporTrackError: there is no such sequence, or the directory cannot be written to.
    """
    _store(settings, directory, lambda folder: record_synthetic(settings, checkpoint, folder, engine))


def record_file(
    settings: FileSettings,
    file: Path,
    checkpoint: Checkpoint,
    directory: Path,
    reading: SequenceOptions | None = None,
    engine: EngineName = "auto",
) -> None:
    """Read a sequence in which every image has a true pose and odometry, and continue as `make_recording` does.

    Images before the first one with a true pose, and after the last one, are left out.

    Raises:
        VaporTrackError: the file cannot be read or lacks some of it, or the directory cannot be written to.
    """
    _store(settings, directory, lambda folder: _observe(file, settings, checkpoint, folder, engine, reading=reading))


def record_synthetic(
    settings: RecordingSettings, checkpoint: Checkpoint, folder: Path, engine: EngineName = "auto"
) -> None:
    """Render a sequence to a file in a folder, and record that; the file is removed."""
    sequence = _sequence(settings)
    file = folder / "sequence.mcap"
    write_synthetic(sequence, file)
    _observe(file, settings, checkpoint, folder, engine, seen=_path(sequence).sees_cue)
    file.unlink()


def camera_path(settings: RecordingSettings) -> CameraPath:
    """Where the camera of a recording goes. Raises VaporTrackError where there is no such sequence."""
    return _path(_sequence(settings))


def _path(sequence: SyntheticSequence) -> CameraPath:
    seen = sees_cue(sequence.scene, sequence.camera, sequence.world_from_camera)
    return CameraPath(sequence.world_from_camera, seen)


def _sequence(settings: RecordingSettings) -> SyntheticSequence:
    sequence = synthesize(
        settings.scene,
        seed=settings.seed,
        num_frames=settings.frames,
        cues=settings.cues,
        width=settings.width,
        height=settings.height,
        noise=replace(find_scene(settings.scene).noise, fixed_scale=settings.odometry_scale),
        rate_hz=settings.rate_hz,
        stand=None if settings.stand is None else Stand(*settings.stand),
    )
    if settings.camera is not None:
        sequence = replace(sequence, camera=Camera(*settings.camera))
    if settings.part is None:
        return sequence
    first, count = settings.part
    part = slice(first, first + count)
    return replace(
        sequence,
        image_times_ns=sequence.image_times_ns[part],
        world_from_camera=sequence.world_from_camera[part],
    )


def _store(settings: Settings, directory: Path, record: Callable[[Path], object]) -> None:
    """Let a recording be made in a hidden folder, then give that folder its name; nothing to do if it exists."""
    folder = directory / settings.name
    if folder.is_dir():
        return
    directory.mkdir(parents=True, exist_ok=True)
    with workspace(directory, settings.name) as work:
        partial = work / settings.name
        partial.mkdir()
        with limited_threads(1):
            record(partial)
        (partial / SETTINGS).write_text(json.dumps(settings.stored, indent=2) + "\n", encoding="utf-8")
        if not folder.is_dir():  # another process may have been faster
            partial.rename(folder)


def _observe(
    file: Path,
    settings: RecordingSettings | FileSettings,
    checkpoint: Checkpoint,
    folder: Path,
    engine: EngineName,
    *,
    seen: Bool[np.ndarray, " n"] | None = None,
    reading: SequenceOptions | None = None,
) -> None:
    """Write the posteriors of a file's images with true poses and odometry."""
    most = settings.images if isinstance(settings, FileSettings) else None
    rng = np.random.default_rng([settings.seed, settings.num_samples])
    noise = np.random.default_rng([settings.seed, settings.num_samples, 1])
    reader = SequenceReader(file, reading, true_poses="required")
    if len(reader.camera_names) > 1:
        reader = SequenceReader(file, reading, true_poses="required", only_camera=reader.localized_camera)
    model = VaporObservationModel(
        checkpoint,
        num_samples=settings.num_samples,
        device="cpu",
        camera=reader.camera,
        engine=engine,
        precision=settings.precision,
    )
    times_ns, odometry, covariance, truth, ood_score, verified = [], [], [], [], [], []
    ended: Frame | None = None
    with (folder / SAMPLES).open("wb") as samples:
        for frame in reader:
            if frame.world_from_camera is None:
                ended = ended or (frame if truth else None)
                continue
            if ended is not None or (truth and frame.odometry is None):
                lacking, what = (ended, "true pose") if ended is not None else (frame, "odometry")
                raise VaporTrackError(
                    f"{file}: the image at {lacking.time_ns} ns has no {what}, expected one of every image between the"
                    " first and the last that have a true pose"
                )
            image = frame.image
            if settings.change is not None:
                image = np.ascontiguousarray(OUT_OF_DISTRIBUTION[settings.change](image, noise))
            posterior = model.observe(image, rng=rng)
            samples.write(to_rows(posterior.samples).astype(np.float32).tobytes())
            motion = frame.odometry if truth and frame.odometry is not None else _NO_MOTION
            times_ns.append(frame.time_ns)
            truth.append(frame.world_from_camera)
            odometry.append(motion.previous_from_current)
            covariance.append(motion.covariance)
            ood_score.append(posterior.ood_score)
            verified.append(() if model.verifier is None else tuple(model.verifier.latest))
            if len(truth) == most:
                break
        if not truth:
            raise VaporTrackError(f"{file}: no image has a true pose, expected all to have one")
    of_landmarks: dict[str, Any] = verified_arrays(verified)
    np.savez(
        folder / PATH,
        times_ns=np.array(times_ns, np.int64),
        truth=to_rows(Poses.stack(truth)),
        sees_cue=np.zeros(len(truth), bool) if seen is None else seen,
        odometry=to_rows(Poses.stack(odometry)),
        odometry_covariance=np.stack(covariance),
        ood_score=np.array(ood_score),
        **of_landmarks,
    )
