"""Walks through synthetic scenes, rendered once into files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from sequences.inertial.simulation import InertialNoise
from sequences.synthesize import SYNTHESIS, synthesize, write_synthetic


@dataclass(frozen=True)
class RenderedWalk:
    """A walk through a synthetic scene, in 4:3 images of some height, pixels.

    Attributes:
        rate_hz: Images a second; None for the scene's.
        cameras: Number of cameras.
        inertial: Whether there is an inertial unit on the body.
    """

    scene: str
    split: Literal["train", "test"]
    seed: int
    frames: int
    height: int
    rate_hz: float | None = None
    cameras: int = 1
    inertial: bool = False

    @property
    def name(self) -> str:
        """All that its images and messages depend on."""
        parts = [self.scene, self.split, str(self.seed), str(self.frames)]
        parts += [] if self.rate_hz is None else [f"{self.rate_hz:.4f}hz"]
        parts += [] if self.cameras == 1 else [f"{self.cameras}cameras"]
        parts += ["imu"] if self.inertial else []
        return "-".join([*parts, f"{round(self.height * 4 / 3)}x{self.height}", str(SYNTHESIS)])

    def file(self, directory: Path) -> Path:
        """Where it lies."""
        return directory / "images" / f"{self.name}.mcap"

    def render(self, directory: Path) -> None:
        """Render it unless that is done."""
        file = self.file(directory)
        if file.exists():
            return
        file.parent.mkdir(parents=True, exist_ok=True)
        sequence = synthesize(
            self.scene,
            seed=self.seed,
            num_frames=self.frames,
            split=self.split,
            width=round(self.height * 4 / 3),
            height=self.height,
            rate_hz=self.rate_hz,
            cameras=self.cameras,
        )
        write_synthetic(sequence, file, inertial=InertialNoise() if self.inertial else None)
