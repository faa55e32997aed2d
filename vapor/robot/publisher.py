"""ROS messages of live localization, and how they are published."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float64

from filtering.errors import VaporTrackError
from filtering.estimate import Estimate, Status
from filtering.se3 import Poses
from filtering.storeys import Storeys
from sequences.live.transport import Transport
from sequences.recordings.estimate_messages import Message, estimate_messages, pose_with_covariance
from sequences.recordings.mcap_writer import ros_header, ros_poses, ros_transform
from sequences.recordings.message_definitions import encoder
from sequences.recordings.messages import covariance_from_ros, pose_from_message
from sequences.recordings.source import RawMessage
from vapor.robot.belief import Anchor, LiveBelief
from vapor.robot.config import LiveConfig
from vapor.robot.network import Job
from vapor.robot.viewers import FoxgloveServer

_OK, _WARN, _ERROR, _STALE = 0, 1, 2, 3
_LEAST_M, _LEAST_RAD = 0.02, 0.02  # nobody points more exactly
_LEVEL_RAD = 0.1  # of a robot on a storey that is not quite even
_OF_PRIOR_M = 0.5
_MOST_VARIANCE = 1e8
_LEVELS: Mapping[Status, int] = {"converged": _OK, "ambiguous": _WARN, "lost": _ERROR}


def pose_message(topic: str, frame: str, time_ns: int, pose: Poses, covariance: Float64[np.ndarray, "6 6"]) -> Message:
    """geometry_msgs/PoseWithCovarianceStamped of one pose, and its covariance in the tangent at it."""
    fields = {"header": ros_header(time_ns, frame), "pose": pose_with_covariance(pose, covariance)}
    return Message(topic, "geometry_msgs/PoseWithCovarianceStamped", fields)


def tf_message(time_ns: int, parent: str, child: str, parent_from_child: Poses) -> Message:
    """tf2_msgs/TFMessage of one pose."""
    transform = ros_transform(time_ns, parent, child, ros_poses(parent_from_child))
    return Message("/tf", "tf2_msgs/TFMessage", {"transforms": [transform]})


def diagnostics_message(
    time_ns: int,
    *,
    hardware: str,
    estimate: Estimate | None,
    silent: str | None,
    values: Mapping[str, object],
    storeys: Storeys | None = None,
) -> Message:
    """diagnostic_msgs/DiagnosticArray: level OK if converged, WARN if ambiguous, ERROR if lost, STALE at first.

    `silent` names the missing input; `values` are added. With `storeys`, the belief's storey and its weight on each are
    added, too.
    """
    if estimate is None:
        level, text, about = _STALE, silent or "no image was localized yet", {}
    else:
        best = estimate.modes[0]
        level = _LEVELS[estimate.status] if silent is None else max(_LEVELS[estimate.status], _WARN)
        text = estimate.status if silent is None else f"{estimate.status}; {silent}"
        about: dict[str, Any] = {
            "status": estimate.status,
            "weight of the best mode": f"{best.weight:.4f}",
            "modes": len(estimate.modes),
            "standard deviation, m": f"{best.widest_std_m:.4f}",
            "at none of the modes": f"{estimate.unassigned:.4f}",
            "log likelihood of the image": f"{estimate.log_likelihood:.4f}",
            "agreement of the images": f"{estimate.agreement:.4f}",
            "OOD score of the image": f"{estimate.ood_score:.4f}",
        }
        if storeys is not None:
            on_storeys = storeys.belief(estimate)
            about["storey"] = int(on_storeys.argmax())
            about |= {f"weight of storey {number}": f"{weight:.4f}" for number, weight in enumerate(on_storeys)}
    status = {
        "level": level,
        "name": "vapor-track: localization",
        "message": text,
        "hardware_id": hardware,
        "values": [{"key": key, "value": str(value)} for key, value in {**about, **values}.items()],
    }
    fields = {"header": ros_header(time_ns, ""), "status": [status]}
    return Message("/diagnostics", "diagnostic_msgs/DiagnosticArray", fields)


def camera_of_initial_pose(
    message: Any, base_from_camera: Poses, prior_poses: Poses
) -> tuple[Poses, Float64[np.ndarray, "6 6"]]:
    """Pose of the camera, one pose, and its covariance in its tangent, from geometry_msgs/PoseWithCovarianceStamped.

    RViz's "2D Pose Estimate" gives x, y and the heading, and variances of zero for height, roll and pitch. Then the
    height is that of the training images (`prior_poses`), and the robot is level.

    Raises:
        VaporTrackError: an unusable pose or covariance.
    """
    base = pose_from_message(message.pose.pose)
    stated = np.array(message.pose.covariance, np.float64).reshape(6, 6)
    if not (np.abs(stated) <= _MOST_VARIANCE).all():  # NaN compares as false
        raise VaporTrackError(
            f"covariance is not finite or above {_MOST_VARIANCE:g}, expected one of metres and radians"
        )
    stated = (stated + stated.T) / 2
    if (lowest := float(np.linalg.eigvalsh(stated)[0])) < -1e-9 * np.abs(stated).max():
        raise VaporTrackError(f"covariance has the negative eigenvalue {lowest:.3g}")
    least = np.array([_LEAST_M, _LEAST_M, _LEAST_M, _LEVEL_RAD, _LEVEL_RAD, _LEAST_RAD])
    if stated[2, 2] == 0.0:
        heights_m = (prior_poses @ base_from_camera.inverse()).translation[:, 2]
        base = Poses(base.rotation, np.array([*base.translation[:2], float(heights_m.mean())]))
        least[2] = max(float(heights_m.std()), _OF_PRIOR_M)
    diagonal = np.arange(6)
    storey = np.where(stated[diagonal, diagonal] == 0.0, least, [_LEAST_M] * 3 + [_LEAST_RAD] * 3)
    stated[diagonal, diagonal] += storey**2  # which makes any covariance definite
    carry = base_from_camera.inverse().adjoint()
    covariance = carry @ covariance_from_ros(stated, base) @ carry.T
    return base @ base_from_camera, (covariance + covariance.T) / 2


class Publisher:
    """Publishes estimates, poses, tf and diagnostics in a transport, and serves them to Foxglove.

    `now_ns` is the clock of logged messages. `notify` is called once, where a message cannot be published. `last_sent`
    has the messages of the last image.
    """

    def __init__(
        self,
        transport: Transport,
        foxglove: FoxgloveServer | None,
        config: LiveConfig,
        *,
        hardware: str,
        storeys: Storeys | None,
        now_ns: Callable[[], int],
        notify: Callable[[str], None],
    ) -> None:
        self._foxglove, self._config, self._now_ns = foxglove, config, now_ns
        self._notify, self._failed = notify, False
        self._hardware, self._storeys = hardware, storeys
        self.last_sent: list[RawMessage] = []
        self._kept_map_from_odom: Poses | None = None
        self._sent_anchor: Anchor | None = None  # of the last pose of the base
        self._sent_ns = self._sent_reading = self._tf_ns = 0  # of its odometry, and of its transform
        topics = {
            each.topic: each.type for each in estimate_messages(0, [], Poses.identity(0), under=self._config.under)
        }
        for name in ("pose", "base_pose", *(("fixed_lag",) if self._config.lag > 0.0 else ())):
            topics[f"{self._config.under}/{name}"] = "geometry_msgs/PoseWithCovarianceStamped"
        topics["/diagnostics"] = "diagnostic_msgs/DiagnosticArray"
        if self._config.tf:
            topics["/tf"] = "tf2_msgs/TFMessage"
        self._publish = {topic: transport.advertise(topic, kind) for topic, kind in topics.items()}

    def forget(self) -> None:
        """Discard the last transform."""
        self._kept_map_from_odom = None

    def send_belief(self, time_ns: int, estimate: Estimate) -> None:
        """Publish the belief of a time."""
        modes = [(mode.world_from_camera, mode.covariance, mode.weight) for mode in estimate.modes]
        messages = estimate_messages(
            time_ns, modes, estimate.shown, under=self._config.under, frame=self._config.map_frame
        )
        self.last_sent = self._send(messages)

    def send_lagged(self, belief: LiveBelief) -> None:
        """Publish the fixed-lag poses of the camera that have come."""
        topic, frame = f"{self._config.under}/fixed_lag", self._config.map_frame
        poses = belief.take_lagged()
        self._send([pose_message(topic, frame, ns, each.world_from_camera, each.covariance) for ns, each in poses])

    def send_motion(self, belief: LiveBelief, at_network: Job | None) -> None:
        """Publish the base's pose at the latest odometry, and tf; neither while the estimate is not converged.

        Without odometry it is the pose at the last image, without tf.
        """
        reader, anchor, now, time_ns = belief.reader, belief.anchor, belief.now, belief.reader.odometry_ns
        if anchor is not None and not reader.has_odometry:
            self._send_base(belief, anchor)
        if anchor is None or now is None or time_ns is None:
            return
        if self._sent_anchor is anchor and self._sent_ns == time_ns:
            return
        if now.status == "converged" and anchor.reading == reader.readings:
            map_from_odom = self._kept_map_from_odom = belief.map_from_odom(anchor)
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
            # Listeners refuse a second transform of the same stamp.
            before_ns = self._tf_ns if self._sent_reading == reader.readings else 0
            self._tf_ns = max(time_ns + round(self._config.tf_ahead_s * 1e9), before_ns + 1)
            messages.append(tf_message(self._tf_ns, frame, reader.roles.odometry_frame, map_from_odom))
        self._send(messages)
        self._sent_anchor, self._sent_ns, self._sent_reading = anchor, time_ns, reader.readings

    def _send_base(self, belief: LiveBelief, anchor: Anchor) -> None:
        """Publish the base's pose at the last image, once, while the estimate is converged."""
        best = anchor.estimate.modes[0]
        if self._sent_anchor is anchor or anchor.estimate.status != "converged":
            return
        carry = belief.reader.base_from_camera.adjoint()
        topic, frame, pose = f"{self._config.under}/base_pose", self._config.map_frame, belief.map_from_base
        covariance = carry @ best.covariance @ carry.T
        self._send([pose_message(topic, frame, anchor.time_ns, pose(anchor.estimate), covariance)])
        self._sent_anchor = anchor

    def send_diagnostics(self, estimate: Estimate | None, silent: str | None, values: Mapping[str, object]) -> None:
        """Publish diagnostics, see `diagnostics_message`."""
        message = diagnostics_message(
            self._now_ns(),
            hardware=self._hardware,
            estimate=estimate,
            silent=silent,
            values=values,
            storeys=self._storeys,
        )
        self._send([message])

    def _send(self, messages: list[Message]) -> list[RawMessage]:
        sent, now_ns = list[RawMessage](), self._now_ns()
        for message in messages:
            data = encoder(message.type)(message.fields)
            try:
                self._publish[message.topic](data)
            except VaporTrackError as error:  # the network may be back in a moment
                if not self._failed:
                    self._failed = True
                    self._notify(f"{message.topic} could not be published: {error}")
            sent.append(RawMessage(message.topic, now_ns, data, message.type, "cdr", b""))
            if self._foxglove is not None:
                self._foxglove.write(sent[-1])
        return sent
