"""Publishes what is believed: poses and particles of each image, and between images where the robot is by now."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from filtering.estimate import Estimate
from filtering.floors import Floors
from filtering.se3 import Poses
from sequences.recordings.estimate_messages import PUBLISHED_PARTICLES, Message, estimate_messages
from sequences.recordings.source import RawMessage
from vapor.robot.belief import Anchor, LiveBelief
from vapor.robot.config import LiveConfig
from vapor.robot.messages import diagnostics_message, pose_message, tf_message
from vapor.robot.network import Job
from vapor.robot.outbox import Outbox


class Publisher:
    """Publishes under the names that the settings give.

    Args:
        outbox: Where messages go.
        config: Settings.
        hardware: What diagnostics are about.
        floors: Of the building, for diagnostics; None where there is one only.
        now_ns: The clock that messages are logged by.

    Attributes:
        last_sent: What was published of the last image.
    """

    def __init__(
        self, outbox: Outbox, config: LiveConfig, hardware: str, floors: Floors | None, now_ns: Callable[[], int]
    ) -> None:
        self._outbox, self._config, self._now_ns = outbox, config, now_ns
        self._hardware, self._floors = hardware, floors
        self.last_sent: list[RawMessage] = []
        self._kept_map_from_odom: Poses | None = None
        self._told_anchor: Anchor | None = None  # what the motion that was told last led on from
        self._told_ns = self._told_reading = self._tf_ns = 0  # of its odometry, and of its transform

    def advertise(self) -> None:
        """Be known by one's topics from the beginning."""
        for message in estimate_messages(0, [], Poses.identity(0), under=self._config.under):
            self._outbox.advertise(message.topic, message.type)
        for name in ("pose", "base_pose"):
            self._outbox.advertise(f"{self._config.under}/{name}", "geometry_msgs/PoseWithCovarianceStamped")
        self._outbox.advertise("/diagnostics", "diagnostic_msgs/DiagnosticArray")
        if self._config.tf:
            self._outbox.advertise("/tf", "tf2_msgs/TFMessage")

    def forget(self) -> None:
        """Have the last transform count no longer."""
        self._kept_map_from_odom = None

    def send_belief(self, time_ns: int, estimate: Estimate) -> None:
        """Publish what is believed of a time."""
        modes = [(mode.world_from_camera, mode.covariance, mode.weight) for mode in estimate.modes]
        cloud = estimate.cloud(PUBLISHED_PARTICLES)
        messages = estimate_messages(time_ns, modes, cloud, under=self._config.under, frame=self._config.map_frame)
        self.last_sent = self._send(messages)

    def send_motion(self, belief: LiveBelief, at_network: Job | None) -> None:
        """Publish the pose of the base at the latest odometry, and tf; neither while the estimate is not converged."""
        reader, anchor, now, time_ns = belief.reader, belief.anchor, belief.now, belief.reader.odometry_ns
        if anchor is None or now is None or time_ns is None:
            return
        if self._told_anchor is anchor and self._told_ns == time_ns:
            return
        if now.status == "converged" and anchor.reading == reader.readings:
            map_from_odom = self._kept_map_from_odom = anchor.map_from_odom
        elif self._config.keep_tf:
            map_from_odom = self._kept_map_from_odom
        else:
            return
        odom_from_base = reader.odom_from_base(time_ns)
        if map_from_odom is None or odom_from_base is None:
            return
        frame, messages = self._config.map_frame, list[Message]()
        if now.status == "converged":
            if (covariance := belief.covariance_of_base(anchor, time_ns, at_network)) is None:
                return
            topic = f"{self._config.under}/base_pose"
            messages.append(pose_message(topic, frame, time_ns, map_from_odom @ odom_from_base, covariance))
        if self._config.tf:
            # A transform that was told with its stamp before is refused by those who listen.
            before_ns = self._tf_ns if self._told_reading == reader.readings else 0
            self._tf_ns = max(time_ns + round(self._config.tf_ahead_s * 1e9), before_ns + 1)
            messages.append(tf_message(self._tf_ns, frame, reader.roles.odometry_frame, map_from_odom))
        self._send(messages)
        self._told_anchor, self._told_ns, self._told_reading = anchor, time_ns, reader.readings

    def send_diagnostics(self, estimate: Estimate | None, silent: str | None, values: Mapping[str, object]) -> None:
        """Publish how things are, see `diagnostics_message`."""
        told = diagnostics_message(
            self._now_ns(),
            hardware=self._hardware,
            estimate=estimate,
            silent=silent,
            values=values,
            floors=self._floors,
        )
        self._send([told])

    def _send(self, messages: list[Message]) -> list[RawMessage]:
        return self._outbox.send(messages, self._now_ns())
