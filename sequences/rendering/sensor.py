"""What a small camera makes of light: exposure, vignetting, noise, tone curve, eight bits."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32, UInt8

from sequences.frame import Camera


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
