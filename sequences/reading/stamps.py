"""From when to when messages are, and what to say where those of one kind are of another time than the images."""

from __future__ import annotations

from dataclasses import dataclass

from sequences.trajectories.interpolation import MAX_ODOMETRY_GAP_S

MAX_LATENESS_S = 10.0
"""How long poses are remembered for images that come late, where nothing else says what will be asked for."""


@dataclass
class Stamps:
    """The messages of one topic: how many, the earliest and the latest stamp."""

    number: int = 0
    begin_ns: int = 0
    end_ns: int = 0

    def take(self, time_ns: int) -> None:
        """Take in the stamp of a message."""
        self.begin_ns = time_ns if self.number == 0 else min(self.begin_ns, time_ns)
        self.end_ns = time_ns if self.number == 0 else max(self.end_ns, time_ns)
        self.number += 1

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """The earliest and the latest stamp; None where there is none."""
        return (self.begin_ns, self.end_ns) if self.number else None


def odometry_apart(images_ns: tuple[int, int] | None, odometry_ns: tuple[int, int] | None) -> str | None:
    """What to say where odometry is of another time than all images: by another clock. None elsewhere.

    Args:
        images_ns: First and last stamp of the images; None where there is none.
        odometry_ns: First and last stamp of the odometry; None where there is none.
    """
    if images_ns is None or odometry_ns is None:
        return None
    if odometry_ns[0] <= images_ns[1] and images_ns[0] <= odometry_ns[1]:
        return None
    return (
        f"images run from {_seconds(images_ns[0])} to {_seconds(images_ns[1])} s, odometry from"
        f" {_seconds(odometry_ns[0])} to {_seconds(odometry_ns[1])} s: they begin"
        f" {abs(odometry_ns[0] - images_ns[0]) * 1e-9:.1f} s apart, expected one clock (--stamps log takes log times)"
    )


def odometry_sparse(said: str, spacing_s: float) -> str | None:
    """What to say where odometry comes too rarely to lead from image to image. None elsewhere.

    Args:
        said: What the odometry is.
        spacing_s: How far apart its messages usually are.
    """
    if spacing_s <= MAX_ODOMETRY_GAP_S:
        return None
    return (
        f"odometry of {said} comes every {spacing_s:.2g} s: no motion is known over gaps of more than"
        f" {MAX_ODOMETRY_GAP_S:g} s, expected a topic with denser odometry (--odometry-topic, --odometry-frame)"
    )


def true_poses_apart(said: str, poses_ns: tuple[int, int] | None, frames_ns: tuple[int, int]) -> str:
    """What to say where there are true poses, but none of the time of an image.

    Args:
        said: What the true poses are.
        poses_ns: First and last stamp of the poses; None where there are none.
        frames_ns: First and last stamp of the frames.
    """
    span, (begin, end) = poses_ns, frames_ns
    when = "no pose" if span is None else f"from {_seconds(span[0])} to {_seconds(span[1])} s"
    return (
        f"no image with a true pose: those of {said} are {when}, images from {_seconds(begin)} to"
        f" {_seconds(end)} s; expected poses of that time, without long gaps (--time-offset-s shifts a file's)"
    )


def jumps_of_true_poses(said: str, number: int, first_ns: int, num_images: int) -> str:
    """What to say of true poses that jump.

    Args:
        said: What they are.
        number: How many times they jump.
        first_ns: When they first did.
        num_images: How many images lie between two poses with a jump between them.
    """
    return (
        f"true poses of {said} jump {number} times, first at {_seconds(first_ns)} s: {num_images} images between have"
        " none"
    )


def _seconds(time_ns: int) -> str:
    return f"{time_ns * 1e-9:.3f}"
