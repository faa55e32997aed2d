"""Errors of files and their contents."""

from filtering.errors import VaporTrackError


class SequenceError(VaporTrackError):
    """A sequence, data set or trajectory file cannot be used."""


class NotFoundError(SequenceError):
    """What is looked for is not in a recording; of a running system it may still come."""
