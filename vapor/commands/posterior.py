"""`vapor-track posterior`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from sequences.datasets.frames import posed_frames
from sequences.datasets.listing import files_read
from sequences.outputs import refuse_other
from vapor.checkpoints.file_format import find_model
from vapor.commands.console import OutputPath, Overwrite, parse, show, show_notices
from vapor.commands.model_name import ModelName
from vapor.engines.engine import Device, EngineConfig
from vapor.engines.start import describe
from vapor.evaluation.trajectory import THRESHOLDS
from vapor.observation import VaporObservationModel
from vapor.reporting.drawing import is_picture
from vapor.reporting.posterior_pictures import draw_posterior, record_posterior
from vapor.reporting.rerun_place import Place
from vapor.reporting.rerun_recording import is_recording


@dataclass(frozen=True)
class Options:
    """Draw the posterior of one image: positions from above, marginals, orientations on a sphere."""

    data: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DATA")]
    """MCAP file or data set folder with true poses."""
    output: OutputPath
    """Picture to write (.png), new or of an earlier call."""
    overwrite: Overwrite = False
    recording: bool = False
    """Write the posterior in space for the Rerun viewer as well, beside the picture, as .rrd."""
    model: ModelName = "staircase"
    """Name of a model that ships with the package, or model file."""
    image: int = 0
    """Which of the images with a true pose, from 0."""
    num_samples: int = 1000
    """Posterior samples."""
    gamma: float = 0.1
    """Fraction of the samples that must be near the true pose for the posterior to count as right."""
    seed: int = 0
    """Seed of the samples."""
    device: Device = "auto"
    """Where the network runs."""
    network: Annotated[EngineConfig, tyro.conf.arg(name="")] = field(default_factory=EngineConfig)

    def __post_init__(self) -> None:
        if self.image < 0 or self.seed < 0:
            raise VaporTrackError(f"image {self.image} and seed {self.seed}, expected numbers from 0")
        if not 0.0 < self.gamma <= 1.0:
            raise VaporTrackError(f"gamma is {self.gamma}, expected it in (0, 1]")


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    o = parse("posterior", Options, arguments)
    from vapor.evaluation.posterior import posterior_metrics  # torch is not needed for help and wrong options

    file = find_model(o.model)
    reads = [file, *files_read(o.data)]
    refuse_other(o.output, "picture of vapor-track", is_picture, reads=reads, overwrite=o.overwrite)
    recording = o.output.with_suffix(".rrd")
    if o.recording:
        refuse_other(recording, "recording of Rerun", is_recording, reads=reads, overwrite=o.overwrite)
    described = describe(file)
    frame = next(posed_frames(o.data, frames=slice(o.image, o.image + 1)))
    model = VaporObservationModel(
        described,
        num_samples=o.num_samples,
        device=o.device,
        camera=frame.camera,
        engine=o.network.engine,
        precision=o.network.precision,
    )
    truth = frame.world_from_camera
    assert truth is not None  # `posed_frames` yields no other
    posterior = model.observe(frame.image, rng=np.random.default_rng(o.seed))
    samples = posterior.samples
    title = f"{o.data.name}, image {o.image} at {frame.time_ns / 1e9:.3f} s"
    surroundings = model.description.prior_poses.translation
    draw_posterior(o.output, samples, image=frame.image, surroundings=surroundings, truth=truth, title=title)
    if o.recording:
        place = Place.of_model(model.description)
        record_posterior(recording, posterior, frame=frame, truth=truth, place=place, title=title)
    figures = posterior_metrics([samples], Poses.stack([truth]), model.description.calibration, gamma=o.gamma)
    near = [t for t in THRESHOLDS if figures["recall"][t]]
    best = figures["mode"]
    fraction = f"{o.gamma:.0%} of the samples within"
    within = f"at least {fraction} {near[0]}" if near else f"fewer than {fraction} {list(THRESHOLDS)[-1]}"
    show(
        f"{o.output}: {figures['modes']:.0f} modes, the best one {best['translation_m']:.2f} m and"
        f" {best['rotation_deg']:.1f}° off; {within}"
    )
    if o.recording:
        show(f"recording  rerun {recording}")
    show_notices(model.notices)
