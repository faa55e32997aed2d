"""Errors of files and their contents."""

from filtering.errors import VaporTrackError


class SequenceError(VaporTrackError):
    """A sequence, data set or trajectory file cannot be used."""


class NotFoundError(SequenceError):
    """Something is missing in a recording; a running system may still send it."""


class NoOdometryError(NotFoundError):
    """A recording has no odometry at all."""


class NoImageError(SequenceError):
    """A recording has images, and none of them can be used."""
