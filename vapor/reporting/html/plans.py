"""Plans of a place from above: one, or one of each storey."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float64, Int64

from filtering.storeys import Storeys
from vapor.reporting.html.page import Block
from vapor.reporting.outline import Outline

_SIDE = 1000  # of the longer side of a plan, in its own units
_TAIL, _MARGIN = 0.01, 0.04  # of the points, outside of a plan; of its longer side, around it
_ROUND, _FOOT = 20, 60  # around a plan for what is drawn on its edge, and below it for the scale, in its own units


@dataclass(frozen=True)
class Plans:
    """How positions in the map become points on plans.

    Attributes:
        outline: The place, drawn on each of them.
        storeys: One plan of each; None for one of all.
        up: Axis of the map, there or back.
        low_m: Upper left corner on the plans' axes, metres.
        size_m: Width and height.
    """

    outline: Outline
    storeys: Storeys | None
    up: Float64[np.ndarray, "3"]
    low_m: Float64[np.ndarray, "2"]
    size_m: Float64[np.ndarray, "2"]

    @staticmethod
    def of(
        outline: Outline,
        positions: Float64[np.ndarray, "n 3"],
        storeys: Storeys | None,
        up: Float64[np.ndarray, "3"],
    ) -> Plans:
        """Plans of the storeys that positions (metres) are on, of all without positions.

        They hold all positions, and the outline of these storeys but for its most distant points.
        """
        up = up if storeys is None else np.array(storeys.up)
        shown = _on_storeys_of(outline.points.astype(float), positions, storeys)
        points, inside = shown @ _axes(up), positions @ _axes(up)
        low, high = np.quantile(points, [_TAIL, 1.0 - _TAIL], axis=0)
        low, high = np.min([low, *inside], axis=0), np.max([high, *inside], axis=0)
        margin = max(_MARGIN * float((high - low).max()), 1e-3)
        return Plans(outline, storeys, up, low - margin, high - low + 2.0 * margin)

    def on_plan(self, positions: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 2"]:
        """Positions on the plans' axes, x to the right and y down, metres."""
        return positions @ _axes(self.up)

    def in_map(self, on_plan: Float64[np.ndarray, "2"]) -> Float64[np.ndarray, "3"]:
        """The position in the map of a point on the plans' axes, at height 0, metres."""
        return _axes(self.up) @ on_plan

    def storey(self, positions: Float64[np.ndarray, "n 3"]) -> Int64[np.ndarray, " n"]:
        """The number of the plan that each position is on."""
        return _storey(positions, self.storeys)

    def shows(self, positions: Float64[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Whether each position is within the plans' edges."""
        at = self.on_plan(positions) - self.low_m
        return np.all((at >= 0.0) & (at <= self.size_m), axis=1)

    def drawn(self, positions: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 2"]:
        """Positions in the units of the drawing."""
        return (self.on_plan(positions) - self.low_m) * self.scale

    @property
    def scale(self) -> float:
        """Units of the drawing a metre."""
        return _SIDE / float(self.size_m.max())

    def name(self, number: int) -> str:
        """Of the storey of a plan; empty where there is one only."""
        return "" if self.storeys is None else f"storey {number}, {self.storeys.heights_m[number]:.1f} m"

    def block(
        self,
        marks: Mapping[int, str],
        key: Sequence[tuple[str, str]],
        shown: str,
        role: Literal["img", "group"] = "img",
    ) -> Block:
        """The plans.

        Args:
            marks: What is drawn on top of the outline, as SVG, by the number of the plan.
            key: Kinds of marks, which are classes of the style sheet, in words.
            shown: What is marked, for a screen reader.
            role: "group" where marks are links.
        """
        points, width, height = self.outline.points.astype(float), *self.scale * self.size_m
        on_storey, bar_m = self.storey(points), _round_length(float(self.size_m.max()) / 5.0)
        view = f"{-_ROUND} {-_ROUND} {width + 2 * _ROUND:.0f} {height + _ROUND + _FOOT:.0f}"
        plans = []
        for number, drawn in sorted(marks.items()):
            outline = dots(self.drawn(points[(on_storey == number) & self.shows(points)]))
            bar = f"M{_SIDE * _MARGIN:.0f} {height + _ROUND:.0f}v20m0 -10h{bar_m * self.scale:.0f}m0 -10v20"
            label = f"{shown} and {self.outline.what} from above, {self.name(number)}".rstrip(", ")
            caption = f"<figcaption>{self.name(number)}</figcaption>" if self.name(number) else ""
            plans.append(
                f'<figure><svg class="plan" viewBox="{view}" role="{role}"'
                f' aria-label="{escape(label)}">{line("points", outline)}{drawn}{line("bar", bar)}</svg>{caption}'
                "</figure>"
            )
        kinds = [("points", self.outline.what), *key]
        words = "".join(f'<span><i class="{kind}"></i>{escape(word)}</span>' for kind, word in kinds)
        return Block(
            f'<div class="plans">{"".join(plans)}</div><p class="note key">{words}<span><i class="bar"></i>{bar_m:g} m'
            "</span></p>"
        )


def line(kind: str, d: str) -> str:
    """A line of an SVG of a class of the style sheet, from its commands; empty without any."""
    return f'<path class="{kind}" d="{d}"/>' if d else ""


def dots(points: Float64[np.ndarray, "n 2"]) -> str:
    """Points as the commands of a line with round ends."""
    return "".join(f"M{x} {y}h0" for x, y in points.round().astype(int).tolist())


def _storey(positions: Float64[np.ndarray, "n 3"], storeys: Storeys | None) -> Int64[np.ndarray, " n"]:
    if storeys is None:
        return np.zeros(len(positions), np.int64)
    return np.searchsorted(storeys.cuts_m, positions @ np.array(storeys.up)).astype(np.int64)


def _on_storeys_of(
    points: Float64[np.ndarray, "p 3"], positions: Float64[np.ndarray, "n 3"], storeys: Storeys | None
) -> Float64[np.ndarray, "q 3"]:
    """The points on storeys of positions; all points where there are none."""
    there = points[np.isin(_storey(points, storeys), _storey(positions, storeys))]
    return there if len(there) else points


def _axes(up: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3 2"]:
    right = np.eye(3)[int(np.argmin(np.abs(up)))]
    return np.stack([right, -np.cross(up, right)], axis=1)  # x to the right, y down


def _round_length(length_m: float) -> float:
    """The largest of 1, 2, 5, 10, ... metres, or of fractions of these, that is no longer."""
    power = 10.0 ** np.floor(np.log10(length_m))
    return float(power * max(part for part in (1.0, 2.0, 5.0) if part * power <= length_m * (1.0 + 1e-9)))
