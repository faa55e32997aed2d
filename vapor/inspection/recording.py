"""Recordings in space for Rerun: cameras by the number of passes that show the same, images, predictions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from filtering.se3 import Poses
from sequences.datasets.scene_points import ScenePoints
from vapor.inspection.coverage import Coverage
from vapor.inspection.predictions import Predictions
from vapor.reporting.rerun_layout import log_legend, space_view, with_legend
from vapor.reporting.rerun_place import Place, log_cameras
from vapor.reporting.rerun_recording import recorded
from vapor.reporting.rerun_shapes import Photograph, steps, thinned

if TYPE_CHECKING:
    import rerun as rr

_SHOWN = {  # by how many passes: the colours of the map, brighter against a dark ground
    "1 pass": ("red", (235, 95, 30)),
    "2 passes": ("yellow", (240, 200, 110)),
    "3 passes": ("light blue", (165, 210, 235)),
    "4 passes": ("blue", (70, 155, 225)),
    "5 and more passes": ("dark blue", (40, 95, 215)),
}
_RIGHT, _WRONG = (0, 190, 140), (225, 120, 200)
_LINES = 150  # from where the model puts a camera to where it was, at most: more hide what they lead to
_POINTS = 100_000  # of a place, at most
_PATH = (105, 105, 112)


def record_coverage(
    path: Path,
    coverage: Coverage,
    photographs: Sequence[tuple[int, Photograph]],
    predictions: Predictions | None = None,
    *,
    points: Sequence[ScenePoints] = (),
) -> Path:
    """Record cameras, some of their images by number, points of the place, and the cameras as a model predicts them.

    The recording, `.rrd`, appears under its name only when complete.

    Raises:
        SequenceError, VaporTrackError: it cannot be written.
    """
    import rerun as rr

    poses, names = coverage.images.poses, coverage.images.names
    predicted = [] if predictions is None else [predictions.best[predictions.best.is_finite()]]
    place = Place(Poses.concatenate([poses, *predicted]), "cameras")
    colors = [color for _, color in _SHOWN.values()]
    shown = np.minimum(coverage.others, len(colors) - 1)
    title = names[0] if len(names) == 1 else f"{len(names)} recordings"
    with recorded(path, "vapor-track inspect", title) as stream:
        view = space_view("cameras", place.first_view())
        stream.send_blueprint(with_legend(view, [], [], selection=True))
        place.log_up(stream)
        log_legend(stream, _legend(coverage, predictions is not None))
        for number, passes in enumerate(_SHOWN):
            if (own := shown == number).any():
                entity = f"world/cameras/{passes.replace(' ', '_')}"
                log_cameras(stream, entity, poses[own], colors[number], size_m=place.small_camera_m)
        for number, name in enumerate(names):
            lines = steps(poses.translation[coverage.images.sequence == number])
            strips = rr.LineStrips3D(lines, colors=_PATH, radii=rr.Radius.ui_points(0.7))
            stream.log(["world", "paths", name], strips, static=True)
        for number, each in enumerate(points):
            some = np.linspace(0, len(each) - 1, min(len(each), _POINTS)).round().astype(np.int64)
            cloud = rr.Points3D(each.positions[some], colors=each.colors[some], radii=rr.Radius.ui_points(1.0))
            stream.log(f"world/place/points/{number}", cloud, static=True)
        for number, photograph in photographs:
            where = f"world/images/{number}"
            photograph.log(stream, where, poses[number], color=colors[shown[number]], size_m=2 * place.small_camera_m)
        if predictions is not None:
            _log_predictions(stream, coverage, predictions)
    return path


def _log_predictions(stream: rr.RecordingStream, coverage: Coverage, predictions: Predictions) -> None:
    """Cameras as points where the model predicts them, with lines from some to where they were."""
    import rerun as rr

    known = predictions.best.is_finite()
    for name, color, own in (
        ("right", _RIGHT, known & predictions.right),
        ("wrong", _WRONG, known & ~predictions.right),
    ):
        found, true = predictions.best[own], coverage.images.poses[own]
        if not len(found):
            continue
        points = rr.Points3D(found.translation, colors=color, radii=rr.Radius.ui_points(2.0))
        stream.log(f"world/model/{name}", points, static=True)
        ends = [thinned(poses, _LINES).translation for poses in (found, true)]
        faint = [part // 3 for part in color]
        lines = rr.LineStrips3D(np.stack(ends, axis=1), colors=faint, radii=rr.Radius.ui_points(0.4))
        stream.log(f"world/model/{name}/off", lines, static=True)


def _legend(coverage: Coverage, with_model: bool) -> str:
    those = " (passes of one recording count as one)" if coverage.by_recordings else ""
    cameras = ", ".join(f"**{name}** {passes}" for passes, (name, _) in _SHOWN.items())
    legend = f"cameras by how many passes show what they saw{those}: {cameras}; select an image to see it large"
    if with_model:
        legend += "  ·  the model's best place of each image: **green** right (within 0.3 m and 20°), **pink** wrong"
    return legend
