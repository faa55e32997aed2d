"""Where the camera has been, how often and looking which way; and what only some of the recordings show."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64

from filtering.floors import find_floors
from vapor.inspection.plan import Plan
from vapor.inspection.regions import Cell, Floor, Segment
from vapor.training.config import TrainConfig
from vapor.training.holding_out import AWAY, WHOLE_OF, Split, hold_out, long_runs, shown_by, way_of
from vapor.training_data.ground import DIRECTION_RAD, runs
from vapor.training_data.training_set import TrainingSet

_LATE = 0.25  # of a recording


@dataclass(frozen=True)
class Coverage:
    """What n images with true poses of r recordings show.

    Attributes:
        images: Them.
        split: What `train` would hold out.
        shown: Whether each image is shown by each recording, by another pass of it where it is its own, (n, r).
        plan: The map.
        way: How far the camera has come, (n,).
    """

    images: TrainingSet
    split: Split
    shown: Bool[np.ndarray, "n r"]
    plan: Plan
    way: Float64[np.ndarray, " n"]

    @staticmethod
    def of(images: TrainingSet) -> Coverage:
        """What these images show, by the same measure by which `train` holds some of them out."""
        split = hold_out(images, TrainConfig().validation_fraction)
        plan = Plan.of(images.poses, split.near_m)
        return Coverage(images, split, shown_by(images, split.near_m), plan, way_of(images))

    @property
    def by_recordings(self) -> bool:
        """Whether what other recordings show counts, as whole ones are held out; else what other passes do."""
        return len(self.images.names) >= WHOLE_OF

    @cached_property
    def others(self) -> Int64[np.ndarray, " n"]:
        """How many other recordings show each image; of few, how many do it in another pass."""
        own = np.arange(len(self.images)), self.images.sequence
        return self.shown.sum(axis=1) - (self.shown[own] if self.by_recordings else 0)

    @cached_property
    def places(self) -> Float64[np.ndarray, "n 3"]:
        """On the map, and heights, metres."""
        return self.plan.places(self.images.poses)

    @cached_property
    def cells(self) -> Int64[np.ndarray, "n 2"]:
        """Column and row of the map's cells."""
        return np.floor((self.places[:, :2] - self.places[:, :2].min(axis=0)) / self.plan.cell_m).astype(np.int64)

    @cached_property
    def floor(self) -> Int64[np.ndarray, " n"]:
        """The floor of each image, from 0."""
        return find_floors(self.places[:, 2], self.cells[:, 0] * (self.cells[:, 1].max() + 1) + self.cells[:, 1])[0]

    @cached_property
    def sectors(self) -> Int64[np.ndarray, " n"]:
        """Which way each image looks."""
        return self.plan.sectors(self.images.poses)

    @cached_property
    def passes(self) -> list[Cell]:
        """The cells of the map in which an image is, each with the passes that came near it."""
        keys, index = np.unique(np.column_stack([self.floor, self.cells]), axis=0, return_inverse=True)
        index, near_m = index.ravel(), self.split.near_m
        position, ahead = self.images.poses.translation, self.images.poses.rotation[:, :, 2]
        found = []
        for number, (floor, column, row) in enumerate(keys.tolist()):
            own = np.flatnonzero(index == number)
            apart_m = np.linalg.norm(position - position[own].mean(axis=0), axis=1)
            near, away = apart_m <= near_m, apart_m > AWAY * near_m
            near[own] = True
            looked = {}
            for sector in np.unique(self.sectors[own]).tolist():
                alike = ahead @ ahead[own[self.sectors[own] == sector]].mean(axis=0)
                looks = near & (alike >= np.cos(DIRECTION_RAD))
                looks[own[self.sectors[own] == sector]] = True
                looked[sector] = _visits(looks, away | (alike < 0.0), self.images.sequence)
            found.append(Cell(floor, column, row, _visits(near, away, self.images.sequence), looked))
        return found

    def alone(self) -> list[Segment]:
        """Segments that no other recording shows, or of few recordings no other pass; from the longest down."""
        alone = self.others == 0
        sequence = self.images.sequence
        brief = ~alone & ~long_runs(~alone, self.way, sequence)
        found = []
        for run in runs(long_runs(alone | brief, self.way, sequence), sequence):
            rows = np.arange(run.start, run.stop)
            rows = rows[np.flatnonzero(alone[rows])[[0, -1]]] if alone[rows].any() else rows[:0]
            if len(rows):
                found.append(self._segment(slice(int(rows[0]), int(rows[-1]) + 1)))
        return sorted(found, key=lambda segment: segment.first - segment.last)

    def _segment(self, run: slice) -> Segment:
        number = int(self.images.sequence[run.start])
        begin = int(np.argmax(self.images.sequence == number))
        heights = self.places[run, 2]
        return Segment(
            self.images.names[number],
            run.start - begin,
            run.stop - 1 - begin,
            float(heights.min()),
            float(heights.max()),
            int(np.bincount(self.floor[run]).argmax()),
        )

    def floors(self) -> list[Floor]:
        """From the lowest up; none where there is one only."""
        if self.floor.max() == 0:
            return []
        found = []
        sequence, kept = self.images.sequence, np.isin(self.images.rows, self.split.training.rows)
        for number in range(int(self.floor.max()) + 1):
            on_it = self.floor == number
            recordings = np.unique(sequence[on_it])
            first = min(float(np.argmax(on_it[sequence == own])) / (sequence == own).sum() for own in recordings)
            heights = self.places[on_it, 2]
            found.append(
                Floor(
                    float(heights.min()),
                    float(heights.max()),
                    int(on_it.sum()),
                    tuple(self.images.names[own] for own in recordings),
                    len(np.unique(sequence[on_it & kept])),
                    1.0 - first if 1.0 - first <= _LATE else None,
                )
            )
        return found

    def as_json(self) -> dict[str, Any]:
        """Figures for the report."""
        counts = np.bincount(np.minimum(self.others, 4), minlength=5) / len(self.others)
        return {
            "near_m": self.split.near_m,
            "cell_m": self.plan.cell_m,
            "judged_by": "recordings" if self.by_recordings else "passes",
            "shown_by_others": {str(i) if i < 4 else "4 or more": float(v) for i, v in enumerate(counts)},
            "alone": [vars(segment) | {"said": str(segment)} for segment in self.alone()],
            "floors": [vars(floor) for floor in self.floors()],
            "held_out": int(self.split.held_out_mask.sum()),
            "holding_out": list(self.split.notes),
        }


def _visits(near: Bool[np.ndarray, " n"], away: Bool[np.ndarray, " n"], sequence: Int64[np.ndarray, " n"]) -> int:
    """How often recordings come near something, having been away from it between."""
    clear = np.flatnonzero(near | away)
    comes = near[clear]
    before = np.concatenate([[False], comes[:-1]])
    before[1:] &= np.diff(sequence[clear]) == 0
    return int((comes & ~before).sum())
