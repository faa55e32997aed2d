"""Where the camera was, how often and looking which way; and places that only some of the recordings show."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64

from filtering.errors import listed
from filtering.storeys import find_storeys, up_axis
from vapor.training.config import TrainConfig
from vapor.training.holding_out import AWAY, WHOLE_OF, hold_out, long_runs, shown_by, way_of
from vapor.training_data.ground import DIRECTION_RAD, runs
from vapor.training_data.training_set import TrainingSet

SECTORS = 8
STEEP = np.sin(np.deg2rad(60.0))
_NAMED = 3
_MOST_CELLS = 50  # along the longer side of the plan


def _round(value: float) -> float:
    # Up to 1, 2 or 5 times a power of ten.
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * next(step for step in (1, 2, 5, 10) if step * power >= value * (1 - 1e-9)))


@dataclass(frozen=True)
class Segment:
    """Images in a row of one recording, first to last: numbers count its images with a true pose, as PATH@START:STOP.

    Heights, in metres, are of the lowest and the highest; most images are on the storey with this number, from 1.
    """

    name: str
    first: int
    last: int
    low_m: float
    high_m: float
    storey: int

    def __str__(self) -> str:
        return f"{self.name}: images {self.first} to {self.last} ({height(self.low_m, self.high_m)})"


@dataclass(frozen=True)
class Storey:
    """One of several storeys: heights in metres of its lowest and highest camera, its images, and the recordings there.

    Numbers count from 1, the lowest. `trained` of the recordings are not held out as a whole.
    """

    number: int
    low_m: float
    high_m: float
    images: int
    names: tuple[str, ...]
    trained: int

    def __str__(self) -> str:
        images = f"{self.images} image{'s' * (self.images != 1)}"
        return f"storey {self.number} ({height(self.low_m, self.high_m)}): {images}, of {listed(self.names, _NAMED)}"


@dataclass(frozen=True)
class Cell:
    """A square of the map: storey from 0, column from the left, row from below.

    `passes` came near it, of which `looked` counts those that looked each way, by direction (`Coverage.sectors`).
    """

    storey: int
    column: int
    row: int
    passes: int
    looked: Mapping[int, int]


def in_axes(vector: Float64[np.ndarray, "3"]) -> str:
    """A direction in the world by its axes, such as "+x -y"."""
    named = zip("xyz", vector.tolist(), strict=True)
    return " ".join(f"{'+' if part > 0 else '-'}{name}" for name, part in named if abs(part) > 0.1)


def height(low_m: float, high_m: float) -> str:
    """A range of heights in words."""
    low, high = (f"{round(each, 1) + 0.0:.1f}" for each in (low_m, high_m))  # no minus before a zero
    return f"height {low} m" if high_m - low_m < 0.05 else f"height {low} to {high} m"


class Coverage:
    """Coverage of a place by n images with true poses of r recordings, measured as `train` does to hold images out.

    It has a map from above, with cells of a side in metres. Axes are right and up on the map, and the world's axis that
    is up in most images: unit vectors in the world, rows (3, 3).
    """

    def __init__(self, images: TrainingSet) -> None:
        self.images = images
        self.split = hold_out(images, TrainConfig().validation_fraction)
        up = up_axis(images.poses)
        right = np.eye(3)[0 if up[0] == 0.0 else 1]
        self.axes = np.stack([right, np.cross(up, right), up])
        extent = np.ptp(self.places[:, :2], axis=0).max()
        self.cell_m = _round(max(self.split.near_m / 2, extent / _MOST_CELLS))

    @property
    def by_recordings(self) -> bool:
        """Whether other recordings count, as whole ones are held out; else other passes do."""
        return len(np.unique(self.images.walk)) >= WHOLE_OF

    @cached_property
    def others(self) -> Int64[np.ndarray, " n"]:
        """Number of other recordings that show each image; of few recordings, of those that do in another pass."""
        shown = shown_by(self.images, self.split.near_m)  # by each recording; of its own, by another pass
        numbers, own = np.unique(self.images.walk, return_inverse=True)
        if len(numbers) < shown.shape[1]:  # several cameras of a walk are one recording
            of_walk = np.array(self.images.walks)
            shown = np.stack([shown[:, of_walk == number].any(axis=1) for number in numbers], axis=1)
        return shown.sum(axis=1) - (shown[np.arange(len(own)), own] if self.by_recordings else 0)

    @cached_property
    def places(self) -> Float64[np.ndarray, "n 3"]:
        """Positions on the map and heights, metres."""
        return self.images.poses.translation @ self.axes.T

    @cached_property
    def cells(self) -> Int64[np.ndarray, "n 2"]:
        """Column and row of the map's cells."""
        return np.floor((self.places[:, :2] - self.places[:, :2].min(axis=0)) / self.cell_m).astype(np.int64)

    @cached_property
    def storey(self) -> Int64[np.ndarray, " n"]:
        """The storey of each image, from 0."""
        return find_storeys(self.places[:, 2], self.cells[:, 0] * (self.cells[:, 1].max() + 1) + self.cells[:, 1])[0]

    @cached_property
    def sectors(self) -> Int64[np.ndarray, " n"]:
        """Direction of each image: 0 to 7 from right on the map counterclockwise, 8 up and 9 down."""
        ahead = self.images.poses.rotation[:, :, 2] @ self.axes.T
        level = np.round(np.arctan2(ahead[:, 1], ahead[:, 0]) / (2 * np.pi / SECTORS)).astype(np.int64) % SECTORS
        return np.where(np.abs(ahead[:, 2]) < STEEP, level, np.where(ahead[:, 2] > 0, SECTORS, SECTORS + 1))

    def direction(self, sector: int) -> str:
        """A direction by the axes of the world, such as "+x -y"."""
        if sector >= SECTORS:
            return "up" if sector == SECTORS else "down"
        turn = sector * 2 * np.pi / SECTORS
        return in_axes(np.cos(turn) * self.axes[0] + np.sin(turn) * self.axes[1])

    @cached_property
    def passes(self) -> list[Cell]:
        """The cells of the map that have an image."""
        keys, index = np.unique(np.column_stack([self.storey, self.cells]), axis=0, return_inverse=True)
        index, near_m = index.ravel(), self.split.near_m
        position, ahead = self.images.poses.translation, self.images.poses.rotation[:, :, 2]
        found = []
        for number, (storey, column, row) in enumerate(keys.tolist()):
            own = np.flatnonzero(index == number)
            apart_m = np.linalg.norm(position - position[own].mean(axis=0), axis=1)
            near, away = apart_m <= near_m, apart_m > AWAY * near_m
            near[own] = True
            looked = {}
            for sector in np.unique(self.sectors[own]).tolist():
                alike = ahead @ ahead[own[self.sectors[own] == sector]].mean(axis=0)
                looks = near & (alike >= np.cos(DIRECTION_RAD))
                looks[own[self.sectors[own] == sector]] = True
                looked[sector] = self._visits(looks, away | (alike < 0.0))
            found.append(Cell(storey, column, row, self._visits(near, away), looked))
        return found

    def _visits(self, near: Bool[np.ndarray, " n"], away: Bool[np.ndarray, " n"]) -> int:
        """Visits of all walks; of the cameras of one walk, the most of any."""
        sequence, walks = self.images.sequence, self.images.walks
        if len(set(walks)) == len(walks):
            return _visits(near, away, sequence)
        most = dict.fromkeys(walks, 0)
        for number in np.unique(sequence[near]).tolist():
            of_camera = _visits(near & (sequence == number), away, sequence)
            most[walks[number]] = max(most[walks[number]], of_camera)
        return sum(most.values())

    def alone(self) -> list[Segment]:
        """Segments that no other recording, or of few recordings no other pass, shows; from the longest down."""
        alone = self.others == 0
        sequence, way = self.images.sequence, way_of(self.images)
        brief = ~alone & ~long_runs(~alone, way, sequence)
        found = []
        for run in runs(long_runs(alone | brief, way, sequence), sequence):
            rows = run.start + np.flatnonzero(alone[run])
            if len(rows):
                within = slice(rows[0], rows[-1] + 1)
                number, heights = int(sequence[run.start]), self.places[within, 2]
                first, last = self.images.number[rows[[0, -1]]].tolist()
                storey = int(np.bincount(self.storey[within]).argmax()) + 1
                low_m, high_m = float(heights.min()), float(heights.max())
                found.append(Segment(self.images.names[number], first, last, low_m, high_m, storey))
        return sorted(found, key=lambda segment: segment.first - segment.last)

    def storeys(self) -> list[Storey]:
        """From the lowest up; empty where there is one only."""
        if self.storey.max() == 0:
            return []
        found = []
        sequence, kept = self.images.sequence, np.isin(self.images.rows, self.split.training.rows)
        for number in range(int(self.storey.max()) + 1):
            on_it = self.storey == number
            heights, recordings = self.places[on_it, 2], np.unique(sequence[on_it])
            names = tuple(self.images.names[own] for own in recordings)
            trained = len(np.unique(sequence[on_it & kept]))
            found.append(
                Storey(number + 1, float(heights.min()), float(heights.max()), int(on_it.sum()), names, trained)
            )
        return found

    def as_json(self) -> dict[str, Any]:
        """Figures for the report."""
        counts = np.bincount(np.minimum(self.others, 4), minlength=5) / len(self.others)
        return {
            "near_m": self.split.near_m,
            "cell_m": self.cell_m,
            "judged_by": "recordings" if self.by_recordings else "passes",
            "shown_by_others": {str(i) if i < 4 else "4 or more": float(v) for i, v in enumerate(counts)},
            "alone": [vars(segment) | {"description": str(segment)} for segment in self.alone()],
            "storeys": [vars(storey) for storey in self.storeys()],
            "held_out": int(self.split.held_out_mask.sum()),
            "holding_out": list(self.split.notes),
        }


def _visits(near: Bool[np.ndarray, " n"], away: Bool[np.ndarray, " n"], sequence: Int64[np.ndarray, " n"]) -> int:
    """Number of times that recordings come near, having been away between."""
    clear = np.flatnonzero(near | away)
    comes = near[clear]
    before = np.concatenate([[False], comes[:-1]])
    before[1:] &= np.diff(sequence[clear]) == 0
    return int((comes & ~before).sum())
