"""What one image says of where its camera is, as a Rerun recording."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from filtering.estimate import posterior_modes
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from sequences.frame import Frame
from vapor.reporting.rerun_hypotheses import HypothesisColors
from vapor.reporting.rerun_layout import TRUTH, log_legend, log_styles, space_view, with_legend
from vapor.reporting.rerun_modes import shown_modes
from vapor.reporting.rerun_photographs import Photograph
from vapor.reporting.rerun_place import Place
from vapor.reporting.rerun_recording import recorded
from vapor.reporting.rerun_shapes import frusta, thinned

_CLOUD_SIZE, _FRUSTA = 2000, 100
_LEGEND = (
    "**orange** samples of the image's posterior  ·  **blue** the place that most of them say, **other colours** the"
    " others, each with its fraction of the samples and an ellipsoid of two standard deviations  ·  **white** true pose"
    "  ·  **grey** {what}"
)


def record_posterior(
    path: Path, posterior: PosePosterior, *, frame: Frame, truth: Poses, place: Place, title: str
) -> Path:
    """Record an image's posterior in space, among what outlines the place.

    Args:
        path: The recording, `.rrd`; it appears under its name only when complete.
        posterior: What the image says.
        frame: The image.
        truth: Its true pose.
        place: Where it happens.
        title: Such as the name of the sequence and the stamp of the image.

    Raises:
        SequenceError, VaporTrackError: it cannot be written.
    """
    import rerun as rr
    import rerun.blueprint as rrb

    image = rrb.Spatial2DView(origin="world/camera", contents="world/camera", name="image")
    with recorded(path, "vapor-track posterior", title) as stream:
        stream.send_blueprint(with_legend(space_view("posterior", place.first_view()), [image], [1.0]))
        log_styles(stream)
        log_legend(stream, _LEGEND.format(what=place.what))
        place.log(stream)
        points = thinned(posterior.samples, _CLOUD_SIZE).translation.astype(np.float32)
        cameras = frusta(thinned(posterior.samples, _FRUSTA), place.small_camera_m)
        stream.log("world/posterior", rr.Points3D.from_fields(positions=points), static=True)
        stream.log("world/posterior/cameras", rr.LineStrips3D.from_fields(strips=cameras), static=True)
        if modes := posterior_modes(posterior):
            colors = HypothesisColors(place.camera_m).of(Poses.stack([mode.world_from_camera for mode in modes]), None)
            for entity, archetype, components in shown_modes(modes, colors, camera_m=0.8 * place.camera_m):
                stream.log(entity, archetype.from_fields(**components), static=True)
        Photograph.of(frame).log(stream, "world/camera", truth, color=TRUTH, size_m=place.camera_m)
    return path
