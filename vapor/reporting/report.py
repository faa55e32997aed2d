"""The report of a run: `report.json`, and the table that the command prints."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool

from filtering.estimate import STATUSES, Status
from sequences.atomic import atomic_output
from sequences.errors import SequenceError
from sequences.files import read_json
from vapor.evaluation.consistency import evaluate_consistency
from vapor.evaluation.reliability import Reliability
from vapor.evaluation.storeys import evaluate_storeys
from vapor.evaluation.trajectory import TAIL_M, THRESHOLDS, associate, evaluate_methods, is_right
from vapor.reporting.record import RunRecord
from vapor.tracking.hindsight import LookBack
from vapor.tracking.methods import METHODS, in_order

if TYPE_CHECKING:
    from rich.table import Table

FITS = 0.7
"""Fraction of the images about a smoothed pose that must fit it, as for the filter's to be `converged`."""
HARDLY = 0.05
"""Fraction of the images that are converged, below which it may be another place."""
_MOSTLY_LOST, _SOME_LOST = 0.5, 0.25  # of the images
_LEFT_OUT, _UNFAMILIAR = 0.2, 0.5  # of the images of a camera, from which on a notice says so


def build_report(record: RunRecord) -> dict[str, Any]:
    """The content of `report.json`; the same for the same run but for `step_ms` and `peak_rss_mb`.

    Returns:
        `frames`, `frames_with_true_pose`, `skipped`, `images` (see `ImageCounts`), `duration_s`, `odometry` (what shows
        the motion: `recorded`, `visual`, `both`, or null), `status` (fraction of the images by status),
        `smoothed_doubtful` (number of poses; null without a smoothed trajectory), `hindsight` (see below; null
        without), `particles` (median), `step_ms`, `peak_rss_mb`, with landmarks `verified` (fraction of the images) and
        `inliers` (median number of landmarks in these), and `storeys` (see `evaluate_storeys`; null where there is one
        only). With true poses also each method's metrics (see `evaluate_trajectory`), `consistency` (see
        `evaluate_consistency`), and `reliability` of the weight of the best mode (see `Reliability.as_json`).

        `hindsight`: `ambiguous` (number of smoothed poses), `second_probability` (of the second trajectory's end; 0
        where there is none), `carried_off_s` (when the camera was carried off, seconds since the first image), and with
        true poses `consistency` of the smoothed poses that fit, and `fixed_lag_consistency` with a lag.
    """
    frames = len(record.times_ns)
    p50, p95 = np.percentile(record.step_ms, [50, 95])
    doubts = doubtful(record)
    found = 0 if record.truth is None else int(associate(record.times_ns, record.truth)[0].sum())
    report: dict[str, Any] = {
        "frames": frames,
        "frames_with_true_pose": found,
        "skipped": dict(record.skipped),
        "images": None if record.images is None else record.images.as_json(),
        "duration_s": float(record.times_ns[-1] - record.times_ns[0]) / 1e9,
        "odometry": record.odometry,
        "status": status_parts(record.status),
        "smoothed_doubtful": None if doubts is None else int(doubts.sum()),
        "hindsight": None,
        "particles": int(np.median(record.num_particles)),
        "step_ms": {"p50": float(p50), "p95": float(p95)},
        "peak_rss_mb": record.peak_rss_mb,
        "storeys": None,
    }
    if len(names := dict.fromkeys(record.cameras)) > 1:
        report["cameras"] = {
            name: {
                "images": len(own),
                "left_out": int(record.left_out[own].sum()),
                "out_of_distribution": int((record.ood_score[own] > 1.0).sum()),
            }
            for name in names
            for own in [np.flatnonzero([each == name for each in record.cameras])]
        }
    if record.inliers is not None:
        verified = record.inliers > 0
        report["verified"] = float(verified.mean())
        report["inliers"] = float(np.median(record.inliers[verified])) if verified.any() else None
    if record.storeys is not None and record.storey_belief is not None:
        report["storeys"] = evaluate_storeys(record.storeys, record.storey_belief, record.methods, record.truth)
    if record.truth is not None:
        report |= evaluate_methods(record.methods, record.truth)
        converged = np.array([status == "converged" for status in record.status])
        report["consistency"] = evaluate_consistency(
            record.methods["filter"], record.covariance, record.degrees_of_freedom, converged, record.truth
        )
        with_truth, truth = associate(record.times_ns, record.truth)
        right = is_right(record.methods["filter"].poses[with_truth], truth)
        report["reliability"] = Reliability.of(record.best_weight[with_truth], right).as_json()
    if record.look_back is not None:
        report["hindsight"] = _hindsight(record, record.look_back)
    return _rounded(report)


def _hindsight(record: RunRecord, look_back: LookBack) -> dict[str, Any]:
    second, carried_off = look_back.second, np.flatnonzero(look_back.carried_off)
    part: dict[str, Any] = {
        "ambiguous": int(look_back.ambiguous.sum()),
        "second_probability": 0.0 if second is None else float(second.probability[-1]),
        "carried_off_s": ((record.times_ns[carried_off] - record.times_ns[0]) / 1e9).tolist(),
    }
    if record.truth is not None:
        fits = (look_back.agreement >= FITS) & ~look_back.ambiguous
        for name, trajectory in look_back.trajectories.items():
            key = "consistency" if name == "smoothed" else f"{name}_consistency"
            gaussian = np.full(len(fits), np.inf)  # of many images
            part[key] = evaluate_consistency(record.methods[name], trajectory.covariance, gaussian, fits, record.truth)
    return part


def status_parts(status: Sequence[Status]) -> dict[str, float]:
    """The fraction of the images with each status."""
    counts = Counter(status)
    return {name: counts[name] / len(status) for name in STATUSES}


def is_placed(parts: Mapping[str, float]) -> bool:
    """Whether positions of a run say anything, by its `status_parts`: some are converged, and most are not lost."""
    return parts.get("converged", 0.0) >= HARDLY and not is_mostly_lost(parts)


def is_mostly_lost(parts: Mapping[str, float]) -> bool:
    """Whether most images of a run fit nowhere, by its `status_parts`."""
    return parts.get("lost", 0.0) >= _MOSTLY_LOST


def place_notice(report: Mapping[str, Any]) -> str | None:
    """A doubt whether a run was at the place of its model; None where images are recognised, or many are lost.

    Why images are lost is said by `why_unrecognised`.
    """
    parts = report["status"]
    if (converged := parts["converged"]) >= HARDLY or parts["lost"] > _SOME_LOST:
        return None
    return (
        f"hardly any image says which place it is ({converged:.0%} are converged): does the walk show something unique,"
        " and is it in the place that the model, or the estimator, knows?"
    )


def doubtful(record: RunRecord) -> Bool[np.ndarray, " n"] | None:
    """Which smoothed poses the images about them do not fit, (n,); None without a smoothed trajectory."""
    return None if record.look_back is None else record.look_back.agreement < FITS


def doubtful_notice(record: RunRecord) -> str | None:
    """A warning of doubtful smoothed poses; None where there are none."""
    doubts = doubtful(record)
    if doubts is None or not doubts.any():
        return None
    return f"{doubts.sum()} of {len(doubts)} smoothed poses are doubtful: images about them do not fit (status.csv)"


def camera_notices(report: Mapping[str, Any]) -> list[str]:
    """A warning of each camera among several many of whose images did not count."""
    cameras = report.get("cameras", {})
    unfamiliar = [name for name, each in cameras.items() if each["out_of_distribution"] > _UNFAMILIAR * each["images"]]
    if len(unfamiliar) == len(cameras):  # it is not a camera that is unlike the training
        unfamiliar = []
    return [
        *(
            f"{name}: {cameras[name]['out_of_distribution']} of its {cameras[name]['images']} images are unlike the"
            " training images, those of other cameras are not: is its lens covered, or its camera new to the model?"
            for name in unfamiliar
        ),
        *_left_out(cameras),
    ]


def _left_out(cameras: Mapping[str, Any]) -> list[str]:
    return [
        f"{name}: {each['left_out']} of its {each['images']} images were left out, as they fit nowhere where those of"
        " the other cameras fit: expected its mount (tf), intrinsics and clock to be right, and a clean lens"
        for name, each in cameras.items()
        if each["left_out"] > _LEFT_OUT * each["images"]
    ]


def write_report(path: Path, report: Mapping[str, Any]) -> None:
    """Write a report as JSON, keys sorted; the file appears under its name only when complete."""
    text = json.dumps(_rounded(report), indent=2, sort_keys=True, allow_nan=False) + "\n"
    with atomic_output(path) as partial:
        partial.write_text(text, encoding="utf-8")


def is_report(path: Path, keys: Collection[str]) -> bool:
    """Whether a file is a JSON object with these keys among others."""
    try:
        content = read_json(path)
    except SequenceError:
        return False
    return isinstance(content, dict) and content.keys() >= set(keys)


def method_table(report: Mapping[str, Any], *, large_errors: bool = False) -> tuple[list[str], list[list[str]]]:
    """Headings and rows of a table of a report's methods: median errors, recalls or large errors, and when they are
    right.

    Without true poses there are no rows.
    """
    thresholds = (
        [f"worse than\n{TAIL_M[name]:g}\N{NO-BREAK SPACE}m" for name in TAIL_M] if large_errors else [*THRESHOLDS]
    )
    thresholds = [name.replace("m/", "\N{NO-BREAK SPACE}m\n").replace("deg", "°") for name in thresholds]
    columns = ["", "median error", *thresholds, "right\nfrom"]
    digits = 1 if large_errors else 0
    rows: list[list[str]] = []
    for name, metrics in in_order(report).items():
        converged_at_s = metrics.get("converged_at_s")
        right_from = "" if "success" not in metrics else "no" if converged_at_s is None else f"{converged_at_s:.1f} s"
        rows.append(
            [
                METHODS[name].label,
                f"{metrics['median_translation_m']:.3f} m  {metrics['median_rotation_deg']:5.1f}°",
                *(
                    f"{100 * part:.{digits}f} %"
                    for part in metrics["worse_than" if large_errors else "recall"].values()
                ),
                right_from,
            ]
        )
    return columns, rows


def format_table(report: Mapping[str, Any], *, title: str | None = None, large_errors: bool = False) -> Table:
    """`method_table`, to print."""
    from rich.table import Table

    table = Table(title=title, title_justify="left", caption_justify="left")
    columns, rows = method_table(report, large_errors=large_errors)
    for number, name in enumerate(columns):
        table.add_column(name, justify="right" if number else "left")
    for row in rows:
        table.add_row(*row, style="bold" if row[0] == METHODS["filter"].label else None)
    return table


def _rounded(value: Any) -> Any:
    # Six decimals are finer than any sensor, and coarser than the last bits of a sum.
    if isinstance(value, Mapping):
        return {key: _rounded(item) for key, item in value.items()}
    return round(value, 6) if isinstance(value, float) else value
