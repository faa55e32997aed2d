"""The camera of the images that a map is made of: pinhole, with two coefficients of radial distortion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from sequences.frame import Camera

_ROUNDS = 8  # of the fixed point that takes distortion away


@dataclass(frozen=True)
class ViewCamera:
    """A camera: a point (x, y, 1) along a ray is seen at f (1 + k₁ r² + k₂ r⁴) (x, y) + c, where r² = x² + y².

    Attributes:
        camera: Pinhole.
        k1: Radial distortion.
        k2: Of the next order.
    """

    camera: Camera
    k1: float = 0.0
    k2: float = 0.0

    @property
    def focal(self) -> Float64[np.ndarray, "2"]:
        """Focal lengths, pixels."""
        return np.array([self.camera.fx, self.camera.fy])

    @property
    def centre(self) -> Float64[np.ndarray, "2"]:
        """Principal point, pixels."""
        return np.array([self.camera.cx, self.camera.cy])

    @property
    def size(self) -> Float64[np.ndarray, "2"]:
        """Width and height, pixels."""
        return np.array([self.camera.width, self.camera.height], np.float64)

    def rays(self, pixels: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 2"]:
        """The x and y of rays (x, y, 1) through pixels."""
        seen = (pixels - self.centre) / self.focal
        if self.k1 == self.k2 == 0.0:
            return seen
        ray = seen
        for _ in range(_ROUNDS):
            squared = np.square(ray).sum(axis=1, keepdims=True)
            ray = seen / np.maximum(1.0 + squared * (self.k1 + self.k2 * squared), 0.2)
        return ray

    def pixels(self, rays: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 2"]:
        """Where rays (x, y, 1) are seen, of which their x and y are given."""
        squared = np.square(rays).sum(axis=1, keepdims=True)
        return self.focal * (1.0 + squared * (self.k1 + self.k2 * squared)) * rays + self.centre

    def without_distortion(self) -> ViewCamera:
        """The pinhole camera that sees the same rays at `undistorted` pixels."""
        return ViewCamera(self.camera)

    def undistorted(self, pixels: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 2"]:
        """Where a camera without distortion sees what this one sees at pixels."""
        return pixels if self.k1 == self.k2 == 0.0 else self.rays(pixels) * self.focal + self.centre
