"""A robot without ROS: images and odometry come by a transport of your own, map -> odom goes out.

python examples/own_loop.py sequence.mcap --model staircase

A recording stands for the robot here; replace `images_of`.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import vapor


def images_of(robot: vapor.SequenceReader) -> Iterator[tuple[int, np.ndarray, vapor.Odometry | None]]:
    """Stamp, RGB image, and the camera's motion since the last image: None where unknown."""
    for frame in robot:
        yield frame.time_ns, frame.image, frame.odometry


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequence", type=Path, help="MCAP file or rosbag2 folder")
    parser.add_argument("--model", default="staircase", help="model file, or one that ships: staircase, ceiling")
    options = parser.parse_args()

    robot = vapor.SequenceReader(options.sequence)
    model = vapor.VaporObservationModel.from_checkpoint(options.model, camera=robot.camera)
    localizer = vapor.ParticleLocalizer(model, rng=np.random.default_rng(0))
    odom_from_camera = vapor.Poses.identity()  # a robot's odometry has it; here motions are composed
    sent = 0
    for time_ns, image, motion in images_of(robot):
        estimate = localizer.step(image, motion, time_ns=time_ns)
        if motion is not None:
            odom_from_camera = odom_from_camera @ motion.previous_from_current
        if estimate.status == "converged":  # otherwise send nothing
            map_from_odom = estimate.modes[0].world_from_camera @ odom_from_camera.inverse()
            sent += np.isfinite(map_from_odom.translation).all()
    print(f"{sent} transforms sent, last status {estimate.status}")


if __name__ == "__main__":
    main()
