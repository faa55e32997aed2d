"""The unit and the axes of a model: metres by recorded motion or one distance, and z up."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.mapping.config import MapConfig, Moment
from sequences.mapping.walks import Walk

_DRIFT_S = 10.0  # over which odometry is compared with the model
_PARTS = 6  # of a walk, whose scales are compared
_MOVED_M = 0.3  # that a walk must have moved to give a scale
_NEAR_S, _NEAR = 1.0, 1.5  # within which of a moment an image must be placed: seconds, or images without time stamps
_USUAL_DEPTH = 3.0  # units from cameras to points, where no scale is known
_HELD = 0.01  # how much cameras are expected to be held upright, beside not being rolled


@dataclass(frozen=True)
class Scale:
    """How long the unit of a model is.

    Attributes:
        factor: Metres for one unit of the model as COLMAP made it.
        source: Where it is from, in words; '' where it is a guess.
        spread: Standard deviation of the scale of a part of a walk, as a fraction; None where there is one part.
    """

    factor: float
    source: str
    spread: float | None = None


Placed = Mapping[str, Poses]
"""world_from_camera of images by their names, in the unit of the model."""


def find_scale(walks: Sequence[Walk], placed: Placed, config: MapConfig, depth: float) -> Scale:
    """The scale by the measured distance, or else by recorded poses or odometry, or else a guess.

    Args:
        walks: The walks.
        placed: Poses of their images in the model.
        config: The distance, and what it is between.
        depth: Median distance from a camera to the points that it shows, in the model's unit.

    Raises:
        SequenceError: the distance is between moments without a placed image, or at one place.
    """
    if config.distance_m is not None:
        return _by_distance(walks, placed, config)
    for motion in ("poses", "odometry"):
        moved = [walk for walk in walks if walk.motion == motion]
        parts = [part for walk in moved for part in _ratios(walk, placed)]
        if parts:
            scales = np.array(parts)
            middle = float(np.median(scales))
            spread = 1.4826 * float(np.median(np.abs(scales - middle))) / middle if len(parts) > 1 else None
            names = ", ".join(walk.name for walk in moved)
            return Scale(middle, f"recorded {motion} of {names}", spread)
    return Scale(_USUAL_DEPTH / depth, "")


def _ratios(walk: Walk, placed: Placed) -> Iterator[float]:
    """Metres for a unit, of parts of a walk; none where it hardly moved."""
    for times_s, recorded, modelled in _pieces(walk, placed):
        if np.ptp(recorded, axis=0).max() < _MOVED_M:
            continue
        longest_s = np.inf if walk.motion == "poses" else _DRIFT_S
        first, second = np.triu_indices(len(times_s), 1)
        near = times_s[second] - times_s[first] <= longest_s
        first, second = first[near], second[near]
        metres = np.linalg.norm(recorded[second] - recorded[first], axis=1)
        units = np.linalg.norm(modelled[second] - modelled[first], axis=1)
        part = first * _PARTS // len(times_s)
        for number in range(_PARTS):
            of_part = (part == number) & (units > 0.0)
            if metres[of_part].max(initial=0.0) >= _MOVED_M:
                yield _weighted_median(metres[of_part] / units[of_part], units[of_part])


def _pieces(walk: Walk, placed: Placed) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Times in seconds (k,), recorded positions and those in the model (k, 3), without a gap in odometry."""
    rows: dict[int, list[tuple[float, np.ndarray, np.ndarray]]] = {}
    for picture in walk.pictures:
        poses = walk.motion == "poses"
        recorded = picture.world_from_camera if poses else picture.odometry_from_camera
        if recorded is not None and picture.name in placed:
            row = 1e-9 * picture.time_ns, recorded.translation, placed[picture.name].translation
            rows.setdefault(0 if poses else picture.piece, []).append(row)
    for some in rows.values():
        if len(some) > 2:
            times, recorded, modelled = (np.array(column) for column in zip(*some, strict=True))
            yield times, recorded, modelled


def _weighted_median(values: Float64[np.ndarray, " k"], weights: Float64[np.ndarray, " k"]) -> float:
    order = np.argsort(values)
    cumulated = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(cumulated, 0.5 * cumulated[-1])])


def _by_distance(walks: Sequence[Walk], placed: Placed, config: MapConfig) -> Scale:
    assert config.distance_m is not None
    begin, end = (_position(walks, placed, Moment.of(text)) for text in config.between)
    units = float(np.linalg.norm(end - begin))
    moments = " and ".join(config.between)
    # A twentieth of the way that the cameras went: errors of their positions would be a part of the distance.
    extent = float(np.ptp(np.array([pose.translation for pose in placed.values()]), axis=0).max())
    if units < 0.05 * extent:
        raise SequenceError(
            f"--distance-m {config.distance_m:g} is between {moments}, where the camera was at the same place; expected"
            " two places far apart (--between)"
        )
    return Scale(config.distance_m / units, f"{config.distance_m:g} m between {moments}")


def require_moments(walks: Sequence[Walk], config: MapConfig) -> None:
    """Raise SequenceError where a measured distance is between moments of no walk, or behind the end of one."""
    for moment in map(Moment.of, config.between):
        walk = _walk_of(walks, moment)
        last = _last(walk)
        if moment.at > last and moment.at != np.inf:
            raise SequenceError(f"--between {moment.text}: {walk.name} ends at {last:.1f}{_unit(walk)}")


def _walk_of(walks: Sequence[Walk], moment: Moment) -> Walk:
    if moment.walk is None:
        return walks[0]
    names = [walk.name for walk in walks]
    if moment.walk not in names:
        raise SequenceError(f"--between {moment.text}: no such input, expected one of {', '.join(names)}")
    return walks[names.index(moment.walk)]


def _last(walk: Walk) -> float:
    return 1e-9 * (walk.end_ns - walk.begin_ns) if walk.has_stamps else float(walk.pictures[-1].number)


def _unit(walk: Walk) -> str:
    return " s" if walk.has_stamps else ""


def _position(walks: Sequence[Walk], placed: Placed, moment: Moment) -> Float64[np.ndarray, " 3"]:
    """Where the camera was, in the model; between two images on the line between them."""
    walk = _walk_of(walks, moment)
    at = {
        1e-9 * (p.time_ns - walk.begin_ns) if walk.has_stamps else float(p.number): placed[p.name].translation
        for p in walk.pictures
        if p.name in placed
    }
    wanted = min(moment.at, _last(walk))
    nearest = min(at, key=lambda each: abs(each - wanted), default=np.inf)
    if abs(nearest - wanted) > (_NEAR_S if walk.has_stamps else _NEAR):
        near = f"the nearest one is at {nearest:.1f}{_unit(walk)}" if at else "none of it is"
        raise SequenceError(f"--between {moment.text}: no image of {walk.name} is placed there, {near}")
    times, positions = np.array([*at]), np.array([*at.values()])
    return np.array([np.interp(wanted, times, positions[:, axis]) for axis in range(3)])


def upright(cameras: Poses) -> Float64[np.ndarray, "3 3"]:
    """The rotation that makes z up and lets the first camera look along x as far as it is level, x (3, 3).

    Cameras that are not rolled have their x axis level, so the vertical is what is square to all of these, and to
    which they are upright on average.

    Args:
        cameras: world_from_camera, batch (n,), in order of time.
    """
    right, up = cameras.rotation[:, :, 0], -cameras.rotation[:, :, 1].mean(axis=0)
    direction = up / max(float(np.linalg.norm(up)), 1e-9)
    scatter = right.T @ right / len(right) + _HELD * (np.eye(3) - np.outer(direction, direction))
    vertical = np.linalg.eigh(scatter)[1][:, 0]
    z = vertical if vertical @ up >= 0.0 else -vertical
    ahead = cameras.rotation[0, :, 2]
    x = ahead - (ahead @ z) * z
    if np.linalg.norm(x) < 1e-3:  # it looks along the vertical
        x = cameras.rotation[0, :, 0] - (cameras.rotation[0, :, 0] @ z) * z
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])
