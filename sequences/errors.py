"""Errors of files and their contents."""

from filtering.errors import VaporTrackError


class SequenceError(VaporTrackError):
    """A sequence, data set or trajectory file cannot be used."""
