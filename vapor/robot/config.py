"""Settings of live localization."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

from filtering.errors import VaporTrackError, require_within
from sequences.recordings.mcap_writer import MAP_FRAME
from vapor.pipeline.config import FilterConfig, ModelConfig, OdometrySource, require_odometry_source


@dataclass(frozen=True)
class LiveConfig(ModelConfig, FilterConfig):
    """Settings of live localization, beside the model and the system.

    Example:
        >>> from pathlib import Path
        >>> import vapor
        >>> config = vapor.LiveConfig(map_frame="building", record=Path("drive-%Y%m%d-%H%M%S.mcap"))
        >>> config.under
        '/estimate'
    """

    odometry: OdometrySource = "auto"
    """auto: use odometry that is published; where there is none ten seconds after all else, make it from the images.
    recorded: wait for published odometry. visual: make it from the images. both: these correct each other. none: each
    hypothesis moves with an unknown velocity."""
    under: str = "/estimate"
    """Prefix of published topics, except /tf and /diagnostics."""
    map_frame: str = MAP_FRAME
    """Name of the frame that the model's poses are in."""
    tf: bool = True
    """Publish tf from the map to the frame of the odometry, while the estimate is converged."""
    tf_ahead_s: float = 0.1
    """How far that transform's stamp is ahead of its odometry, so that a listener need not wait for the next one;
    AMCL's transform_tolerance."""
    keep_tf: bool = False
    """While the estimate is not converged, publish the last transform, rather than none."""
    sim_time: bool = False
    """Take the time from /clock, of a simulation or a recording played back; use_sim_time of ROS nodes."""
    record: Path | None = None
    """Record all subscribed topics (images, odometry, tf, intrinsics, controls) in an MCAP file, which `run` can read.
    Its name may have the time in it: drive-%Y%m%d-%H%M%S.mcap."""
    snapshots: Path = field(default_factory=Path)
    """Folder of snapshots; created if missing."""
    foxglove: bool = False
    """Serve topics to Foxglove, by a WebSocket."""
    foxglove_host: str = "127.0.0.1"
    """Address to serve on; 0.0.0.0 for all of this machine."""
    foxglove_port: int = 8765
    """Port to serve on."""
    view: bool = False
    """Open the Rerun viewer and stream into it."""
    view_at: str | None = None
    """Stream into a Rerun viewer that is open elsewhere, such as rerun+http://192.168.1.5:9876/proxy."""

    def __post_init__(self) -> None:
        ModelConfig.__post_init__(self)
        FilterConfig.__post_init__(self)
        require_odometry_source(self.odometry)
        require_within(self, tf_ahead_s=(0.0, 10.0), foxglove_port=(0, 65535))
        if not re.fullmatch(r"(/[A-Za-z_]\w*)+", self.under):
            raise VaporTrackError(f"under is {self.under!r}, expected a prefix of topics, such as /estimate")
        if not self.map_frame.strip("/"):
            raise VaporTrackError("map_frame is empty, expected the name of a frame")
