"""Options: how to read files of estimates."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from filtering.motion import MotionNoise
from sequences.errors import SequenceError
from sequences.estimates.pose_files import Direction
from sequences.frame import ASSUMED_HZ
from sequences.odometry import OdometryNoise
from sequences.trajectories.pose_lines import require_columns

_MAX_OFFSET_S = 1e10  # between two clocks, one of which began in 1970


@dataclass(frozen=True)
class EstimateOptions:
    """How to read estimates."""

    direction: Direction | None = None
    """Which way the poses of named frames map, in all files. TUM trajectories are camera-to-world."""
    columns: str | None = None
    """Names of the columns of the files of estimates, as one word in quotation marks, such as "name qw qx qy qz tx ty
    tz _ _ weight": time in place of name for stamps in seconds, _ for ignored columns. With a weight, such as the
    number of inliers, a frame may have several lines, which are its hypotheses. Default: as above."""
    odometry_columns: str | None = None
    """Names of the columns of odometry, or of the true poses that it is simulated from, independent of --columns.
    Default: names, TUM text, or EuRoC's data.csv."""
    ground_truth_columns: str | None = None
    """Names of the columns of the true poses to compare with, likewise."""
    time_offset_s: float | Literal["auto"] = 0.0
    """Seconds to add to the stamps of estimates; auto finds them, file by file, by comparing their rotation with
    odometry's."""
    rate_hz: float = float(ASSUMED_HZ)
    """Named frames have no stamps: how many there are in a second."""
    noise: OdometryNoise = field(default_factory=OdometryNoise)
    """Of simulated odometry."""
    motion_noise: MotionNoise = field(default_factory=MotionNoise)
    """Of recorded odometry, whose text states none."""
    allow_few_images: bool = False
    """Localize also where odometry covers fewer than one in ten of the estimated frames."""

    def __post_init__(self) -> None:
        for name in ("columns", "odometry_columns", "ground_truth_columns"):
            require_columns(f"--{name.replace('_', '-')}", getattr(self, name))
        if self.time_offset_s != "auto" and not abs(self.time_offset_s) <= _MAX_OFFSET_S:
            raise SequenceError(f"time_offset_s is {self.time_offset_s}, expected at most {_MAX_OFFSET_S:g} or auto")
        if not 1e-3 <= self.rate_hz <= 1e6:
            raise SequenceError(f"rate_hz is {self.rate_hz}, expected between 0.001 and 1e6")
