"""A walk localized with the network on a device: the same statuses and poses as on a processor, and times of steps."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from filtering.measurement_noise import MeasurementNoise
from filtering.se3 import Poses
from sequences.frame import Frame
from vapor.benchmark.gpu.setting import MODEL, Setting
from vapor.benchmark.gpu.stages import Deadline, Finding
from vapor.benchmark.step_times import time_step
from vapor.engines.engine import Precision
from vapor.landmarks.build import build, gather
from vapor.landmarks.landmark_map import LandmarkMap, ViewCamera
from vapor.landmarks.verify import Landmarks, LandmarkVerifier, grey_view
from vapor.observation import VaporObservationModel
from vapor.training_data.ground import near_scale_m
from vapor.training_data.load import shrunk

MOST_MM, MOST_DEG = 50.0, 1.0
"""Greatest deviations of a run's poses that pass: the filter's own error is some times as large."""
_VERIFIED = 0.1  # error of a verified place, in those of a network's
_PARTS, _FEWEST = 10, 3  # of a step that are timed, about, in steps; and repetitions
_HYPOTHESES = 50


def compare_runs(setting: Setting, deadline: Deadline) -> Iterator[Finding]:
    """The walk by `vapor-track run` on the processor and on the device: statuses, poses and durations."""
    walk = setting.walk(deadline)
    expected, seconds = _run(walk, setting, "cpu", "float32", deadline)
    yield Finding("cpu, float32: whole run", seconds, "s", note=f"{len(expected.status)} images, {_counted(expected)}")
    for precision in ("float32", "bfloat16") if setting.device == "cuda" else ("float32",):
        found, seconds = _run(walk, setting, setting.device, precision, deadline)
        where, asked = f"{setting.device}, {precision}", precision == "float32"
        yield Finding(f"{where}: whole run", seconds, "s", note=_counted(found))
        differing = sum(a != b for a, b in zip(found.status, expected.status, strict=True))
        yield Finding(f"{where}: other statuses", float(differing), "images", most=0.0 if asked else None)
        for method in ("filter", "smoothed"):
            metres, radians = found.methods[method].poses.distance(expected.methods[method].poses)
            for part, values, unit, most in (
                ("positions", 1e3 * metres, "mm", MOST_MM),
                ("rotations", np.degrees(radians), "°", MOST_DEG),
            ):
                note = f"greatest; median {np.median(values):.3g} {unit}"
                what = f"{where}: {method}, {part}"
                yield Finding(what, float(values.max()), unit, most=most if asked else None, note=note)


def _run(walk: Path, setting: Setting, device, precision: Precision, deadline: Deadline):
    """The record of a run, and its duration with everything written, seconds."""
    from vapor.pipeline.config import RunConfig
    from vapor.pipeline.run import run

    config = RunConfig(
        engine="torch",
        precision=precision,
        device=device,
        num_samples=setting.sizes.samples,
        threads=setting.threads,
        recording=False,
    )
    begin = time.perf_counter()
    result = run(walk, MODEL, setting.directory / f"{device}-{precision}", config, progress=deadline.check)
    return result.record, time.perf_counter() - begin


def _counted(record) -> str:
    statuses = list(record.status)
    return ", ".join(f"{statuses.count(status)} {status}" for status in dict.fromkeys(statuses))


def time_steps(setting: Setting, deadline: Deadline) -> Iterator[Finding]:
    """Times of whole steps on the walk, from an image's bytes to the estimate, with landmarks of the walk itself."""
    frames = setting.frames(deadline)
    ways: list[tuple[str, Precision]] = [("cpu", "float32"), (setting.device, "float32"), (setting.device, "bfloat16")]
    ways = ways if setting.device == "cuda" else ways[:1]
    models = {f"{precision} on {device}": _model(setting, device, precision, frames) for device, precision in ways}
    landmarks = landmarks_of(frames, deadline)
    if landmarks is not None:
        yield Finding("landmarks: points of the map", float(len(landmarks.points)), "points")
        for model in models.values():
            noise = MeasurementNoise().scaled(_VERIFIED)
            model.verifier = LandmarkVerifier(Landmarks(landmarks), noise)
    begin, rng = time.perf_counter(), np.random.default_rng(0)
    for model in models.values():
        model.observe(frames[0].image, rng=rng)
    each_s = (time.perf_counter() - begin) * _PARTS
    repetitions = max(_FEWEST, min(setting.sizes.repetitions, int(deadline.left_s / max(each_s, 1e-3))))
    for timing in time_step(models, repetitions=repetitions, hypotheses=(_HYPOTHESES,), frames=frames):
        yield Finding(timing.part, timing.median_ms, "ms", p95=timing.p95_ms, note=f"{repetitions} times")


def _model(setting: Setting, device, precision: Precision, frames: Sequence[Frame]) -> VaporObservationModel:
    return VaporObservationModel(
        setting.trained,
        num_samples=setting.sizes.samples,
        device=device,
        camera=frames[0].camera,
        engine="torch",
        precision=precision,
        threads=setting.threads,
    )


def landmarks_of(frames: Sequence[Frame], deadline: Deadline) -> LandmarkMap | None:
    """A map of landmarks of frames with true poses and a camera; None where they show hardly any point twice."""
    if len(frames) < 2 or frames[0].camera is None:
        return None
    camera = shrunk(frames[0].camera)
    views = [grey_view(frame.image, camera) for frame in frames]
    poses = Poses.stack([frame.world_from_camera for frame in frames if frame.world_from_camera is not None])
    material = gather(lambda image: views[image], poses, camera, scale_m=near_scale_m(poses), advance=deadline.check)
    built = None if material is None else build(material, ViewCamera(camera))
    return None if built is None else built.landmarks
