"""One walk as TUM, EuRoC and KITTI write its poses."""

from pathlib import Path

import numpy as np

from filtering.se3 import Poses
from sequences.frame import Trajectory
from sequences.trajectories.tum import write_tum
from tests.helpers.tf_files import body, stamps

TIMES_NS = np.array(stamps(), np.int64)
TRACK = Trajectory(TIMES_NS, Poses.stack([body(t) for t in stamps()]))


def as_tum(folder: Path) -> Path:
    write_tum(folder / "poses.tum", TRACK)
    return folder / "poses.tum"


def as_euroc(folder: Path) -> Path:
    lines = ["#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], v"]
    for time_ns, p, (x, y, z, w) in zip(TIMES_NS, TRACK.poses.translation, TRACK.poses.as_quat_xyzw(), strict=True):
        lines.append(",".join(map(str, [time_ns, *p, w, x, y, z, 0.5])))
    (folder / "data.csv").write_text("\n".join(lines) + "\n")
    return folder / "data.csv"


def as_kitti(folder: Path) -> Path:
    rows = TRACK.poses.as_matrix()[:, :3].reshape(-1, 12)
    (folder / "00.txt").write_text("\n".join(" ".join(map(str, row)) for row in rows))
    (folder / "times.txt").write_text("\n".join(f"{t // 10**9}.{t % 10**9:09d}" for t in TIMES_NS.tolist()))
    return folder / "00.txt"
