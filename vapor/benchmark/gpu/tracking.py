"""A walk localized with the network on a device: the same statuses and poses as on a processor, and times of steps."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from filtering.estimate import Status
from filtering.measurement_noise import MeasurementNoise
from filtering.se3 import Poses
from sequences.frame import Frame
from sequences.options import SequenceOptions
from vapor.benchmark.gpu.setting import MODEL, Setting
from vapor.benchmark.gpu.stages import Deadline, Finding
from vapor.benchmark.step_times import time_step
from vapor.engines.engine import Device, Precision
from vapor.landmarks.build import build, gather
from vapor.landmarks.landmark_map import LandmarkMap, ViewCamera
from vapor.landmarks.verify import Landmarks, LandmarkVerifier, grey_view
from vapor.observation import VaporObservationModel
from vapor.pipeline.config import RunConfig
from vapor.pipeline.run import run
from vapor.reporting.record import RunRecord
from vapor.training_data.ground import near_scale_m
from vapor.training_data.load import shrunk

MOST_MM, MOST_DEG = 20.0, 0.2
"""Greatest deviations of a run's poses that pass: convolutions with factors of ten bits, simulated on a processor,
moved them by 1.8 mm and 0.02°."""
_WARM_UP_S = 0.3  # of the walk
_VERIFIED = 0.1  # error of a verified place, in those of a network's
_PARTS, _FEWEST = 10, 3  # of a step that are timed, about, in steps; and repetitions
_HYPOTHESES = 50


def compare_runs(setting: Setting, deadline: Deadline) -> Iterator[Finding]:
    """The walk by `vapor-track run` on the processor and on the device: statuses, poses and durations."""
    walk = setting.walk(deadline)
    _run(walk, setting, "cpu", "float32", deadline, duration_s=_WARM_UP_S)  # which imports what writes the results
    expected, seconds = _run(walk, setting, "cpu", "float32", deadline)
    yield Finding(
        "cpu, float32: whole run", seconds, "s", note=f"{len(expected.status)} images, {_counted(expected.status)}"
    )
    for precision in ("float32", "bfloat16") if setting.device == "cuda" else ("float32",):
        found, seconds = _run(walk, setting, setting.device, precision, deadline)
        where, asked = f"{setting.device}, {precision}", precision == "float32"
        yield Finding(f"{where}: whole run", seconds, "s", note=_counted(found.status))
        differing = sum(a != b for a, b in zip(found.status, expected.status, strict=True))
        yield Finding(f"{where}: other statuses", float(differing), "images", most=0.0 if asked else None)
        # Between places that are as probable the last bits decide; smoothed, the walk is at one of them.
        converged = [set(both) == {"converged"} for both in zip(found.status, expected.status, strict=True)]
        for method, compared in (("filter", np.array(converged)), ("smoothed", np.ones(len(converged), bool))):
            if not compared.any():
                continue
            metres, radians = found.methods[method].poses.distance(expected.methods[method].poses)
            for part, values, unit, most in (
                ("positions", 1e3 * metres[compared], "mm", MOST_MM),
                ("rotations", np.degrees(radians[compared]), "°", MOST_DEG),
            ):
                note = f"greatest of {len(values)} images; median {np.median(values):.3g} {unit}"
                what = f"{where}: {method}, {part}"
                yield Finding(what, float(values.max()), unit, most=most if asked else None, note=note)


def _run(
    walk: Path,
    setting: Setting,
    device: Device,
    precision: Precision,
    deadline: Deadline,
    duration_s: float | None = None,
) -> tuple[RunRecord, float]:
    """The record of a run over so much of the walk, and how long it took with everything written, seconds."""
    config = RunConfig(
        engine="torch",
        precision=precision,
        device=device,
        num_samples=setting.sizes.samples,
        threads=setting.threads,
        recording=False,
    )
    begin = time.perf_counter()
    output, reading = setting.directory / f"run-{device}-{precision}", SequenceOptions(duration_s=duration_s)
    result = run(walk, MODEL, output, config, reading=reading, progress=deadline.check)
    return result.record, time.perf_counter() - begin


def _counted(statuses: Sequence[Status]) -> str:
    return ", ".join(f"{statuses.count(status)} {status}" for status in dict.fromkeys(statuses))


def time_steps(setting: Setting, deadline: Deadline) -> Iterator[Finding]:
    """Times of whole steps on the walk, from an image's bytes to the estimate, with landmarks of the walk itself."""
    frames = setting.frames(deadline)
    ways: list[tuple[Device, Precision]] = [
        ("cpu", "float32"),
        (setting.device, "float32"),
        (setting.device, "bfloat16"),
    ]
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


def _model(setting: Setting, device: Device, precision: Precision, frames: Sequence[Frame]) -> VaporObservationModel:
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
