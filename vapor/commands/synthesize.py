"""`vapor-track synthesize`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import tyro

from sequences.errors import SequenceError
from sequences.inertial.simulation import InertialNoise
from sequences.outputs import refuse_other
from sequences.paths import Cues
from sequences.scenes import SCENES
from sequences.synthesize import synthesize, write_synthetic
from sequences.writer import is_own_sequence
from vapor.commands.console import OutputPath, Overwrite, parse, show, usage_error
from vapor.commands.progress import progress


@dataclass(frozen=True)
class Options:
    """Render a sequence through a synthetic scene, with odometry and true poses."""

    scene: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar=f"{{{','.join(SCENES)}}}|building-N")]
    """The scene. The number N is the seed of a building, which has a camera and an odometry of its own."""
    output: Annotated[tyro.conf.Positional[OutputPath], tyro.conf.arg(metavar="OUT.mcap")]
    """MCAP file to write, new or synthesized before."""
    overwrite: Overwrite = False
    seed: int = 0
    """Seed of path, odometry noise and sensor noise; in a building also of light and people."""
    frames: int = 300
    """Number of images."""
    rate: float | None = None
    """Images a second. Default: 10; in a building, by its number. The same seed and duration give the same path and
    odometry at every rate."""
    split: Literal["test", "train"] = "test"
    """test: paths pass something unique in their first half. train: paths go everywhere; in a building, those of seeds
    0 to 4 begin evenly spread over a tour of all of it."""
    cues: Cues | None = None
    """When the path passes something unique: early, in its first half; any, wherever it is; none, never. Default: by
    the split."""
    imu: bool = False
    """Also simulate an inertial unit on the body, with the errors of a small one."""
    width: int = 320
    """Image width in pixels."""
    height: int = 240
    """Image height in pixels."""
    cameras: int = 1
    """Number of cameras: the scene's own one, and others that look evenly all round."""


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    o = parse("synthesize", Options, arguments)
    refuse_other(o.output, "sequence that vapor-track wrote", is_own_sequence, overwrite=o.overwrite)
    try:
        sequence = synthesize(
            o.scene,
            seed=o.seed,
            num_frames=o.frames,
            split=o.split,
            cues=o.cues,
            width=o.width,
            height=o.height,
            rate_hz=o.rate,
            cameras=o.cameras,
        )
    except SequenceError as error:  # of numbers that no sequence can have
        usage_error("synthesize", str(error))
    with progress("rendering") as advance:
        inertial = InertialNoise() if o.imu else None
        write_synthetic(sequence, o.output, inertial=inertial, progress=advance)
    show(f"{o.output}: {o.frames} images, {o.output.stat().st_size / 1e6:.1f} MB")
