"""A robot without ROS: images and odometry come by callbacks of your own, map -> odom goes out.

python examples/own_loop.py sequence.mcap --model staircase

A recording stands for the robot here; replace `drive` by your subscriptions.
"""

import argparse
from pathlib import Path

import numpy as np

import vapor


class Robot:
    """What the callbacks do; they may come from any thread, and in any order."""

    def __init__(self, stream: vapor.StreamLocalizer) -> None:
        self.stream, self.sent, self.status = stream, 0, ""

    def on_motion(self, time_ns: int, motion: vapor.Odometry) -> None:
        """Take a motion that ended at a time."""
        self.publish(self.stream.add_increment(time_ns, motion))  # or `add_odometry` of a pose, or `add_velocity`

    def on_image(self, time_ns: int, image: np.ndarray) -> None:
        """Take an RGB image."""
        self.publish(self.stream.add_image(time_ns, image))

    def publish(self, estimates: list[vapor.StreamEstimate]) -> None:
        """Send where the robot is."""
        for now in estimates:
            self.status = now.estimate.status
            self.sent += now.map_from_odom is not None  # only while it is converged: send it here


def drive(recording: vapor.SequenceReader, robot: Robot) -> None:
    for frame in recording:
        robot.on_image(frame.time_ns, frame.image)  # it waits for the motion, which comes later
        if frame.odometry is not None:
            robot.on_motion(frame.time_ns, frame.odometry)
    robot.publish(robot.stream.flush())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequence", type=Path, help="MCAP file or rosbag2 folder")
    parser.add_argument("--model", default="staircase", help="model file, or one that ships: staircase, ceiling")
    options = parser.parse_args()

    recording = vapor.SequenceReader(options.sequence)
    model = vapor.VaporObservationModel.from_checkpoint(options.model, camera=recording.camera)
    localizer = vapor.ParticleLocalizer(model, rng=np.random.default_rng(0))
    robot = Robot(vapor.StreamLocalizer(localizer))  # the motions are the camera's: no `base_from_camera`
    drive(recording, robot)
    print(f"{robot.sent} transforms sent, last status {robot.status}, left out {dict(robot.stream.skipped)}")


if __name__ == "__main__":
    main()
