"""Whether the stated uncertainty of the filter, and of poses in hindsight, was true: a table and what to say of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from vapor.evaluation.consistency import REGIONS
from vapor.tracking.methods import METHODS, in_order

if TYPE_CHECKING:
    from rich.table import Table

LEAST_IMAGES = 50
"""Images that a statement on the calibration needs."""
_TOO_SURE = 0.2  # by which a region may hold less than stated
_WRONG = 0.05  # of the converged images
_USUAL_NEES = "5.35"  # its median for true Gaussian covariances


def consistencies(report: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """`evaluate_consistency` of the filter and of poses in hindsight, by the name of the method; none without truth."""
    back = report.get("hindsight") or {}
    found = {
        "filter": report.get("consistency"),
        "smoothed": back.get("consistency"),
        "fixed_lag": back.get("fixed_lag_consistency"),
    }
    return in_order({name: each for name, each in found.items() if each is not None})


def calibration_table(report: Mapping[str, Any]) -> tuple[list[str], list[list[str]]]:
    """Headings and rows of a table: for each method the fraction of true poses in its regions, and what is expected.

    A method with fewer than `LEAST_IMAGES` has their number alone; where all have, there are no rows.
    """
    columns = ["", "images", *(f"{100 * part:g}\N{NO-BREAK SPACE}%\nregion" for part in REGIONS.values())]
    columns += ["median\nNEES", "wrong"]
    rows: list[list[str]] = []
    checked = _checked(report)
    if not checked:
        return columns, rows
    for name, each in consistencies(report).items():
        row = [METHODS[name].label, str(each["images"])]
        if name in checked:
            row += [f"{100 * each['coverage'][region]:.1f} %" for region in REGIONS]
            row += [f"{each['median_nees']:.2f}", f"{100 * each['wrong']:.1f} %"]
        rows.append(row + [""] * (len(columns) - len(row)))
    return columns, [*rows, ["expected", "", *(f"{100 * part:g} %" for part in REGIONS.values()), _USUAL_NEES, "0 %"]]


def format_calibration(report: Mapping[str, Any]) -> Table | None:
    """`calibration_table`, to print; None without rows."""
    from rich.table import Table

    columns, rows = calibration_table(report)
    if not rows:
        return None
    table = Table(title="true poses in the stated regions", title_justify="left")
    for number, name in enumerate(columns):
        table.add_column(name, justify="right" if number else "left")
    for row in rows:
        table.add_row(*row, style="bold" if row[0] == METHODS["filter"].label else None)
    return table


def _checked(report: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    return {name: each for name, each in consistencies(report).items() if each["images"] >= LEAST_IMAGES}


def too_sure_notices(report: Mapping[str, Any]) -> list[str]:
    """A warning of each trajectory whose stated errors are too small for a recording, by its true poses."""
    checked = _checked(report)
    held = {name: each["coverage"]["90%"] for name, each in checked.items()}
    low = [name for name, part in held.items() if part < REGIONS["90%"] - _TOO_SURE]
    notices = []
    if "filter" in checked and ("filter" in low or checked["filter"]["wrong"] > _WRONG):
        notices.append(
            f"the 90 % regions hold {100 * held['filter']:.0f} % of the true poses, and"
            f" {100 * checked['filter']['wrong']:.0f} % of the converged images are wrong: the stated errors are too"
            " small for this recording; calibrate with one of such conditions"
        )
    for name in (each for each in low if each != "filter"):
        sound = "filter" in held and "filter" not in low
        beside = f", those of the filter {100 * held['filter']:.0f} %" if sound else ""
        instead = "; take the filter's where the uncertainty counts" if sound else ""
        notices.append(
            f"the 90 % regions of {METHODS[name].label} poses hold {100 * held[name]:.0f} % of the true poses{beside}:"
            f" they err by more than they state{instead}"
        )
    return notices
