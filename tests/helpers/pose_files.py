"""Files of poses: one walk as TUM, EuRoC and KITTI write it, and two sequences as estimators write them."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from filtering.se3 import Poses
from sequences.estimates.sequence import HYPOTHESIS
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


FRAMES = 60  # of each of the two sequences


def walk(seed: int = 0) -> dict[str, Poses]:
    """World_from_camera by frame name: two short curved walks that turn about every axis."""
    rng = np.random.default_rng(seed)
    poses = {}
    for sequence in ("seq-2", "seq-10"):
        start = Poses.exp(rng.normal(scale=0.5, size=6))
        steps = np.arange(FRAMES)[:, None] * np.array([0.02, 0.005, 0.01, 0.004, 0.01, 0.002])
        for number, pose in enumerate(_each(start @ Poses.exp(steps))):
            poses[f"{sequence}/frame-{number:06d}.color.png"] = pose
    return poses


def noisy(poses: Mapping[str, Poses], std_m: float, std_rad: float, seed: int = 0) -> dict[str, Poses]:
    scale = np.repeat([std_m, std_rad], 3)
    rng = np.random.default_rng(seed)
    return {name: pose @ Poses.exp(scale * rng.standard_normal(6)) for name, pose in poses.items()}


def moved(pose: Poses, metres: float) -> Poses:
    return Poses(pose.rotation, pose.translation + np.array([metres, 0.0, 0.0]))


def write_named(path: Path, poses: Mapping[str, Poses], *, world_to_camera: bool, extra: str = " 525.0") -> Path:
    """Write `name qw qx qy qz tx ty tz`, lines shuffled."""
    lines = []
    for name, pose in poses.items():
        written = pose.inverse() if world_to_camera else pose
        x, y, z, w = written.as_quat_xyzw()
        values = " ".join(f"{value:.9f}" for value in (w, x, y, z, *written.translation))
        lines.append(f"{name} {values}{extra}")
    np.random.default_rng(0).shuffle(lines)
    path.write_text("\n".join(lines) + "\n")
    return path


def file_of(path: Path, poses: Mapping[str, Poses]) -> Path:
    """Poses as most estimators write them: of the world in the camera, by name."""
    return write_named(path, poses, world_to_camera=True, extra="")


def hypotheses(*each: tuple[int, float, Poses]) -> np.ndarray:
    """Of one frame: the file of each, its weight, its pose."""
    return np.array([(file, weight, pose.as_matrix()) for file, weight, pose in each], HYPOTHESIS)


def _each(poses: Poses) -> list[Poses]:
    return [poses[i] for i in range(len(poses))]
