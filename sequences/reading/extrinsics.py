"""tf of a bag -> its tree of frames, and where on the robot the camera sits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
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
