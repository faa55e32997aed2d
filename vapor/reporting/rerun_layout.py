"""How a run is laid out in Rerun: panels, axes, colours, sizes, names of plotted lines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from filtering.estimate import Status
from vapor.reporting.drawing import COLORS, rgb
from vapor.reporting.rerun_place import Place
from vapor.reporting.rerun_shapes import BEST
from vapor.tracking.methods import METHODS

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

_BACKGROUND = (20, 22, 26)  # of views in space, whatever the viewer's theme: against it colours were chosen
TRUTH = (245, 245, 245)
"""Of the true pose and path."""
_GREEN, _VIOLET = (0, 158, 115), (165, 105, 225)
_PATHS = ("filter", "truth", "smoothed", "dead_reckoning")
FOLLOWED = "world/followed"
"""The point that a live view follows from outside; where a camera itself is followed, Rerun looks out of it."""
ERROR_CURVES = ("filter", "smoothed", "dead_reckoning")
"""The methods whose errors are plotted."""
_STATUS: Mapping[Status, tuple[int, int, int]] = {
    "converged": (60, 150, 110),
    "ambiguous": (225, 150, 60),
    "lost": (181, 66, 59),
}
_LEGEND = (
    "**blue** best hypothesis, its particles, the filter's path  ·  **other colours** other hypotheses, each with its"
    " weight and an ellipsoid of two standard deviations  ·  **orange** samples of the image's own posterior"
)
_LEGEND_AT_END = "  ·  **white** true pose and path  ·  **green** smoothed  ·  **violet** dead reckoning"


def path_color(name: str) -> tuple[int, int, int]:
    """The colour of a path: of a tracking method, or of the truth."""
    return {"truth": TRUTH, "filter": BEST, "dead_reckoning": _VIOLET}.get(name) or rgb(COLORS[name])


def log_run_styles(stream: rr.RecordingStream, place: Place | None, *, live: bool = False) -> None:
    """Log everything that never changes in a run: the place, colours, sizes, names of plotted lines, and the legend.

    Points and lines have a size on the screen; cameras are in proportion to the place.
    """
    import rerun as rr

    log_styles(stream)
    ui = rr.Radius.ui_points
    stream.log("world/particles", rr.Points3D.from_fields(radii=ui([2.0])), static=True)
    for name in _PATHS:
        width = 2.5 if name == "truth" else 1.2  # so that it is seen on both sides of the others
        style = rr.LineStrips3D.from_fields(radii=ui([width]), colors=[path_color(name)])
        stream.log(f"world/path/{name}", style, static=True)
    lines = {
        "belief/best_weight": ("weight of the best hypothesis", BEST),
        "belief/unassigned": ("at none of the modes", _VIOLET),
        "belief/agreement": ("agreement of the images", _GREEN),
    }
    for name in ERROR_CURVES:
        lines |= {f"error/{kind}/{name}": (METHODS[name].label, path_color(name)) for kind in ("position", "rotation")}
    for entity, (name, color) in lines.items():
        stream.log(entity, rr.SeriesLines(names=name, colors=color, widths=1.5), static=True)
    states = rr.StateConfiguration(values=[*_STATUS], colors=[*_STATUS.values()])
    stream.log("status", states, static=True)
    legend = _LEGEND if live else _LEGEND + _LEGEND_AT_END
    if place is None:
        stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    else:
        place.log(stream)
        legend += f"  ·  **grey** {place.what}"
    log_legend(stream, legend)


def log_styles(stream: rr.RecordingStream) -> None:
    """Log colours and sizes of samples, hypotheses and the true pose, of a run or of a single posterior."""
    import rerun as rr

    ui, orange = rr.Radius.ui_points, rgb(COLORS["single_image"])
    for entity, style in {
        "world/posterior": rr.Points3D.from_fields(radii=ui([1.2]), colors=[orange]),
        "world/posterior/cameras": rr.LineStrips3D.from_fields(radii=ui([0.4]), colors=[orange]),
        "world/modes": rr.Ellipsoids3D.from_fields(
            line_radii=ui([1.0]), fill_mode=rr.components.FillMode.MajorWireframe
        ),
        "world/modes/weights": rr.Points3D.from_fields(radii=ui([3.0]), show_labels=True),
        "world/modes/cameras": rr.LineStrips3D.from_fields(radii=ui([1.2])),
        "world/truth": rr.LineStrips3D.from_fields(radii=ui([1.5]), colors=[TRUTH]),
    }.items():
        stream.log(entity, style, static=True)


def log_legend(stream: rr.RecordingStream, legend: str) -> None:
    """Log the meaning of the colours, in Markdown; `with_legend` has a view for it."""
    import rerun as rr

    stream.log("legend", rr.TextDocument(legend, media_type="text/markdown"), static=True)


def run_blueprint(place: Place | None = None, *, live: bool = False) -> rrb.Blueprint:
    """The belief in space, large; beside it the image and the plots. The first view shows all of the place, if known.

    A live view follows the camera, shows five minutes of its path and one of the belief, and plots no errors.
    """
    import rerun.blueprint as rrb

    def last(seconds: int) -> rrb.VisibleTimeRange:
        begin = rrb.TimeRangeBoundary.cursor_relative(seconds=-seconds) if live else rrb.TimeRangeBoundary.infinite()
        return rrb.VisibleTimeRange("time", start=begin, end=rrb.TimeRangeBoundary.cursor_relative())

    paths = {f"world/path/{name}": rrb.VisibleTimeRanges([last(300)]) for name in _PATHS}
    legend = rrb.PlotLegend(rrb.Corner2D.LeftBottom if live else rrb.Corner2D.RightBottom)
    followed = FOLLOWED if live else None
    eye = rrb.EyeControls3D(tracking_entity=followed) if place is None else place.first_view(followed)
    errors = [
        ("error/position", "error of position, log10 of metres (-1: 10 cm, 0: 1 m)"),
        ("error/rotation", "error of rotation, log10 of degrees (0: 1°, 1: 10°)"),
    ]
    error_views = [
        rrb.TimeSeriesView(origin=entity, name=name, plot_legend=rrb.PlotLegend(visible=False))
        for entity, name in errors
        if not live
    ]
    return with_legend(
        space_view("belief", eye, paths),
        [
            rrb.Spatial2DView(origin="world/camera", contents="world/camera", name="image"),
            rrb.TimeSeriesView(
                origin="belief",
                name="belief, from 0 to 1",
                axis_y=rrb.ScalarAxis(range=(0.0, 1.05)),
                plot_legend=legend,
                time_ranges=[last(60)] if live else None,
            ),
            rrb.StateTimelineView(origin="status", name="status", time_ranges=[last(60)] if live else None),
            *error_views,
        ],
        [3.0, 2.0, 1.0, *(2.0 for _ in error_views)],
    )


def space_view(
    name: str, eye: rrb.EyeControls3D | None, overrides: Mapping[str, rrb.VisibleTimeRanges] | None = None
) -> rrb.Spatial3DView:
    """The view in space, seen from an eye, with the visible times of some entities by their paths."""
    import rerun.blueprint as rrb

    return rrb.Spatial3DView(
        origin="world",
        name=name,
        overrides=overrides,  # pyright: ignore[reportArgumentType]
        eye_controls=eye,
        background=_BACKGROUND,
    )


def with_legend(
    space: rrb.View, beside: Sequence[rrb.View], shares: Sequence[float], *, selection: bool = False
) -> rrb.Blueprint:
    """A view in space, large, with the legend below it, and other views beside it, whose heights are `shares`."""
    import rerun.blueprint as rrb

    legend = rrb.TextDocumentView(origin="legend", name="colours")
    views = rrb.Vertical(space, legend, row_shares=[8, 1])
    if beside:
        views = rrb.Horizontal(views, rrb.Vertical(*beside, row_shares=[*shares]), column_shares=[3, 2])
    return rrb.Blueprint(
        views,
        rrb.TimePanel(state="collapsed", timeline="time"),
        rrb.SelectionPanel(state="expanded" if selection else "collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        auto_views=False,
    )
