"""A running system for tests: recordings as scripts of a ROS 2 node, the command `live`, and what nodes heard."""

import os
import pickle
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import pytest

from sequences.recordings.bag import Bag
from sequences.recordings.message_definitions import decoder
from tests.helpers.checkout import CHECKOUT

NODE = CHECKOUT / "tests" / "ros" / "node.py"
IMAGE, ODOMETRY, CAMERA_INFO, TF_STATIC = "/camera/image/compressed", "/odom", "/camera/camera_info", "/tf_static"
ANSWERS = {
    "/estimate/pose": "geometry_msgs/PoseWithCovarianceStamped",
    "/estimate/base_pose": "geometry_msgs/PoseWithCovarianceStamped",
    "/estimate/fixed_lag": "geometry_msgs/PoseWithCovarianceStamped",
    "/estimate/particles": "geometry_msgs/PoseArray",
    "/estimate/modes": "visualization_msgs/MarkerArray",
    "/diagnostics": "diagnostic_msgs/DiagnosticArray",
    "/tf": "tf2_msgs/TFMessage",
}


class Message(NamedTuple):
    """A received message: topic, monotonic time in seconds, fields."""

    topic: str
    at_s: float
    fields: SimpleNamespace


def free_domain() -> int:
    """A ROS domain that no other worker of the tests uses."""
    return 1 + os.getpid() % 100


def ros_python(distribution: str) -> Path:
    """The Python of a distribution's environment; tests skip where it is absent."""
    python = CHECKOUT / ".venv" / f"ros-{distribution}" / "bin" / "python"
    if not (python.parent.parent / ".installed").exists():
        pytest.skip(f"no environment of ROS 2 {distribution}: make .venv/ros-{distribution}/.installed")
    return python


def script_of(recording: Path) -> dict[str, Any]:
    """The script of a node that publishes a recording and listens to everything that `live` publishes."""
    bag = Bag(recording)
    names = [name for name in bag.topics if name != "/ground_truth/pose"]
    raws = sorted(bag.messages(names), key=lambda raw: (raw.topic != TF_STATIC, raw.log_time_ns))
    begin_ns = min(raw.log_time_ns for raw in raws)
    return {
        "publish": [
            {
                "topic": raw.topic,
                "type": raw.type,
                "latched": raw.topic == TF_STATIC,
                "at_s": (raw.log_time_ns - begin_ns) * 1e-9,
                "data": raw.data,
            }
            for raw in raws
        ],
        "listen": dict(ANSWERS),
        "image": IMAGE,
        "needs": [IMAGE, ODOMETRY, CAMERA_INFO, TF_STATIC],
        "gate": "/estimate/pose",
    }


def run_node(python: Path, script: Mapping[str, Any], folder: Path, domain: int, *, timeout_s: float) -> "Received":
    """Run a node by a script, to its end."""
    given, heard = folder / "script.pickle", folder / "heard.pickle"
    given.write_bytes(pickle.dumps(dict(script)))
    clean = {name: value for name, value in os.environ.items() if not name.startswith(("ROS_", "_ROS", "LD_LIBRARY"))}
    env = {**clean, "ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    subprocess.run([python, NODE, given, heard], env=env, check=True, timeout=timeout_s)
    return Received(script, pickle.loads(heard.read_bytes()))


class Received:
    """The messages that a node received."""

    def __init__(self, script: Mapping[str, Any], result: Mapping[str, Any]) -> None:
        types = script["listen"]
        self.messages = [Message(topic, at_s, decoder(types[topic])(data)) for topic, at_s, data in result["heard"]]

    def on(self, topic: str) -> list[Message]:
        return [message for message in self.messages if message.topic == topic]


def stamp(header: SimpleNamespace) -> int:
    return header.stamp.sec * 1_000_000_000 + header.stamp.nanosec


@contextmanager
def live_command(domain: int, *words: str, log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """`vapor-track live` in a process of its own; ended by SIGINT, and checked to end well."""
    command = [sys.executable, "-m", "vapor.track", "live", "--localhost", "--domain", str(domain), *words]
    with log.open("wb") as out:
        # A shell's background children ignore SIGINT, and pytest may be one.
        process = subprocess.Popen(
            ["/usr/bin/env", "--default-signal=INT", *command], stdout=out, stderr=subprocess.STDOUT, cwd=log.parent
        )
        try:
            yield process
            process.send_signal(2)
            assert process.wait(20) == 0, log.read_text()
        finally:
            process.kill()
            process.wait()


def wait_for(text: str, log: Path, *, timeout_s: float = 30.0) -> None:
    end_s = time.monotonic() + timeout_s
    while text not in log.read_text():
        assert time.monotonic() < end_s, f"no {text!r}: {log.read_text()}"
        time.sleep(0.05)
