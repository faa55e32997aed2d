"""How a run is laid out in Rerun: panels, axes, colours, sizes, names of plotted lines."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float64, UInt8

from vapor.reporting.colors import COLORS

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

_GREEN, _PURPLE = (0, 158, 115), (204, 121, 167)  # of plotted lines


def log_styles(stream: rr.RecordingStream) -> None:
    """What never changes: axes, colours, sizes, names of the plotted lines."""
    import rerun as rr

    stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    stream.log("world/particles", rr.Points3D.from_fields(radii=[0.03]), static=True)
    stream.log(
        "world/posterior", rr.Points3D.from_fields(radii=[0.015], colors=[(*rgb("single_image"), 90)]), static=True
    )
    thin_lines = rr.LineStrips3D.from_fields(radii=[0.004], colors=[(*rgb("single_image"), 90)])
    stream.log("world/posterior/cameras", thin_lines, static=True)
    stream.log("world/truth", rr.Arrows3D.from_fields(radii=[0.03], colors=[(255, 255, 255)]), static=True)
    for name, color, radius in (("filter", rgb("filter"), 0.02), ("truth", (220, 220, 220), 0.008)):
        stream.log(f"world/path/{name}", rr.LineStrips3D.from_fields(radii=[radius], colors=[color]), static=True)
    for entity, name, color in (
        ("belief/best_weight", "weight of the best hypothesis", rgb("filter")),
        ("belief/agreement", "agreement of the images", _GREEN),
        ("belief/status", "0 lost · ½ ambiguous · 1 converged", _PURPLE),
        ("error/translation_m", "translation error [m]", rgb("filter")),
        ("error/rotation_deg", "rotation error [°]", rgb("filter")),
    ):
        stream.log(entity, rr.SeriesLines(names=name, colors=color, widths=1.5), static=True)


def blueprint(*, live: bool = False) -> rrb.Blueprint:
    """The belief in space, large; beside it the image and the plots.

    Args:
        live: For what goes on without an end, and without true poses: the view follows the camera, shows five minutes
            of its path and one of the belief, and plots no errors.
    """
    import rerun.blueprint as rrb

    def last(seconds: int) -> rrb.VisibleTimeRange:
        begin = rrb.TimeRangeBoundary.cursor_relative(seconds=-seconds) if live else rrb.TimeRangeBoundary.infinite()
        return rrb.VisibleTimeRange("time", start=begin, end=rrb.TimeRangeBoundary.cursor_relative())

    paths = {f"world/path/{name}": rrb.VisibleTimeRanges([last(300)]) for name in ("filter", "truth")}
    corner = rrb.Corner2D.LeftBottom if live else rrb.Corner2D.RightBottom
    legend, none = rrb.PlotLegend(corner), rrb.PlotLegend(visible=False)
    following = rrb.EyeControls3D(tracking_entity="world/camera") if live else None
    plots = [("error/translation_m", "translation error [m]"), ("error/rotation_deg", "rotation error [°]")]
    error_views = [rrb.TimeSeriesView(origin=entity, name=name, plot_legend=none) for entity, name in plots if not live]
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Spatial3DView(
                origin="world",
                name="belief",
                overrides=paths,  # pyright: ignore[reportArgumentType]
                eye_controls=following,
            ),
            rrb.Vertical(
                rrb.Spatial2DView(origin="world/camera", contents="world/camera", name="image"),
                rrb.TimeSeriesView(
                    origin="belief",
                    name="belief",
                    axis_y=rrb.ScalarAxis(range=(0.0, 1.05)),
                    plot_legend=legend,
                    time_ranges=[last(60)] if live else None,
                ),
                *error_views,
                row_shares=[3, 2, *(2 for _ in error_views)],
            ),
            column_shares=[3, 2],
        ),
        rrb.TimePanel(state="collapsed", timeline="time"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        auto_views=False,
    )


def weight_colors(weights: Float64[np.ndarray, " n"]) -> UInt8[np.ndarray, "n 3"]:
    """Blue for a hypothesis that holds the whole belief, vermilion for one that holds none."""
    none, all_ = np.array(rgb("other")), np.array(rgb("filter"))
    part = np.clip(weights, 0.0, 1.0)[:, None]
    return np.round(none + part * (all_ - none)).astype(np.uint8)


def rgb(name: str) -> tuple[int, int, int]:
    """A colour of `COLORS`, each part from 0 to 255."""
    code = COLORS[name]
    return int(code[1:3], 16), int(code[3:5], 16), int(code[5:7], 16)
