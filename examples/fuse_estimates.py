"""Poses of another estimator as hypotheses of the filter, moved by odometry.

python examples/fuse_estimates.py --output fused/

Here the other estimator is simulated: it confuses two identical rooms in a third of its images. Yours
writes the same text: `name qw qx qy qz tx ty tz`, or TUM's `time tx ty tz qx qy qz qw`.
"""

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import vapor

OTHER_ROOM_M = 12.0


def write_tum(path: Path, times_s: np.ndarray, poses: vapor.Poses) -> Path:
    """One line an image: time, position, quaternion."""
    rows = np.column_stack([times_s, poses.translation, poses.as_quat_xyzw()])
    np.savetxt(path, rows, fmt="%.9f")
    return path


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("fused"))
    options = parser.parse_args()
    rng = np.random.default_rng(0)

    times_s = 1000.0 + 0.2 * np.arange(80)
    turn = 0.15 * np.arange(80)
    position = np.stack([1.5 * np.cos(turn), 1.5 * np.sin(turn), 0.02 * np.arange(80)], axis=1)
    rotation = vapor.Poses.exp(np.stack([0 * turn] * 5 + [turn], axis=1)).rotation
    truth = vapor.Poses(rotation, position)
    noisy = truth @ vapor.Poses.exp(rng.normal(0.0, [0.05] * 3 + [0.02] * 3, (80, 6)))
    wrong_room = rng.random((80, 1)) < 0.35
    estimates = vapor.Poses(noisy.rotation, noisy.translation + wrong_room * [OTHER_ROOM_M, 0.0, 0.0])

    with TemporaryDirectory() as folder:
        result = vapor.fuse(
            [write_tum(Path(folder) / "estimates.txt", times_s, estimates)],
            options.output,
            simulate_odometry=write_tum(Path(folder) / "truth.txt", times_s, truth),  # or odometry=FILE, recorded
            overwrite=True,
        )
    for name in ("single_image", "filter", "smoothed"):
        figures = result.report[name]
        print(f"{name:12s} median error {figures['median_translation_m']:.2f} m")


if __name__ == "__main__":
    main()
