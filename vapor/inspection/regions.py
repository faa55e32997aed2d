"""Parts of what was recorded: segments of recordings, floors, cells of the map."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Segment:
    """Images in a row of one recording: numbers count its images with a true pose, from 0.

    Attributes:
        name: Of the recording.
        first: The first of its images.
        last: The last of them.
        low_m: Height of the lowest, metres.
        high_m: Height of the highest.
        floor: The floor that most of them are on, from 0.
    """

    name: str
    first: int
    last: int
    low_m: float
    high_m: float
    floor: int

    def __str__(self) -> str:
        return f"{self.name}: images {self.first} to {self.last} ({height(self.low_m, self.high_m)})"


@dataclass(frozen=True)
class Floor:
    """One of several floors.

    Attributes:
        low_m: Height of the lowest camera, metres.
        high_m: Height of the highest.
        images: How many.
        names: Of the recordings that show it.
        trained: How many of these are not held out as a whole.
        late: The last fraction of their images, in which alone all of them show it; None where it is shown earlier.
    """

    low_m: float
    high_m: float
    images: int
    names: tuple[str, ...]
    trained: int
    late: float | None


@dataclass(frozen=True)
class Cell:
    """A square of the map.

    Attributes:
        floor: From 0.
        column: From the left.
        row: From below.
        passes: How many passes came near it.
        looked: Of these, how many looked each way, by the number of the direction (`Plan.sectors`).
    """

    floor: int
    column: int
    row: int
    passes: int
    looked: Mapping[int, int]


def height(low_m: float, high_m: float) -> str:
    """A range of heights in words."""
    return f"height {low_m:.1f} m" if high_m - low_m < 0.05 else f"height {low_m:.1f} to {high_m:.1f} m"
