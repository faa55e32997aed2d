"""Settings of a map, and the moments that a measured distance is between."""

from __future__ import annotations

import re
from dataclasses import dataclass

from filtering.errors import VaporTrackError, quoted, require_within


@dataclass(frozen=True)
class MapConfig:
    """How poses are made from images."""

    images: int = 300
    """Images of all inputs together, at most: the sharpest ones of even stretches of time. The time grows with them, to
    a few minutes for 300."""
    per_second: float = 4.0
    """Images of a second, at most. Of images without time stamps each may be taken."""
    longest_edge: int = 960
    """Longer edge of the images, pixels, at most."""
    distance_m: float | None = None
    """One distance that you measured, as with a tape: between the camera's positions at two moments, in metres. Begin
    to film at one end of a room, end at its other end, and measure from end to end. It replaces recorded odometry and
    poses as the source of the scale."""
    between: tuple[str, str] = ("start", "end")
    """The two moments: start, end, or seconds from the start (73.5 or 1:13.5), of the first input; walk2@end is of the
    input walk2.mp4. Of images without time stamps a number counts images, from 0."""

    def __post_init__(self) -> None:
        require_within(self, images=(2, 10**5), per_second=(1e-3, 1e3), longest_edge=(64, 10**4))
        if self.distance_m is not None:
            require_within(self, distance_m=(1e-3, 1e5))
        for text in self.between:
            Moment.of(text)
        if self.distance_m is None and self.between != type(self).between:
            raise VaporTrackError("--between without a distance, expected --distance-m METRES with it")


@dataclass(frozen=True)
class Moment:
    """A moment of a walk.

    Attributes:
        text: As it was given.
        walk: Name of the input, without its suffix; None for the first one.
        at: Seconds from its start, or the number of an image; infinite for its end.
    """

    text: str
    walk: str | None
    at: float

    @classmethod
    def of(cls, text: str) -> Moment:
        """The moment that a text states, such as `start`, `73.5`, `1:13.5` or `walk2@end`.

        Raises VaporTrackError where it states none.
        """
        name, separator, when = text.rpartition("@")
        if (named := {"start": 0.0, "end": float("inf")}.get(when)) is not None:
            return cls(text, name if separator else None, named)
        match = re.fullmatch(r"(?:(\d{1,6}):)?(\d{1,9}(?:\.\d{1,9})?)", when, flags=re.ASCII)
        if match is None:
            raise VaporTrackError(
                f"--between {quoted(text)}, expected start, end or seconds, such as 73.5 or walk2@end"
            )
        return cls(text, name if separator else None, 60.0 * float(match[1] or 0) + float(match[2]))
