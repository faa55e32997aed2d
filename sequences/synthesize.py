"""Scene + path + camera sensor + odometry -> a sequence whose true poses are known."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float32, Float64, Int64, UInt8

from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.frame import Camera
from sequences.odometry import OdometryNoise, simulate_odometry
from sequences.render import render, sees_cue
from sequences.scenes import ceiling, staircase
from sequences.scenes.paths import STEP_S, roll_through_hall, walk_stairs
from sequences.scenes.surface import Scene, build_scene
from sequences.writer import SequenceWriter

SCENES: tuple[str, ...] = ("staircase", "ceiling")
"""Names that `synthesize` takes."""

IMAGE_PERIOD_NS, ODOMETRY_PERIOD_NS = 100_000_000, 20_000_000
EPOCH_NS = 1_700_000_000_000_000_000  # the first odometry message
_LEAD_NS = 513_000_000  # the first image comes later, and between two odometry messages
_TAIL_S = 0.5  # of odometry after the last image
_EXPOSURE_S = 0.014
_SAMPLES = 4  # per pixel and exposure
_PATHS_TRIED = 100  # one in three will do at 300 images; where none can, as in a very tall image, any must do
_STREAMS = {"train": 1, "test": 2}
_FIELD_OF_VIEW = {"staircase": 77.0, "ceiling": 64.0}  # horizontal, degrees


@dataclass(frozen=True)
class SyntheticSequence:
    """A rendered sequence; images are made when they are asked for.

    Attributes:
        scene: What the camera moves through.
        camera: Intrinsics.
        base_from_camera: One pose, the extrinsics.
        image_times_ns: Stamps of the images, the middle of each exposure, 10 Hz.
        world_from_camera: True poses at the images, batch (n,).
        odometry_times_ns: Stamps of the odometry, 50 Hz, from before the first image to after the last.
        odom_from_base: Odometry, batch (k,), with scale error and drift.
        twist_covariances: As `simulate_odometry` states them.
        world_from_base: True poses of the body at the odometry, batch (k,).
        seed: Names the sequence's sensor noise.
    """

    scene: Scene
    camera: Camera
    base_from_camera: Poses
    image_times_ns: Int64[np.ndarray, " n"]
    world_from_camera: Poses
    odometry_times_ns: Int64[np.ndarray, " k"]
    odom_from_base: Poses
    twist_covariances: Float64[np.ndarray, "k 6 6"]
    world_from_base: Poses
    seed: np.random.SeedSequence

    def images(self) -> Iterator[UInt8[np.ndarray, "height width 3"]]:
        """The images in order, RGB, rendered one by one; every call begins anew and gives the same bytes."""
        rng = np.random.default_rng(self.seed)
        exposure = drift = 0.0  # log2 of the gain: the automatic part lags behind the light, the rest wanders
        for index in range(len(self.image_times_ns)):
            spread = _EXPOSURE_S * ((np.arange(_SAMPLES) + 0.5) / _SAMPLES - 0.5)
            times = self.image_times_ns[index] + np.round(spread * 1e9).astype(np.int64)
            poses = _at(self.odometry_times_ns, self.world_from_base, times) @ self.base_from_camera
            radiance = render(self.scene, self.camera, poses, rng=rng)
            wanted = _metered_exposure(radiance)
            exposure = wanted if index == 0 else exposure + 0.25 * (wanted - exposure)
            drift = 0.97 * drift + 0.03 * rng.standard_normal()
            yield develop(radiance, self.camera, exposure + drift, rng=rng)


def synthesize(
    scene: str,
    *,
    seed: int,
    num_frames: int,
    split: Literal["train", "test"] = "test",
    width: int = 320,
    height: int = 240,
    noise: OdometryNoise | None = None,
) -> SyntheticSequence:
    """A sequence through one of the `SCENES`.

    Args:
        scene: Name of the scene.
        seed: Of path, odometry and sensor noise; the scene itself is always the same.
        num_frames: Number of images, 10 a second.
        split: "test" paths of 100 images or more come by something unique early on, so that a filter can know where
            it is (unless 100 random paths do not); "train" paths go everywhere. The same seed gives different paths in
            the two.
        width, height: Image size in pixels; the horizontal field of view stays the same.
        noise: Of the odometry.

    Raises:
        SequenceError: unknown scene, split or size, or a negative seed.
    """
    if scene not in SCENES:
        raise SequenceError(f"unknown scene {scene!r}, expected one of {', '.join(SCENES)}")
    if split not in _STREAMS:
        raise SequenceError(f"unknown split {split!r}, expected train or test")
    if seed < 0:
        raise SequenceError(f"seed {seed}, expected at least 0")
    if num_frames < 1 or width < 8 or height < 8:
        raise SequenceError(f"{num_frames} frames of {width} × {height} pixels, expected at least 1 of 8 × 8")
    path_seed, odometry_seed, image_seed = np.random.SeedSequence([seed, _STREAMS[split], SCENES.index(scene)]).spawn(3)
    built = load_scene(scene)
    camera, base_from_camera = _camera(scene, width, height), _extrinsics(scene)
    image_times_ns = EPOCH_NS + _LEAD_NS + IMAGE_PERIOD_NS * np.arange(num_frames, dtype=np.int64)
    duration_s = (image_times_ns[-1] - EPOCH_NS) * 1e-9 + _TAIL_S
    rng = np.random.default_rng(path_seed)
    tried = 0
    while True:
        base = _path(scene, float(duration_s), split, rng)
        base_times_ns = EPOCH_NS + round(STEP_S * 1e9) * np.arange(len(base), dtype=np.int64)
        world_from_camera = _at(base_times_ns, base, image_times_ns) @ base_from_camera
        tried += 1
        if split == "train" or tried == _PATHS_TRIED or _resolvable(sees_cue(built, camera, world_from_camera[:300])):
            break
    odom_from_base, twist_covariances = simulate_odometry(
        base_times_ns, base, noise or OdometryNoise(), rng=np.random.default_rng(odometry_seed)
    )
    return SyntheticSequence(
        scene=built,
        camera=camera,
        base_from_camera=base_from_camera,
        image_times_ns=image_times_ns,
        world_from_camera=world_from_camera,
        odometry_times_ns=base_times_ns,
        odom_from_base=odom_from_base,
        twist_covariances=twist_covariances,
        world_from_base=base,
        seed=image_seed,
    )


def write_synthetic(
    sequence: SyntheticSequence, output: Path, *, progress: Callable[[int, int], None] | None = None
) -> None:
    """Render a sequence into an MCAP file, with odometry, true poses and extrinsics.

    Args:
        sequence: From `synthesize`.
        output: The file; it appears when complete.
        progress: Called after every image with the number done and the number of all.

    Raises:
        SequenceError: the file cannot be written.
    """
    metadata = {"images": "synthetic", "odometry": "simulated with scale error, drift and noise, 50 Hz"}
    with SequenceWriter(
        output, camera=sequence.camera, base_from_camera=sequence.base_from_camera, metadata=metadata
    ) as writer:
        written = 0
        for i, image in enumerate(sequence.images()):
            time_ns = int(sequence.image_times_ns[i])
            reached = int(np.searchsorted(sequence.odometry_times_ns, time_ns, side="right"))
            _write_odometry(writer, sequence, range(written, reached))
            written = reached
            writer.write_image(time_ns, image)
            writer.write_true_pose(time_ns, sequence.world_from_camera[i])
            if progress is not None:
                progress(i + 1, len(sequence.image_times_ns))
        _write_odometry(writer, sequence, range(written, len(sequence.odometry_times_ns)))


def _write_odometry(writer: SequenceWriter, sequence: SyntheticSequence, indices: range) -> None:
    for k in indices:
        time_ns = int(sequence.odometry_times_ns[k])
        writer.write_odometry(time_ns, sequence.odom_from_base[k], sequence.twist_covariances[k])


@cache
def load_scene(scene: str) -> Scene:
    """Build one of the `SCENES`, once per process."""
    return build_scene({"staircase": staircase, "ceiling": ceiling}[scene].placements(), seed=0)


def develop(
    radiance: Float32[np.ndarray, "height width 3"], camera: Camera, exposure: float, *, rng: np.random.Generator
) -> UInt8[np.ndarray, "height width 3"]:
    """What a small camera makes of light: vignetting, shot and read noise, tone curve, eight bits.

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


def _metered_exposure(radiance: np.ndarray) -> float:
    """log2 of the gain that brings the geometric mean of the light to middle grey."""
    luminance = radiance[::4, ::4].mean(axis=-1)
    return float(np.clip(np.log2(0.42) - np.log2(luminance + 1e-3).mean(), -5.0, 4.5))


def _at(times_ns: np.ndarray, poses: Poses, query_ns: np.ndarray) -> Poses:
    """Poses at other times, along the geodesic between neighbours."""
    after = np.clip(np.searchsorted(times_ns, query_ns, side="right"), 1, len(times_ns) - 1)
    fraction = (query_ns - times_ns[after - 1]) / (times_ns[after] - times_ns[after - 1])
    return poses[after - 1].interpolate(poses[after], fraction)


def _resolvable(seen: np.ndarray) -> bool:
    """Something unique shows for half a second in the first half, but seldom overall; short paths all pass."""
    return len(seen) < 100 or bool(seen[: len(seen) // 2].sum() >= 5 and seen.mean() < 0.25)


def _path(scene: str, duration_s: float, split: str, rng: np.random.Generator) -> Poses:
    if scene == "staircase":
        return walk_stairs(duration_s, rng=rng)
    return roll_through_hall(duration_s, margin_m=1.0 if split == "train" else 1.8, rng=rng)


def _camera(scene: str, width: int, height: int) -> Camera:
    focal = width / 2 / np.tan(np.radians(_FIELD_OF_VIEW[scene] / 2))
    return Camera(width, height, float(focal), float(focal), (width - 1) / 2, (height - 1) / 2)


def _extrinsics(scene: str) -> Poses:
    """base_from_camera: on a helmet, looking forward and 10° down; on a cart, looking straight up."""
    if scene == "staircase":
        tilt = np.radians(10)
        forward = np.array([np.cos(tilt), 0, -np.sin(tilt)])
        right = np.array([0, -1.0, 0])
        return Poses(np.stack([right, np.cross(forward, right), forward], axis=1), np.array([0.06, 0.03, 0.05]))
    right, up = np.array([0, -1.0, 0]), np.array([0, 0, 1.0])
    return Poses(np.stack([right, np.cross(up, right), up], axis=1), np.array([0.12, -0.04, 0.9]))
