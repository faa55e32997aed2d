"""The tree of tf's frames, and where in it the camera is mounted on the bodies whose poses are recorded."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from filtering.se3 import Poses
from sequences.errors import NotFoundError, SequenceError
from sequences.recordings.messages import FrameTransform, transforms_from_message
from sequences.recordings.source import TF, TF_STATIC, MessageSource, RawMessage, decode

BASES = ("base_link", "base_footprint")
_FIXED_M, _FIXED_RAD = 0.02, 0.035  # within which a fixed camera may shake


@dataclass(frozen=True)
class Step:
    """One link of a path through the tree, with its latest pose.

    `static` links are on `/tf_static`. The path leads `upwards` where it goes from the child to the parent.
    """

    parent: str
    child: str
    parent_from_child: Poses
    static: bool
    upwards: bool

    @property
    def link(self) -> tuple[str, str]:
        """Names of parent and child."""
        return self.parent, self.child


class TransformTree:
    """Frames and the transforms between them; a child's latest transform replaces the one before.

    Attributes:
        problem: The first problem with a transform; '' where there was none.
    """

    def __init__(self) -> None:
        self.problem = ""
        self._parents: dict[str, tuple[str, Poses, bool]] = {}

    @property
    def frames(self) -> list[str]:
        """Names of all frames, sorted."""
        return sorted({*self._parents, *(parent for parent, _, _ in self._parents.values())})

    def add(self, transforms: Iterable[FrameTransform], *, static: bool) -> None:
        """Add transforms."""
        for t in transforms:
            self._parents[t.child] = (t.parent, t.parent_from_child, static)

    def path(self, target: str, source: str) -> list[Step] | None:
        """The links whose product is `target_from_source`, through the nearest common ancestor; None without one."""
        up = [target, *self.ancestors(target)]
        down = [source, *self.ancestors(source)]
        common = next((frame for frame in up if frame in down), None)
        if common is None:
            return None
        rising = [self._step(frame, upwards=True) for frame in up[: up.index(common)]]
        falling = [self._step(frame, upwards=False) for frame in down[: down.index(common)]]
        return rising + falling[::-1]

    def ancestors(self, frame: str) -> list[str]:
        """All frames above one, nearest first."""
        chain = [frame]
        while frame in self._parents:
            frame = self._parents[frame][0]
            if frame in chain:  # a loop in the recording
                break
            chain.append(frame)
        return chain[1:]

    def _step(self, child: str, *, upwards: bool) -> Step:
        parent, pose, static = self._parents[child]
        return Step(parent, child, pose, static, upwards)


def along(path: Sequence[Step], poses: Sequence[Poses] | None = None) -> Poses:
    """The product of the links of a path, one pose; `poses` replace their `parent_from_child`."""
    product = Poses.identity()
    for step, pose in zip(path, poses or [step.parent_from_child for step in path], strict=True):
        product = product @ (pose.inverse() if step.upwards else pose)
    return product


def read_tree(
    bag: MessageSource, found: Callable[[TransformTree], bool] = lambda _: False, *, within_s: float | None = None
) -> TransformTree:
    """Read `/tf_static` and then `/tf`, until `found` is true of the tree, or `within_s` seconds of `/tf` have passed.

    Unusable transforms are left out.
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


@dataclass(frozen=True)
class Extrinsics:
    """Where a camera is fixed on a body: body_from_camera, one pose.

    `path` has the links of tf between the two; it is empty where these are one, or an option gives the pose.
    """

    body_from_camera: Poses
    path: tuple[Step, ...] = ()

    @property
    def source_topics(self) -> tuple[str, ...]:
        """Topics that would show that the camera moves on its body."""
        return (TF_STATIC, *([TF] if any(not step.static for step in self.path) else [])) if self.path else ()

    def require_fixed(self, raw: RawMessage, message: Any) -> None:
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
    """The camera's mount on a body by tf; the identity where both are one frame.

    For the error, `body_is` and `camera_is` state the sources of the names, and `instead` an option that would help.
    Raises NotFoundError where no transforms lead from one to the other.
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
    return Extrinsics(along(path), tuple(path))


@dataclass(frozen=True)
class CameraMount:
    """The camera's frame in tf, and the body that its odometry is of; '' for unknown names.

    `base_from_camera` is the camera's pose on the body where an option gives it. The odometry's topic is never taken
    for true poses, unless named.
    """

    camera: str
    base: str = ""
    base_from_camera: Poses | None = None
    odometry_topic: str = ""
    odometry_frame: str = ""

    def on(self, bag: MessageSource, body: str, body_is: str = "") -> Extrinsics:
        """The camera's mount on a body. Raises SequenceError where neither tf nor the option gives it."""
        if not body or body == self.camera:
            return Extrinsics(Poses.identity())
        child = "--ground-truth-child-frame"
        if self.base_from_camera is None:
            return find_extrinsics(bag, body, self.camera, body_is=body_is, instead=f"{child} or --base-from-camera")
        if self.base in ("", body):
            return Extrinsics(self.base_from_camera)
        carrier = find_extrinsics(bag, body, self.base, body_is=body_is, instead=child)
        return replace(carrier, body_from_camera=carrier.body_from_camera @ self.base_from_camera)

    def path(self, tree: TransformTree, frame: str) -> list[Step] | None:
        """The links from a frame to the camera, or to the body on which an option mounts it."""
        if self.base_from_camera is None:
            return tree.path(frame, self.camera)
        carriers = (name for name in BASES if frame in tree.ancestors(name))
        return tree.path(frame, self.base or next(carriers, self.camera))

    @property
    def end(self) -> Poses:
        """The pose that follows such a path, one pose."""
        return Poses.identity() if self.base_from_camera is None else self.base_from_camera
