"""Whether recordings are good enough to train on, and what to do about it, the most important first."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from filtering.errors import listed
from vapor.inspection.camera import CameraCheck
from vapor.inspection.clocks import ImageClock
from vapor.inspection.coverage import Coverage
from vapor.inspection.odometry import OdometryCheck
from vapor.inspection.predictions import Predictions
from vapor.inspection.walk import Walk
from vapor.training.holding_out import BETWEEN
from vapor.training_data.checks import said_of_bluish_colours, said_of_swapped_colours
from vapor.training_data.views import said_of_focal_length, said_of_views

_FEW_IMAGES = 100
_STANDS_M, _STANDS_RAD = 0.05, float(np.deg2rad(5.0))
_BLURRED, _BADLY_EXPOSED, _FROZEN, _LOST, _JUMPS = 0.1, 0.05, 0.02, 0.05, 0.01  # fractions of a recording
_LONG_GAP_S = 2.0
_ALONE = 0.1  # of all images
_LATE_MS, _IMAGES_LATE_MS = 20.0, 40.0
_SCALE, _CERTAIN = 0.05, 3.0  # the last in standard errors
_TOO_FAST_M_PER_S = 50.0  # for what carries a camera
_DIM = 30.0  # mean of the grey image, of 255
_UNKNOWN = 0.05  # of the images
_SCARCE = 0.5  # of what a storey would have if all had as many images
_NAMED = 3
_MOST = 0.5  # of the images of a recording


@dataclass(frozen=True)
class Verdict:
    """Whether recordings are good enough to train on.

    Attributes:
        faults: What to put right before a training, a sentence each, the most important first.
        advice: What would make the model better, likewise.
    """

    faults: tuple[str, ...]
    advice: tuple[str, ...]

    @property
    def answer(self) -> str:
        """In a sentence."""
        if self.faults:
            which = "the first point" if len(self.faults) == 1 else f"the first {len(self.faults)} points"
            return f"Not good enough to train on yet: put right {which if self.advice else 'what follows'}"
        if self.advice:
            return "Good enough to train on; the points say what would make a better model"
        return "Good enough to train on: nothing found that another recording would mend"

    @property
    def points(self) -> tuple[str, ...]:
        """Faults and advice."""
        return (*self.faults, *self.advice)


def verdict(
    walks: Sequence[Walk],
    coverage: Coverage | None,
    odometry: OdometryCheck | None,
    clocks: Sequence[ImageClock],
    predictions: Predictions | None,
    cameras: Mapping[str, CameraCheck] = {},
) -> Verdict:
    """Judge by all that was found; see `Verdict`."""
    colours = {walk.name: walk.colours for walk in walks}
    faults = [*_useless(walks, coverage), *_clocks(odometry, clocks), *_views(walks, odometry, clocks)]
    if odometry is not None:
        # Images show already which of poses and odometry is turned or left-handed, where one of both agrees with them.
        sides = [{check.is_right for check in walk.checks if check.orientations} for walk in walks]
        faults += _odometry(odometry, is_named=any(len(of_walk) == 2 for of_walk in sides))
    swapped = said_of_swapped_colours(colours)
    faults += swapped
    advice = [] if coverage is None else [*_coverage(coverage)]
    for share, sentence in (each for walk in walks for each in _images(walk)):
        (faults if share > _MOST else advice).append(sentence)
    advice += [*_cameras(cameras), *_focal_lengths(walks, cameras), *_scale(odometry), *_without(walks)]
    advice += [] if swapped else said_of_bluish_colours(colours)
    if coverage is not None and predictions is not None:
        advice += _model(coverage, predictions)
    return Verdict(tuple(faults), tuple(advice))


def _useless(walks: Sequence[Walk], coverage: Coverage | None) -> Iterator[str]:
    for walk in walks:
        if walk.repeated[1:].all() and len(walk) > 1:
            yield f"record {walk.name} again: its {len(walk)} images are all one and the same"
        if not len(walk.poses):
            reason = walk.source.lacks.get("true poses") or next(iter(walk.source.notices), "no image has one")
            yield f"give {walk.name} true poses, which `train` needs: {reason}"
    count, having = sum(map(len, walks)), ""
    if coverage is not None:
        count, having = len(coverage.images), " with true poses"
    if count < _FEW_IMAGES:
        yield f"record more: {count} image{'s' * (count != 1)}{having}, expected some hundreds at least"
    if coverage is None:
        return
    poses = coverage.images.poses
    moved_m, turned = poses.distance(poses[0])
    if count > 1 and moved_m.max() < _STANDS_M and turned.max() < _STANDS_RAD:
        yield (
            f"walk about: the camera does not move (by {100 * moved_m.max():.1f} cm and"
            f" {np.degrees(turned.max()):.1f}° at most)"
        )


def _views(
    walks: Sequence[Walk],
    odometry: OdometryCheck | None,
    clocks: Sequence[ImageClock],
) -> Iterator[str]:
    """Contradictions of images and poses, but for focal lengths, without which the network is trained."""
    explained = {clock.name for clock in clocks if abs(clock.late_ms or 0.0) >= _IMAGES_LATE_MS}
    has_units = odometry is not None and odometry.axes is not None and odometry.axes.unit is not None
    for walk in walks:
        own = [replace(check, focal=None) for check in walk.checks]
        # Views that agree with no orientation do so once clocks are right.
        yield from said_of_views(walk.name, [c for c in own if c.orientations or walk.name not in explained])
        speed = walk.speed_m_per_s
        if speed is not None and speed > _TOO_FAST_M_PER_S and not has_units:
            yield (
                f"check the unit of the poses of {walk.name}: the camera moves at {speed:.3g} m/s in the median; are"
                " they in millimetres?"
            )


def _clocks(odometry: OdometryCheck | None, clocks: Sequence[ImageClock]) -> Iterator[str]:
    """Clocks come first: other faults may follow from them."""
    late_ms = None if odometry is None else odometry.typical_late_ms
    if late_ms is not None and abs(late_ms) >= _LATE_MS:
        yield (
            f"odometry is {late_said(late_ms)} against the true poses: use --time-offset-s auto where these are"
            " a file (--poses), else correct the stamps"
        )
    for clock in clocks:
        if clock.late_ms is not None and abs(clock.late_ms) >= _IMAGES_LATE_MS:
            yield (
                f"the images of {clock.name} are {late_said(clock.late_ms)} against the {clock.against}, by the"
                " motion that they show: correct the stamps, or see whether --stamps log has one clock for all"
            )


def late_said(late_ms: float) -> str:
    """How late a clock is, in words."""
    return f"{abs(late_ms):.0f} ms {'late' if late_ms > 0 else 'early'}" if abs(late_ms) >= 0.5 else "on time"


def _odometry(check: OdometryCheck, *, is_named: bool) -> Iterator[str]:
    axes = check.axes
    if axes is not None and not is_named:
        if axes.is_mirrored:
            yield "check odometry and true poses: one is left-handed, as their motions are each other's mirror images"
        elif axes.is_turned:
            yield (
                "check the extrinsics (tf, --base-from-camera): odometry moves, against the true poses, as if the"
                f" camera were {axes.turn_in_words} on its base"
            )
        elif axes.is_unlike:
            yield (
                f"check odometry and true poses: their motions have little in common (correlation"
                f" {axes.correlation:.2f}), whichever way the axes are turned"
            )
    if axes is not None and axes.unit is not None:
        yield (
            f"check units: odometry is {axes.length_ratio:.4g} m long for each metre of the true poses, as if the"
            f" longer were in {axes.unit} instead of metres"
        )


def _scale(check: OdometryCheck | None) -> Iterator[str]:
    """Training does without odometry."""
    fit = None if check is None else check.fit
    if fit is not None and abs(fit.scale) > max(_SCALE, _CERTAIN * fit.scale_error):
        far = "long" if fit.scale > 0 else "short"
        yield (
            f"check the scale of odometry (wheel radius, baseline) or of the true poses: distances are"
            f" {100 * abs(fit.scale):.0f} % too {far}"
        )


def _coverage(coverage: Coverage) -> Iterator[str]:
    if not coverage.split.held_out_mask.any():
        yield (
            "record another walk over the same ground: nothing can be held out of this, so `train` would assume how"
            " images err, and not find it"
        )
    storeys, several = coverage.storeys(), len(coverage.images.names) > 1
    few = _SCARCE * len(coverage.images) / max(len(storeys), 1)
    lacking = [storey for storey in storeys if storey.images < few or (several and storey.trained <= 1)]
    if lacking:
        yield f"show in another walk: {_first(lacking)}"
    alone = float((coverage.others == 0).mean())
    segments = [segment for segment in coverage.alone() if all(storey.number != segment.storey for storey in lacking)]
    if alone > _ALONE and segments:
        whose = "no other recording shows" if coverage.by_recordings else "no other pass shows"
        until = ""
        if coverage.split.evidence == BETWEEN:
            until = "; until then `train` finds errors only between images that it learned from, not on another walk"
        yield f"walk again over what {whose}, {100 * alone:.0f} % of the images: {_first(segments)}{until}"


def _images(walk: Walk) -> Iterator[tuple[float, str]]:
    """Each with the share of the images that show nothing for it."""
    name = walk.name
    blurred, dark, blown, jumps = (float(each.mean()) for each in (walk.blurred, walk.dark, walk.blown, walk.jumps))
    brightness = float(np.median(walk.looks["brightness"]))
    if blurred > _BLURRED:
        said = f"walk and turn more slowly, or in more light: {100 * blurred:.0f} % of the images of {name} are blurred"
        yield 0.0, said
    if dark > _BADLY_EXPOSED:
        yield dark, f"make light, or expose for longer: {100 * dark:.0f} % of the images of {name} are nearly black"
    elif brightness < _DIM:
        said = f"make light, or expose for longer: the images of {name} are dark, {brightness:.0f} of 255 in the median"
        yield 0.0, said
    if blown > _BADLY_EXPOSED:
        yield blown, f"expose for less long: {100 * blown:.0f} % of the images of {name} are blown out"
    if jumps > _JUMPS and walk.jumps.sum() > 1:
        said = (
            f"fix the exposure, or walk without sudden light: {name} gets half a stop brighter or darker from one image"
            f" to the next {walk.jumps.sum()} times"
        )
        yield 0.0, said
    frozen = sum(last - first for first, last in walk.frozen)
    if frozen > _FROZEN * len(walk) and not walk.repeated[1:].all():
        first, last = max(walk.frozen, key=lambda run: run[1] - run[0])
        said = (
            f"look at the camera's driver: {frozen} images of {name} repeat the one before, such as {first} to {last}"
        )
        yield frozen / len(walk), said
    gaps = walk.gaps
    lost = sum(long_s for _, long_s in gaps)
    if gaps and (gaps[0][1] > _LONG_GAP_S or lost > _LOST * walk.seconds[-1]):
        at_s, long_s = gaps[0]
        said = (
            f"find out why images are missing: {name} has gaps of {lost:.1f} s in all, the longest of {long_s:.1f} s,"
            f" {at_s:.1f} s after its start"
        )
        yield 0.0, said


def _cameras(cameras: Mapping[str, CameraCheck]) -> Iterator[str]:
    for name, camera in cameras.items():
        if camera.disagrees:
            yield (
                f"correct the intrinsics{f' of {name}' if len(cameras) > 1 else ''} (camera_info, intrinsics.json), or"
                f" leave them to `train`, which uses the fitted ones for landmarks: {camera.in_words}"
            )


def _focal_lengths(walks: Sequence[Walk], cameras: Mapping[str, CameraCheck]) -> Iterator[str]:
    """Wrong focal lengths of recordings, where no sentence on the one camera of all says it better."""
    if len(cameras) == 1 and all(camera.disagrees and camera.of_all for camera in cameras.values()):
        return
    for walk in walks:
        yield from said_of_focal_length(walk.name, walk.checks)


def _without(walks: Sequence[Walk]) -> Iterator[str]:
    """Odometry is not needed for training."""
    lacking = [walk for walk in walks if walk.source.recorded and not any(step is not None for step in walk.odometry)]
    alike: dict[tuple[bool, str], list[Walk]] = {}
    for walk in lacking:
        reason = walk.source.lacks.get("odometry", "none is of the time of the images")
        alike.setdefault((bool(walk.source.unused_odometry), reason), []).append(walk)
    for (is_there, reason), some in alike.items():
        names = listed([walk.name for walk in some], _NAMED)
        if is_there:
            sources = {id(walk.source): walk.source for walk in some}.values()
            unused = sum((Counter(source.unused_odometry) for source in sources), Counter())
            there = ", ".join(f"{count} messages of {name}" for name, count in unused.items())
            yield (
                f"make the odometry of {names} usable, {there}: {reason}; training does without, and `run --odometry"
                " visual` makes it from the images, less exactly"
            )
        else:
            yield (
                f"record odometry too: none in {names} ({reason}); training does without, and `run` makes it from the"
                " images, less exactly"
            )


def _model(coverage: Coverage, predictions: Predictions) -> Iterator[str]:
    weak = [place for place in predictions.weak_places(coverage) if place.passes == 1 or place.places <= 1]
    if weak:
        yield f"another walk should show, as the model errs there: {_first(weak)}"
    if predictions.out_of_distribution > _UNKNOWN:
        unlike = (
            f"{100 * predictions.out_of_distribution:.0f} % of the images look unlike all that the model was trained on"
        )
        why = predictions.why_out_of_distribution
        yield f"{unlike}: {why}" if why else f"train on more of this: {unlike}"


def _first(items: Sequence[object]) -> str:
    return listed(items, _NAMED, "; ")
