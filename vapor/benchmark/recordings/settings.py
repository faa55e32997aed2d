"""What a recording depends on: it names the folder in which the recording is found again."""

from __future__ import annotations

import importlib.metadata
import json
from dataclasses import asdict, dataclass, field
from typing import Any

from sequences.paths import Cues
from sequences.synthesize import SYNTHESIS
from vapor.cache import code_digest, digest
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.engines.engine import Precision


def seen_digest(checkpoint: Checkpoint) -> str:
    """Digest of all that what is seen in an image depends on: the model, and the code that finds landmarks."""
    if checkpoint.landmarks is None:
        return checkpoint.seen_sha256()
    errors = json.loads(json.dumps(asdict(checkpoint.calibration.errors)))
    code = code_digest("vapor.landmarks", "vapor.observation", "vapor.cameras")
    return digest({"seen": checkpoint.seen_sha256(), "errors": errors, "code": code})


@dataclass(frozen=True)
class RecordingSettings:
    """Everything that the recording of a synthetic sequence depends on.

    Attributes:
        scene: Name of the scene.
        seed: Of the path and of all noise.
        cues: What is unique along the path.
        frames: Number of images of the path.
        width, height: Image size in pixels.
        network_sha256: Of what the network says of an image.
        num_samples: Posterior samples per image.
        rate_hz: Images a second.
        stand: The image at which the camera stops, and for how many seconds it stands; None if it does not stop.
        part: The first of the images that are recorded, and how many; None for all.
        change: What is done to every image before the network sees it, one of `FOREIGN`; None for nothing.
        odometry_scale: Error of the odometry's distances, as a fraction of them; None for a random one.
        precision: Of the network's arithmetic; which engine ran it is not told: they agree within rounding.
        camera: The camera that it is rendered with, the numbers of `Camera`; None for that of its scene.
        synthesis: Version of the code that renders.
        package: Version of this package.
    """

    scene: str
    seed: int
    cues: Cues
    frames: int
    width: int
    height: int
    network_sha256: str
    num_samples: int
    rate_hz: float = 10.0
    stand: tuple[int, float] | None = None
    part: tuple[int, int] | None = None
    change: str | None = None
    odometry_scale: float | None = None
    precision: Precision = "float32"
    camera: tuple[int, int, float, float, float, float] | None = None
    synthesis: int = SYNTHESIS
    package: str = field(default_factory=lambda: importlib.metadata.version("vapor-track"))

    @property
    def name(self) -> str:
        """Name of its folder: recordings with other settings have other names."""
        return f"{self.scene}-{self.cues}-{self.seed}-{digest(self.stored)}"

    @property
    def stored(self) -> dict[str, Any]:
        """All settings by name, without those that have their usual value: names of older recordings stay valid."""
        content = asdict(self)
        unusual = ("stand", "part", "change", "odometry_scale", "camera")
        for name, ordinary in (("rate_hz", 10.0), ("precision", "float32"), *((name, None) for name in unusual)):
            if content[name] == ordinary:
                del content[name]
        return json.loads(json.dumps(content))


@dataclass(frozen=True)
class FileSettings:
    """Everything that the recording of an MCAP file depends on.

    Attributes:
        sequence: Name of the file.
        made: Digest of everything that the file was made from.
        seen_sha256: Of what the network says of an image, its samples and how familiar it is.
        seed: Of the network's latent noise.
        num_samples: Posterior samples per image.
        images: How many, from the first one on; None for all.
        change: What is done to every image before the network sees it, one of `FOREIGN`; None for nothing.
        precision: Of the network's arithmetic.
    """

    sequence: str
    made: str
    seen_sha256: str
    seed: int
    num_samples: int
    images: int | None = None
    change: str | None = None
    precision: Precision = "float32"

    @property
    def name(self) -> str:
        """Name of its folder: recordings with other settings have other names."""
        return f"{self.sequence}-{digest(self.stored)}"

    @property
    def stored(self) -> dict[str, Any]:
        """All settings by name, without those that have their usual value: names of older recordings stay valid."""
        usual = {"images": None, "change": None, "precision": "float32"}
        return {name: value for name, value in asdict(self).items() if name not in usual or value != usual[name]}
