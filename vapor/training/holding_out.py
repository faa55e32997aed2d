"""Choice of held-out images: passes over ground that others cover, apart from all images that are trained on."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float64, Int64

from filtering.errors import length_said, listed
from vapor.calibration.error_correlation import LEAST_IMAGES
from vapor.checkpoints.scene_scale import spaced, typical_side_m
from vapor.training_data.ground import (
    DIRECTION_RAD,
    FARTHEST,
    describe_runs,
    near_m_of,
    near_scale_m,
    nearest_m,
    runs,
    shown_around,
)
from vapor.training_data.training_set import TrainingSet

WHOLE_OF = 4  # least number of recordings of which whole ones are held out
_LEAST_SHOWN = 0.25  # of a pass, for it to be held out
AWAY = 1.5  # distance from which on the camera is elsewhere, in distances that count as near
_COMPARED = 4000  # images by which passes are compared
_NAMED = 5  # recordings in a note
_STRETCH, _IN_STRETCH = 0.7, 4  # least length of a short stretch: distance by `way_of`, and images
_OTHER_WALKS = "they are of recordings that nothing else was learned from"
_OTHER_PASSES = "they are other passes of the recordings that it learned from: some evidence for another walk"
BETWEEN = (
    "they are of the recordings that it learned from, and taken shortly before and after images that it learned from:"
    " little evidence for another walk"
)
"""`Split.evidence` of the middles of short stretches."""
_GIVEN = "they are of the held-out data that were given"


@dataclass(frozen=True)
class Split:
    """Images to train on and images that are held out; some images may be neither.

    Attributes:
        training: Images to train on.
        source: All n images of the recordings that have held-out images, as odometry leads through all of them.
        held_out_mask: Mask of the held-out images, (n,). Training images show the surroundings of each, and are apart
            from it in time.
        notes: The reasons of the choice, in sentences.
        everything: Images to learn from once the model was evaluated.
        near_m: Distance within which a place counts as shown, metres.
        evidence: What the held-out images are of, and so what figures on them are worth; empty where there are none.
    """

    training: TrainingSet
    source: TrainingSet
    held_out_mask: Bool[np.ndarray, " n"]
    notes: tuple[str, ...]
    everything: TrainingSet
    near_m: float
    evidence: str = ""

    @cached_property
    def held_out(self) -> TrainingSet:
        """The images to evaluate and calibrate on."""
        return self.source.select(np.flatnonzero(self.held_out_mask))

    def evaluated(self, limit: int) -> TrainingSet:
        """At most `limit` of the held-out images, evenly spaced."""
        return self.held_out.select(spaced(len(self.held_out), limit))


def hold_out(images: TrainingSet, fraction: float) -> Split:
    """Hold out about a fraction of the images, in [0, 1).

    Of four or more recordings, the whole ones that the others cover best are held out; of fewer, the segments that the
    rest covers best. Ground that no other pass shows is trained on, and images next to it are left out. Where nothing
    is covered, the middles of short stretches are held out.
    """
    nothing = np.zeros(len(images), bool)
    side = typical_side_m(images.poses)
    if fraction == 0.0:
        return Split(images, images, nothing, (), images, near_scale_m(images.poses))
    way = way_of(images)
    rows = spaced(len(images), _COMPARED)
    chosen, near_m = _chosen(images.select(rows), way[rows], fraction, side)
    like = np.searchsorted(rows, np.arange(len(images)), side="right") - 1  # the last compared image, or the next one
    like += images.sequence[rows[like]] != images.sequence
    candidate = chosen[like]
    others = ~candidate & ~_touching(way, images.walk, candidate)
    shown = candidate.copy()
    shown[candidate] = nearest_m(images.poses[candidate], images.poses[others], FARTHEST * side) <= near_m
    alone = long_runs(candidate & ~shown, way, images.sequence)
    training = ~candidate | alone
    held_out = shown & ~_touching(way, images.walk, training)
    if held_out.sum() < LEAST_IMAGES:
        return _within_one_pass(images, way, fraction, near_m)
    notes = [f"held out: {_in_words(images, held_out)}; other passes show the same ground"]
    if alone.any():
        notes.append(
            f"trained on, as no other recording shows it within {length_said(near_m)} and 45°:"
            f" {_in_words(images, alone)}"
        )
    left = int((~training & ~held_out).sum())
    if left:
        notes.append(f"{left} images are left out, as they are next to images that are trained on or not shown by any")
    evidence = _OTHER_WALKS if len(np.unique(images.walk)) >= WHOLE_OF else _OTHER_PASSES
    return Split(images.select(np.flatnonzero(training)), images, held_out, tuple(notes), images, near_m, evidence)


def _within_one_pass(images: TrainingSet, way: Float64[np.ndarray, " n"], fraction: float, near_m: float) -> Split:
    """Hold out the middles of short stretches, where no pass leads over ground that another pass shows.

    Images between the middle of a stretch and its ends are left out: they were taken at nearly the same time.
    """
    _, walk = np.unique(images.walk, return_inverse=True)
    first, last = np.full(walk.max() + 1, np.inf), np.full(walk.max() + 1, -np.inf)
    np.minimum.at(first, walk, way)
    np.maximum.at(last, walk, way)
    since, until = way - first[walk], (last - first)[walk]
    steps = np.diff(way)[np.diff(images.sequence) == 0]
    stretch = max(_STRETCH, _IN_STRETCH * float(np.median(steps)) if len(steps) else 0.0)
    left_out = held_out = np.zeros(len(images), bool)
    for share in (fraction, min(2.0 * fraction, 0.25)):  # the more, the fewer images there are
        period = stretch / (2.0 * share)
        away = np.abs(since % period - 0.5 * period)  # from the middle of a stretch
        whole = (since - since % period + 0.5 * (period + stretch)) < until  # its other end is trained on, too
        left_out, held_out = (whole & (away < part * stretch) for part in (0.5, 0.25))
        held_out[1:] &= left_out[:-1]
        held_out[:-1] &= left_out[1:]
        if held_out.sum() >= LEAST_IMAGES:
            break
    if held_out.sum() < LEAST_IMAGES:
        note = (
            f"nothing is held out: fewer than {LEAST_IMAGES} images lead over ground that other passes show, or lie in"
            " the middles of short stretches; the last epoch is kept, and errors are assumed: record another pass, or"
            " give held-out data"
        )
        return Split(images, images, np.zeros(len(images), bool), (note,), images, near_m)
    note = (
        f"held out: the middles of short stretches, {held_out.sum()} images: {_in_words(images, held_out)}; no pass"
        f" leads over ground that another shows, and {(left_out & ~held_out).sum()} images about them are left out"
    )
    return Split(images.select(np.flatnonzero(~left_out)), images, held_out, (note,), images, near_m, BETWEEN)


def within_map(training: TrainingSet, held_out: TrainingSet) -> Split:
    """Evaluate on those held-out images whose surroundings training images show."""
    shown, near_m = shown_around(held_out.poses, training.poses)
    outside = (
        f"not evaluated on, as no training image is within {length_said(near_m)} and 45°: {_in_words(held_out, ~shown)}"
    )
    notes = () if shown.all() else (outside,)
    return Split(training, held_out, shown, notes, training, near_m, _GIVEN if shown.any() else "")


def shown_by(images: TrainingSet, near_m: float) -> Bool[np.ndarray, "n r"]:
    """Whether each of n images is shown by each of r recordings; in its own recording, by another pass.

    Before another pass the camera was elsewhere, or looked away by more than 90°. A place within `near_m` counts as
    shown, see `Split.near_m`.
    """
    scale_m = FARTHEST * typical_side_m(images.poses)
    way = way_of(images)
    found = np.zeros((len(images), len(images.names)), bool)
    walk = images.walk
    for number in range(len(images.names)):
        of_it = images.sequence == number
        others = walk != walk[of_it][:1]  # other cameras see the same at the same time, which shows nothing
        found[others, number] = nearest_m(images.poses[others], images.poses[of_it], scale_m) <= near_m
        own = np.flatnonzero(of_it)
        at, ahead = images.poses.translation[own], images.poses.rotation[own, :, 2]
        pieces = np.floor(4.0 * (way[own] - way[own[:1]]))
        for piece in np.split(np.arange(len(own)), np.flatnonzero(np.diff(pieces)) + 1) if len(own) else ():
            middle = piece[len(piece) // 2]
            away = np.linalg.norm(at - at[middle], axis=1) > AWAY * near_m
            away |= ahead @ ahead[middle] < 0.0
            leaves = np.flatnonzero(away)
            split = np.searchsorted(leaves, middle)
            begin = leaves[split - 1] + 1 if split else 0
            end = leaves[split] if split < len(leaves) else len(own)
            others = np.concatenate([own[:begin], own[end:]])
            apart_m = nearest_m(images.poses[own[piece]], images.poses[others], scale_m)
            found[own[piece], number] = apart_m <= near_m
    return found


def way_of(images: TrainingSet) -> Float64[np.ndarray, " n"]:
    """Normalized distance that the camera has covered, (n,): 1 for a move to elsewhere, and for each 45° turned.

    Of several cameras on one walk it is that of the first, at the time of each image.
    """
    steps = np.zeros(len(images))
    if len(images) > 1:
        moved_m, turned = images.poses[:-1].distance(images.poses[1:])
        steps[1:] = moved_m / (FARTHEST * typical_side_m(images.poses)) + turned / DIRECTION_RAD
    way, walk = np.cumsum(steps), images.walk
    for number in np.unique(walk):
        cameras = [np.flatnonzero(images.sequence == camera) for camera in np.unique(images.sequence[walk == number])]
        for own in cameras[1:]:
            way[own] = _along_first(images.times_ns[own], way[own], images.times_ns[cameras[0]], way[cameras[0]])
    return way


def _along_first(
    times_ns: Int64[np.ndarray, " k"],
    way: Float64[np.ndarray, " k"],
    first_ns: Int64[np.ndarray, " f"],
    first_way: Float64[np.ndarray, " f"],
) -> Float64[np.ndarray, " k"]:
    """The distance of a walk's first camera at the times of another; before and after it, that of the other goes on."""
    found = np.interp(times_ns, first_ns, first_way)
    begin, end = np.interp(first_ns[[0, -1]], times_ns, way)
    before, after = times_ns < first_ns[0], times_ns > first_ns[-1]
    found[before] += way[before] - begin
    found[after] += way[after] - end
    return found


def _chosen(
    images: TrainingSet, way: Float64[np.ndarray, " n"], fraction: float, side: float
) -> tuple[Bool[np.ndarray, " n"], float]:
    """Mask of the passes to hold out, and the distance that counts as near, metres."""
    passes = list(_passes(images, fraction))
    taken = np.zeros(len(images), bool)

    def nearest(which: Int64[np.ndarray, " p"]) -> Float64[np.ndarray, " k"]:
        """Distances of the images of a pass, and of those already taken, from the images that would be trained on."""
        mask = taken.copy()
        mask[which] = True
        others = ~mask & ~_touching(way, images.walk, mask)
        return nearest_m(images.poses[mask], images.poses[others], FARTHEST * side)

    near_m = near_m_of(np.concatenate([nearest(which) for which in passes]), FARTHEST * side)
    while taken.sum() < fraction * len(images):
        free = [which for which in passes if not taken[which].any()]
        shown = [float((nearest(which) <= near_m).mean()) for which in free]
        if not shown or max(shown) < _LEAST_SHOWN:
            break
        taken[free[int(np.argmax(shown))]] = True
    return taken, near_m


def _passes(images: TrainingSet, fraction: float) -> Iterator[Int64[np.ndarray, " p"]]:
    """Candidates for holding out, images in order of time: whole walks, or segments of few walks."""
    walk = images.walk
    numbers = np.unique(walk)
    for number in numbers:
        own = np.flatnonzero(walk == number)
        own = own[np.argsort(images.times_ns[own], kind="stable")] if images.walks else own
        length = len(own)
        if len(numbers) < WHOLE_OF:
            length = min(max(int(fraction * len(walk)), 2), length)
        for first in range(0, len(own) - length + 1, max(length // 4, 1)):
            yield np.sort(own[first : first + length])


def _touching(
    way: Float64[np.ndarray, " n"], walk: Int64[np.ndarray, " n"], mask: Bool[np.ndarray, " n"]
) -> Bool[np.ndarray, " n"]:
    """Images next to the mask: between the two the camera does not move to elsewhere."""
    touching = np.zeros(len(mask), bool)
    for number in np.unique(walk[mask]):
        own = np.flatnonzero(walk == number)
        at = np.sort(way[own[mask[own]]])
        after = np.searchsorted(at, way[own])
        gaps = np.abs(at[np.clip([after - 1, after], 0, len(at) - 1)] - way[own])
        touching[own] = gaps.min(axis=0) < 1.0
    return touching & ~mask


def long_runs(
    mask: Bool[np.ndarray, " n"], way: Float64[np.ndarray, " n"], sequence: Int64[np.ndarray, " n"]
) -> Bool[np.ndarray, " n"]:
    """The runs of a mask in which the camera moves to elsewhere."""
    kept = np.zeros(len(mask), bool)
    for run in runs(mask, sequence):
        kept[run] = way[run.stop - 1] - way[run.start] >= 1.0
    return kept


def _in_words(images: TrainingSet, mask: Bool[np.ndarray, " n"]) -> str:
    """The images of a mask by recording, in words."""
    parts = []
    for number in np.unique(images.sequence[mask]):
        own = np.flatnonzero(images.sequence == number)
        name = images.names[number]
        if mask[own].all():
            parts.append(f"{name} ({len(own)} images)")
            continue
        own_runs = [run for run in runs(mask, images.sequence) if images.sequence[run.start] == number]
        parts.append(f"{name}, images {describe_runs(own_runs, images.number)}")
    return listed(parts, _NAMED, "; ")
