"""Files that a run writes at its end."""

from __future__ import annotations

import json
import platform
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sequences.atomic import atomic_output
from sequences.frame import Trajectory
from sequences.trajectories.tum import write_tum
from vapor.reporting.calibration import too_sure_notices
from vapor.reporting.html.page import write_page
from vapor.reporting.html.run_page import run_page
from vapor.reporting.record import RunRecord
from vapor.reporting.report import build_report, camera_notices, doubtful_notice, place_notice, write_report
from vapor.reporting.status_file import write_status
from vapor.tracking.methods import FILES
from vapor.versions import version_of

_PACKAGES = ("vapor-track", "torch", "numpy", "scipy", "filterpy", "gtsam", "opencv-python-headless", "rerun-sdk")
RESULTS = frozenset(
    {
        *FILES.values(),
        *("smoothed_second.tum", "ground_truth.tum", "status.csv", "modes.csv", "config.json"),
        *("estimate.mcap", "recording.rrd"),
        *("report.html", "report.json"),
    }
)
"""Names of all files that a run may write."""


@dataclass(frozen=True)
class RunResult:
    """The result of a run: everything collected on the way, the content of `report.json`, warnings and hints.

    `engine` has engine, device and precision of the network; empty without one. `motion` says what stands in for
    recorded odometry; empty where that is used.
    """

    record: RunRecord
    report: dict[str, Any]
    notices: tuple[str, ...] = ()
    engine: str = ""
    motion: str = ""

    @property
    def few_images(self) -> str | None:
        """A sentence where fewer than half of the images were used."""
        return None if self.record.images is None else self.record.images.warning


def write_results(
    record: RunRecord,
    directory: Path,
    settings: dict[str, Any],
    *,
    title: str,
    notices: Sequence[str] = (),
    command: str = "",
) -> RunResult:
    """Write trajectories, `config.json` (settings, and versions of packages), and the report of a run."""
    for name, trajectory in record.methods.items():
        write_tum(directory / FILES[name], trajectory)
    if record.look_back is not None and (second := record.look_back.second) is not None:
        write_tum(directory / "smoothed_second.tum", Trajectory(record.times_ns, second.poses))
    if record.truth is not None:
        write_tum(directory / "ground_truth.tum", record.truth)
    write_status(directory / "status.csv", record)
    versions = {"python": platform.python_version()} | {name: version_of(name) for name in _PACKAGES}
    settings = settings | {"versions": versions}
    with atomic_output(directory / "config.json") as partial:
        partial.write_text(json.dumps(settings, indent=2) + "\n", encoding="utf-8")
    report = build_report(record)
    about_poses = [*camera_notices(report), *filter(None, [doubtful_notice(record)]), *too_sure_notices(report)]
    all_notices = (*filter(None, [place_notice(report)]), *notices, *about_poses)
    report["notices"] = [*all_notices]
    write_report(directory / "report.json", report)
    result = RunResult(record, report, all_notices)
    on_page = [*filter(None, [result.few_images]), *all_notices]
    page = run_page(record, report, title=title, settings=settings, notices=on_page, command=command)
    write_page(directory / "report.html", page)
    return result
