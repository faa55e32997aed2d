"""A rendered sequence whose true poses are known, and the sensor of its camera."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64, Int64, UInt8

from filtering.se3 import Poses
from sequences.frame import Camera
from sequences.paths.motion import EXPOSURE_S, IMAGE_RATE_HZ, poses_at
from sequences.rendering.render import LitScene, render


def metered_exposure(radiance: np.ndarray) -> float:
    """log2 of the gain that brings the geometric mean of the light to middle grey."""
    luminance = radiance[::4, ::4].mean(axis=-1)
    return float(np.clip(np.log2(0.42) - np.log2(luminance + 1e-3).mean(), -5.0, 4.5))


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


_STILL_M = 1e-9  # a camera that moves less than this, and turns less than as many radians, stands
_SAMPLES = 4  # per pixel and exposure


@dataclass(frozen=True)
class SyntheticSequence:
    """A rendered sequence; images are made when they are asked for.

    Attributes:
        scene: What the camera moves through.
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
    rate_hz: float = IMAGE_RATE_HZ

    def images(self) -> Iterator[UInt8[np.ndarray, "height width 3"]]:
        """The images in order, RGB, rendered one by one; every call begins anew and gives the same bytes.

        While the camera stands, light is traced once and every image is exposed and developed anew: auto exposure and
        sensor noise go on, and all that is missing is how the few scattered reflections of gloss would differ.
        """
        rng = np.random.default_rng(self.seed)
        # Exposure follows in the same time at every rate: these are the fractions per tenth of a second.
        lag, keep = 0.75 ** (IMAGE_RATE_HZ / self.rate_hz), 0.97 ** (IMAGE_RATE_HZ / self.rate_hz)
        shake = 0.03 * np.sqrt((1 - keep**2) / (1 - 0.97**2))
        exposure = drift = 0.0  # log2 of the gain: the automatic part lags behind the light, the rest wanders
        traced_at, radiance = None, np.empty(0, np.float32)
        for index in range(len(self.image_times_ns)):
            spread = EXPOSURE_S * ((np.arange(_SAMPLES) + 0.5) / _SAMPLES - 0.5)
            times = self.image_times_ns[index] + np.round(spread * 1e9).astype(np.int64)
            poses = poses_at(self.odometry_times_ns, self.world_from_base, times) @ self.base_from_camera
            if traced_at is None or not _still(traced_at, poses):
                traced_at, radiance = poses, render(self.scene, self.camera, poses, rng=rng)
            wanted = metered_exposure(radiance)
            exposure = wanted if index == 0 else exposure + (1 - lag) * (wanted - exposure)
            drift = keep * drift + shake * rng.standard_normal()
            yield develop(radiance, self.camera, exposure + drift, rng=rng)


def _still(before: Poses, after: Poses) -> bool:
    distance_m, angle_rad = before.distance(after)
    return bool(max(distance_m.max(), angle_rad.max()) < _STILL_M)
