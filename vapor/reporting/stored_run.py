"""The results of a run, read again from their directory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Shaped

from filtering.errors import VaporTrackError
from sequences.errors import SequenceError
from sequences.files import read_json
from sequences.frame import Trajectory
from sequences.outputs import verify
from sequences.trajectories.tum import read_tum
from vapor.evaluation.trajectory import pose_errors
from vapor.reporting.modes_file import read_mode_trajectories
from vapor.reporting.status_file import read_status
from vapor.tracking.methods import FILES
from vapor.tracking.mode_trajectories import ModeTrajectory

if TYPE_CHECKING:
    from pandas import DataFrame

TRAJECTORIES: Mapping[str, str] = {**FILES, "smoothed_second": "smoothed_second.tum", "truth": "ground_truth.tum"}
"""The file of each trajectory of a run, by its name."""
_STATUS, _REPORT, _MODES = "status.csv", "report.json", "modes.csv"
_POSE = ("tx", "ty", "tz", "qx", "qy", "qz", "qw")


@dataclass(frozen=True)
class StoredRun:
    """The results of a run of n images.

    Attributes:
        directory: Where they are.
        trajectories: By the name of the tracking method: `filter`, `smoothed`, `single_image` and others, as far as the
            run has them; `smoothed_second`, and `truth` where true poses are known.
        status: How good the filter's pose of each image is: the columns of `status.csv` by name, (n,) each, with
            `time_ns`; numbers that are not known are NaN.
        report: The content of `report.json`.

    Example:
        >>> import vapor
        >>> stored = vapor.read_run("result/")
        >>> table = stored.table()
        >>> medians = table.groupby("status")["filter.error_m"].median()
        >>> medians["converged"] < 0.2
        np.True_
        >>> axes = vapor.plot_trajectories(stored.trajectories)
    """

    directory: Path
    trajectories: Mapping[str, Trajectory]
    status: Mapping[str, Shaped[np.ndarray, " n"]]
    report: Mapping[str, Any]

    def modes(self) -> dict[int, ModeTrajectory]:
        """The trajectory of each mode, by its identity.

        Raises:
            SequenceError: `modes.csv` is missing or damaged.
        """
        return read_mode_trajectories(self.directory / _MODES)

    def table(self) -> DataFrame:
        """Everything by image, a row each, as a pandas table whose index is `time_ns`.

        Columns: `time_s` since the first image; those of `status`; and of each trajectory `filter.tx` to `filter.qw`,
        as in its file, world_from_camera. Where true poses are known also `filter.error_m` and `filter.error_deg`. NaN
        where a trajectory has no pose.

        Raises:
            VaporTrackError: pandas is not installed.
        """
        try:
            import pandas
        except ImportError as error:
            raise VaporTrackError(
                "pandas is not installed, expected it for tables: pip install 'vapor-track[pandas]'"
            ) from error
        times_ns = self.status["time_ns"]
        index = pandas.Index(times_ns, name="time_ns")
        others = {name: column for name, column in self.status.items() if name != "time_ns"}
        table = pandas.DataFrame({"time_s": (times_ns - times_ns[:1]) * 1e-9, **others}, index=index)
        truth = self.trajectories.get("truth")
        parts = [table]
        for name, trajectory in self.trajectories.items():
            poses = np.concatenate([trajectory.poses.translation, trajectory.poses.as_quat_xyzw()], axis=1)
            columns = [f"{name}.{column}" for column in _POSE]
            parts.append(pandas.DataFrame(poses, trajectory.times_ns, columns))
            if truth is not None and name != "truth":
                known_ns, metres, degrees = pose_errors(trajectory, truth)
                errors = {f"{name}.error_m": metres, f"{name}.error_deg": degrees}
                parts.append(pandas.DataFrame(errors, known_ns))
        return pandas.concat([part.reindex(index) for part in parts], axis=1)


def read_run(directory: Path | str) -> StoredRun:
    """Read the results of `run` or `fuse` from their directory; files that changed since are an error.

    Raises:
        SequenceError: it is no such directory, or a file is missing, damaged or changed.

    Example:
        >>> import vapor
        >>> stored = vapor.read_run("result/")
        >>> stored.trajectories["filter"].poses.translation.shape
        (20, 3)
        >>> stored.table()[["status", "filter.tx", "filter.error_m"]].shape
        (20, 3)
    """
    directory = Path(directory)
    if not (directory / _STATUS).is_file() or not (directory / _REPORT).is_file():
        raise SequenceError(f"{directory}: no {_STATUS} and {_REPORT}, expected the results of `run` or `fuse`")
    verify(directory, [_STATUS, _REPORT, _MODES, *TRAJECTORIES.values()])
    found = {name: file for name, file in TRAJECTORIES.items() if (directory / file).is_file()}
    return StoredRun(
        directory,
        {name: read_tum(directory / file) for name, file in found.items()},
        read_status(directory / _STATUS),
        read_json(directory / _REPORT),
    )
