"""Scene + path + camera sensor + odometry -> a sequence whose true poses are known."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64, UInt8

from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.frame import Camera
from sequences.inertial.simulation import InertialNoise, simulate_inertial
from sequences.odometry import OdometryNoise, simulate_odometry
from sequences.paths import (
    EPOCH_NS,
    EXPOSURE_S,
    IMAGE_PERIOD_NS,
    IMAGE_RATE_HZ,
    ODOMETRY_PERIOD_NS,
    TAIL_S,
    Cues,
    Stand,
    choose_path,
    halted,
    image_stamps,
    odometry_stamps,
    poses_at,
)
from sequences.rendering.render import LitScene, render, sees_cue
from sequences.scenes import find_scene
from sequences.scenes.scene import SPLITS
from sequences.writer import MountedCamera, SequenceWriter


def metered_exposure(radiance: np.ndarray) -> float:
    """log2 of the gain that brings the geometric mean of the light to middle grey."""
    luminance = radiance[::4, ::4].mean(axis=-1)
    return float(np.clip(np.log2(0.42) - np.log2(luminance + 1e-3).mean(), -5.0, 4.5))


def develop(
    radiance: Float32[np.ndarray, "height width 3"], camera: Camera, exposure: float, *, rng: np.random.Generator
) -> UInt8[np.ndarray, "height width 3"]:
    """The image that a small camera makes of light: vignetting, shot and read noise, tone curve, eight bits.

    Args:
        radiance: Linear light.
        camera: Its intrinsics, for the fall-off towards the corners (cos⁴ of the angle).
        exposure: log2 of the gain.
        rng: Source of the noise.
    """
    x = (np.arange(camera.width, dtype=np.float32) - np.float32(camera.cx)) / np.float32(camera.fx)
    y = (np.arange(camera.height, dtype=np.float32) - np.float32(camera.cy)) / np.float32(camera.fy)
    falloff = (1 + 0.6 * (x[None] ** 2 + y[:, None] ** 2)) ** -2
    light = radiance * (np.float32(2.0**exposure) * falloff)[..., None]
    light += rng.standard_normal(light.shape, np.float32) * np.sqrt(0.0004 * light + 0.000012)
    light = np.clip(light, 0, None)
    tone = light * (1 + light / 9) / (1 + light)  # white at three times full scale, rolled off softly
    return np.clip(255 * tone ** np.float32(1 / 2.2) + 0.5, 0, 255).astype(np.uint8)


_STILL_M = 1e-9  # a camera that moves less than this, and turns less than as many radians, stands
_SAMPLES = 4  # per pixel and exposure


@dataclass(frozen=True)
class SyntheticSequence:
    """A rendered sequence of n images, which are made when they are asked for.

    Attributes:
        scene: The scene that the camera moves through.
        camera: Intrinsics.
        base_from_camera: One pose, the extrinsics.
        image_times_ns: Stamps of the images, the middle of each exposure.
        world_from_camera: True poses at the images, batch (n,).
        odometry_times_ns: Stamps of the odometry, 50 Hz, from before the first image to after the last.
        odom_from_base: Odometry, batch (k,), with scale error and drift.
        twist_covariances: As `simulate_odometry` states them.
        world_from_base: True poses of the body at the odometry, batch (k,).
        seed: Names the sequence's sensor noise.
        rate_hz: Images a second.
        others: base_from_camera of more cameras of the same make, by name; they take images at the same times.
    """

    scene: LitScene
    camera: Camera
    base_from_camera: Poses
    image_times_ns: Int64[np.ndarray, " n"]
    world_from_camera: Poses
    odometry_times_ns: Int64[np.ndarray, " k"]
    odom_from_base: Poses
    twist_covariances: Float64[np.ndarray, "k 6 6"]
    world_from_base: Poses
    seed: np.random.SeedSequence
    rate_hz: float
    others: Mapping[str, Poses] = field(default_factory=dict)

    def images(self, camera: str | None = None) -> Iterator[UInt8[np.ndarray, "height width 3"]]:
        """The images in order, RGB, rendered one by one; every call gives the same bytes.

        While the camera stands, light is traced once; auto exposure and sensor noise go on. `camera` is one of the
        others, None for the first.
        """
        seed, base_from_camera = self.seed, self.base_from_camera
        if camera is not None:
            base_from_camera = self.others[camera]
            seed = np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, [*self.others].index(camera)))
        rng = np.random.default_rng(seed)
        # Exposure follows in the same time at every rate: these are the fractions per tenth of a second.
        lag, keep = 0.75 ** (IMAGE_RATE_HZ / self.rate_hz), 0.97 ** (IMAGE_RATE_HZ / self.rate_hz)
        shake = 0.03 * np.sqrt((1 - keep**2) / (1 - 0.97**2))
        exposure = drift = 0.0  # log2 of the gain: the automatic part lags behind the light, the rest wanders
        traced_at, radiance = None, np.empty(0, np.float32)
        for index in range(len(self.image_times_ns)):
            spread = EXPOSURE_S * ((np.arange(_SAMPLES) + 0.5) / _SAMPLES - 0.5)
            times = self.image_times_ns[index] + np.round(spread * 1e9).astype(np.int64)
            poses = poses_at(self.odometry_times_ns, self.world_from_base, times) @ base_from_camera
            if traced_at is None or not _still(traced_at, poses):
                traced_at, radiance = poses, render(self.scene, self.camera, poses, rng=rng)
            wanted = metered_exposure(radiance)
            exposure = wanted if index == 0 else exposure + (1 - lag) * (wanted - exposure)
            drift = keep * drift + shake * rng.standard_normal()
            yield develop(radiance, self.camera, exposure + drift, rng=rng)


def _still(before: Poses, after: Poses) -> bool:
    distance_m, angle_rad = before.distance(after)
    return bool(max(distance_m.max(), angle_rad.max()) < _STILL_M)


SYNTHESIS = 1
"""Counts up when a seed gives other images, odometry or poses than before."""

_MOST_CAMERAS = 8
_RATES_HZ = (0.1, 200.0)
_LONGEST_STAND_S = 86400.0
_CLEARLY, _ONE_RAY = 0.015, 1e-9  # fractions of the image: with the second, a single coarse ray counts
_CUES: dict[str, Cues] = {"train": "any", "test": "early"}


def synthesize(
    scene: str,
    *,
    seed: int,
    num_frames: int,
    split: Literal["train", "test"] = "test",
    cues: Cues | None = None,
    width: int = 320,
    height: int = 240,
    noise: OdometryNoise | None = None,
    rate_hz: float | None = None,
    stand: Stand | None = None,
    cameras: int = 1,
) -> SyntheticSequence:
    """A sequence through a scene.

    Args:
        scene: Name of the scene: one of `SCENES`, or a building by its number, such as `building-7`.
        seed: Of path, odometry and sensor noise, and of the light and the people in a building.
        num_frames: Number of images, without those that a stand adds.
        split: "test" paths keep further from the edges of the hall than "train" paths. In a building, "train" paths of
            five seeds in a row begin evenly spread over a tour of all of it, and there are people on "test" paths.
        cues: Unique things in the scene are passed "early", at will ("any"), or never ("none"); see `choose_path`. None
            for "early" on "test" paths, where there is anything unique, and "any" on "train" paths.
        width, height: Image size in pixels; the horizontal field of view stays the same.
        noise: Of the odometry; None for that of the scene.
        rate_hz: Images a second; None for the scene's, 10 everywhere but in buildings. Path and odometry follow from
            seed and duration alone: every third of 900 images at 30 Hz is taken where and when one of 300 at 10 Hz is.
        stand: Where the camera stands still, and for how long; that adds images. Odometry goes on, noise and bias too.
        cameras: Number of cameras: that of the scene, and others that are turned about the body's vertical axis, evenly
            all round.

    Raises:
        SequenceError: an unknown scene, a size, seed, rate or stand that cannot be, or no path without anything unique
            found.
    """
    spec = find_scene(scene)
    rate_hz = spec.rate_hz if rate_hz is None else rate_hz
    if num_frames < 1 or width < 8 or height < 8 or seed < 0:
        raise SequenceError(
            f"seed {seed}, {num_frames} frames of {width} × {height} pixels, expected a seed from 0, and at least one"
            " frame of 8 × 8"
        )
    if not 1 <= cameras <= _MOST_CAMERAS:
        raise SequenceError(f"{cameras} cameras, expected 1 to {_MOST_CAMERAS}")
    if not _RATES_HZ[0] <= rate_hz <= _RATES_HZ[1]:
        raise SequenceError(f"{rate_hz:g} images a second, expected {_RATES_HZ[0]:g} to {_RATES_HZ[1]:g}")
    if stand is not None and not (0 <= stand.image < num_frames and 0 < stand.duration_s <= _LONGEST_STAND_S):
        raise SequenceError(f"{stand}, expected an image below {num_frames} and at most {_LONGEST_STAND_S:g} s")
    entropy = [seed, SPLITS[split], *spec.seed_numbers]
    path_seed, odometry_seed, image_seed = np.random.SeedSequence(entropy).spawn(3)
    built = spec.build(split, seed)
    camera, base_from_camera = camera_of(scene, width, height), spec.base_from_camera
    rng = np.random.default_rng(path_seed)

    def draw(num_images: int) -> Poses:
        duration_s = float((image_stamps(num_images)[-1] - EPOCH_NS) * 1e-9 + TAIL_S)
        return spec.path(duration_s, split, seed, rng)

    def look(base: Poses, num_images: int, closely: bool) -> Bool[np.ndarray, " n"]:
        at_images = poses_at(odometry_stamps(base), base, image_stamps(num_images)) @ base_from_camera
        return sees_cue(built, camera, at_images, min_fraction=_ONE_RAY if closely else _CLEARLY)

    base = choose_path(
        cues or (_CUES[split] if spec.has_cues else "any"),
        math.ceil(num_frames * IMAGE_RATE_HZ / rate_hz - 1e-6),
        poses_per_image=IMAGE_PERIOD_NS // ODOMETRY_PERIOD_NS,
        draw=draw,
        look=look,
    )
    if base is None:
        raise SequenceError(
            f"{scene}, seed {seed}: no random path has {num_frames} images in a row that show nothing unique,"
            " expected fewer frames or another seed"
        )
    num_images = num_frames
    if stand is not None:
        still_images = max(1, round(stand.duration_s * rate_hz))
        first_still_ns = int(image_stamps(stand.image + 1, rate_hz)[-1])
        base = halted(base, first_still_ns, still_images / rate_hz, walks_on=stand.walks_on)
        num_images = still_images + (num_frames if stand.walks_on else stand.image)
    image_times_ns, base_times_ns = image_stamps(num_images, rate_hz), odometry_stamps(base)
    odom_from_base, twist_covariances = simulate_odometry(
        base_times_ns, base, noise or spec.noise, rng=np.random.default_rng(odometry_seed)
    )
    return SyntheticSequence(
        scene=built,
        camera=camera,
        base_from_camera=base_from_camera,
        image_times_ns=image_times_ns,
        world_from_camera=poses_at(base_times_ns, base, image_times_ns) @ base_from_camera,
        odometry_times_ns=base_times_ns,
        odom_from_base=odom_from_base,
        twist_covariances=twist_covariances,
        world_from_base=base,
        seed=image_seed,
        rate_hz=rate_hz,
        others={
            f"camera_{number}": Poses.exp(np.array([0, 0, 0, 0, 0, 2 * np.pi * number / cameras])) @ base_from_camera
            for number in range(1, cameras)
        },
    )


def camera_of(name: str, width: int, height: int) -> Camera:
    """The camera that moves through a scene, for images of this size in pixels.

    Raises:
        SequenceError: no such scene, or a size that no camera has.
    """
    focal = width / 2 / np.tan(np.radians(find_scene(name).field_of_view_deg / 2))
    return Camera(width, height, float(focal), float(focal), (width - 1) / 2, (height - 1) / 2)


def write_synthetic(
    sequence: SyntheticSequence,
    output: Path,
    *,
    inertial: InertialNoise | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> None:
    """Render a sequence into an MCAP file, with odometry, true poses and extrinsics.

    Args:
        sequence: From `synthesize`.
        output: The file; it appears when complete.
        inertial: Errors of an inertial unit on the body, at the stamps of the odometry; None for no unit.
        progress: Called after every image with the number done and the number of all.

    Raises:
        SequenceError: the file cannot be written.
    """
    metadata = {"images": "synthetic", "odometry": "simulated with scale error, drift and noise, 50 Hz"}
    others = {name: MountedCamera(sequence.camera, mount) for name, mount in sequence.others.items()}
    with SequenceWriter(
        output, camera=sequence.camera, base_from_camera=sequence.base_from_camera, others=others, metadata=metadata
    ) as writer:
        written = 0
        beside = {name: sequence.images(name) for name in sequence.others}
        if inertial is not None:
            _write_inertial(writer, sequence, inertial)
        for i, image in enumerate(sequence.images()):
            time_ns = int(sequence.image_times_ns[i])
            reached = int(np.searchsorted(sequence.odometry_times_ns, time_ns, side="right"))
            _write_odometry(writer, sequence, range(written, reached))
            written = reached
            writer.write_image(time_ns, image)
            for name, images in beside.items():
                writer.write_image(time_ns, next(images), name)
            writer.write_true_pose(time_ns, sequence.world_from_camera[i])
            progress(i + 1, len(sequence.image_times_ns))
        _write_odometry(writer, sequence, range(written, len(sequence.odometry_times_ns)))


def _write_inertial(writer: SequenceWriter, sequence: SyntheticSequence, noise: InertialNoise) -> None:
    own = np.random.SeedSequence(sequence.seed.entropy, spawn_key=(*sequence.seed.spawn_key, 1))
    times_ns, rng = sequence.odometry_times_ns, np.random.default_rng(own)
    force, turn = simulate_inertial(times_ns, sequence.world_from_base, noise, rng=rng)
    for k, time_ns in enumerate(times_ns.tolist()):
        writer.write_inertial(time_ns, force[k], turn[k])


def _write_odometry(writer: SequenceWriter, sequence: SyntheticSequence, indices: range) -> None:
    for k in indices:
        time_ns = int(sequence.odometry_times_ns[k])
        writer.write_odometry(time_ns, sequence.odom_from_base[k], sequence.twist_covariances[k])
