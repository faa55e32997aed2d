"""tf of a bag -> its tree of frames, and where the camera is mounted on the bodies whose poses are recorded."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from types import SimpleNamespace

from filtering.se3 import Poses
from sequences.errors import NotFoundError, SequenceError
from sequences.recordings.messages import transforms_from_message
from sequences.recordings.source import TF, TF_STATIC, MessageSource, RawMessage
from sequences.recordings.topics import decode
from sequences.recordings.transforms import Step, TransformTree, along

_FIXED_M, _FIXED_RAD = 0.02, 0.035  # within which a camera that is said to be fixed may shake


@dataclass(frozen=True)
class Extrinsics:
    """Where a camera that is fixed on a body sits.

    Attributes:
        body_from_camera: One pose.
        path: The links of tf between the two; empty where these are one, or the pose was given.
    """

    body_from_camera: Poses
    path: tuple[Step, ...] = ()

    @property
    def told_on(self) -> tuple[str, ...]:
        """Topics that would say that the camera moves on its body."""
        return (TF_STATIC, *([TF] if any(not step.static for step in self.path) else [])) if self.path else ()

    def require_fixed(self, raw: RawMessage, message: SimpleNamespace) -> None:
        """Take a message of tf. Raises SequenceError where a link of the path moves."""
        links = {step.link: step for step in self.path}
        for t in transforms_from_message(message, links)[0]:
            step = links[t.parent, t.child]
            if step.static != (raw.topic == TF_STATIC):
                continue
            metres, radians = step.parent_from_child.distance(t.parent_from_child)
            if metres > _FIXED_M or radians > _FIXED_RAD:
                raise SequenceError(
                    f"{raw.topic} at {t.time_ns} ns: {t.parent} -> {t.child} has moved by {float(metres):.3g} m and"
                    f" {float(radians):.3g} rad, expected the camera to be fixed on its base (--ground-truth-frame and"
                    " --odometry-frame follow it through tf; or give --base-from-camera)"
                )


def find_extrinsics(
    bag: MessageSource,
    body: str,
    camera: str,
    *,
    body_is: str = "",
    camera_is: str = "",
    instead: str = "--base-from-camera",
) -> Extrinsics:
    """Pose of the camera on a body: the identity where both are one, else from tf, read until it says.

    Args:
        bag: The recording.
        body: Frame of the body.
        camera: Frame of the camera.
        body_is: Where the body's name is from, for the error.
        camera_is: Likewise the camera's.
        instead: The option that would say it.

    Raises:
        NotFoundError: no transforms lead from one to the other.
    """
    if body and body == camera:
        return Extrinsics(Poses.identity())
    named = bool(body and camera)
    tree = read_tree(bag, lambda tree: named and tree.path(body, camera) is not None)
    path = tree.path(body, camera) if named else None
    if path is None:
        unusable = f"; unusable: {tree.problem}" if tree.problem else ""
        raise NotFoundError(
            f"{bag.path}: no transform from {body!r}{body_is} to {camera!r}{camera_is}"
            f" on {TF_STATIC} or {TF}, found frames: {', '.join(tree.frames) or 'none'}{unusable}; expected a chain of"
            f" transforms between the two (or name --camera-frame, or give {instead})"
        )
    return Extrinsics(along(path, [step.parent_from_child for step in path]), tuple(path))


def read_tree(
    bag: MessageSource,
    found: Callable[[TransformTree], bool] = lambda _: False,
    *,
    within_s: float | None = None,
) -> TransformTree:
    """The tree of frames, from `/tf_static` and then `/tf`, read until it has what is looked for.

    Messages and transforms that cannot be used are left out; the tree says what was wrong with them.

    Args:
        bag: The recording.
        found: Asked after every message; reading stops where it says yes.
        within_s: Seconds of `/tf` to read; None for all of it.
    """
    tree = TransformTree()
    for name in (TF_STATIC, TF):
        if name not in bag:
            continue
        begin_ns: int | None = None
        for raw in bag.messages([name]):
            begin_ns = raw.log_time_ns if begin_ns is None else begin_ns
            if name == TF and within_s is not None and (raw.log_time_ns - begin_ns) * 1e-9 > within_s:
                break
            message = decode(bag, raw, tolerate=True)
            if message is None:
                tree.problem = tree.problem or f"{len(raw.data)} bytes on {name} that are no {raw.type}"
                continue
            transforms, problems = transforms_from_message(message)
            tree.problem = tree.problem or next(iter(problems), "")
            tree.add(transforms, static=name == TF_STATIC)
            if found(tree):
                return tree
    return tree


BASES = ("base_link", "base_footprint")


@dataclass(frozen=True)
class Rig:
    """The names by which tf knows a camera, and the body that its odometry is of.

    Attributes:
        camera: Frame of the camera.
        base: Frame of the body; '' where no odometry is read.
        base_from_camera: The pose of one on the other where an option gives it.
        odometry_topic: Topic of the odometry, which is none of true poses unless named; '' where there is none.
        odometry_frame: Frame that the odometry is in; '' where none is read.
    """

    camera: str
    base: str = ""
    base_from_camera: Poses | None = None
    odometry_topic: str = ""
    odometry_frame: str = ""

    def on(self, bag: MessageSource, body: str, body_is: str = "") -> Extrinsics:
        """Where the camera sits on a body. Raises SequenceError where neither tf nor the option says it."""
        if not body or body == self.camera:
            return Extrinsics(Poses.identity())
        if self.base_from_camera is None:
            return find_extrinsics(
                bag, body, self.camera, body_is=body_is, instead="--ground-truth-child-frame or --base-from-camera"
            )
        if self.base in ("", body):
            return Extrinsics(self.base_from_camera)
        carrier = find_extrinsics(bag, body, self.base, body_is=body_is, instead="--ground-truth-child-frame")
        return replace(carrier, body_from_camera=carrier.body_from_camera @ self.base_from_camera)

    def path(self, tree: TransformTree, frame: str) -> list[Step] | None:
        """The links from a frame to the camera, or to the body on which an option says where it sits."""
        return tree.path(frame, self.camera if self.base_from_camera is None else self._carrier(tree, frame))

    def _carrier(self, tree: TransformTree, frame: str) -> str:
        if self.base:
            return self.base
        return next((name for name in BASES if frame in tree.ancestors(name)), self.camera)

    @property
    def end(self) -> Poses:
        """What follows at the end of such a path, one pose."""
        return Poses.identity() if self.base_from_camera is None else self.base_from_camera
