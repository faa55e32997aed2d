"""Training images with known poses -> a map of landmarks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64, UInt8
from scipy.linalg import eigh

from filtering.se3 import Poses
from sequences.datasets.points import SeenPoints
from sequences.frame import Camera
from vapor.landmarks.adjustment import Adjusted, adjusted
from vapor.landmarks.features import Basis, Features, extract, mutual_matches, stored, unit_vectors
from vapor.landmarks.landmark_map import LandmarkMap, ViewCamera, summed_up
from vapor.landmarks.localize import query_features
from vapor.landmarks.points import Sightings, parallax, seen, summed, triangulated
from vapor.landmarks.tracks import (
    RATIO,
    Matches,
    at_given_points,
    find_sightings,
    neighbours,
    typical_depth_m,
    with_given_points,
)

VIEW_PX = 320
"""Longer edge of the images that features are found in."""
_FEATURES, _LEAST_FEATURES, _MOST_FEATURES = 800, 250, 1_200_000  # of a key image, and of all
_NEW_VIEW, _NEW_VIEW_RAD = 0.06, np.deg2rad(4.0)  # least distance of key images, in depths and radians
_MOST_KEYS = 6000
_WORDS, _SUMMARY = 32, 64
_SAMPLED, _OF_IMAGES = 20_000, 200  # descriptors, and their images, from which components and words are found
_WORD_ROUNDS = 15
_AGREES_PX, _LEAST_AGREEING = 1.5, 0.2  # matches whose rays meet: of images of another place one in forty do
_MOST_PX = 4.0  # that rays of a match may miss each other by
_OUTLIERS_PX = (8.0, 6.0, 4.0, 3.0, 2.5)  # sightings that are further off are left out, from round to round
_LEAST_PARALLAX = np.deg2rad(1.5)
_LEAST_POINTS = 50  # of a map
_LEAST_DEPTH = 0.02  # in median depths
_MOST_BYTES, _MOST_BYTES_OF_ALL = 18_000, 27_000_000  # of the map, a key image and all
_BYTES_OF_POINT, _BYTES_OF_SIGHTING = 76, 4
_POSE_STD = 0.01  # depths and radians: what poses are taken to err by at first where the camera is found
_STATED_WITHIN = 0.015  # image widths: nearer to the stated one, a principal point is what errors of poses make of it
_SAMPLED_KEYS, _RUN = 150, 25  # key images in which it is found, and how many in a row

Advance = Callable[[int, int], None]
Given = Callable[[int], SeenPoints | None]
View = Callable[[int], UInt8[np.ndarray, "h w"]]


@dataclass(frozen=True)
class Material:
    """n training images, and the features of the key images among them.

    Attributes:
        truth: world_from_camera of all images, (n,), in order of time.
        sequence: Index of the sequence of each image, (n,).
        query: Gives the features of an image that is to be localized, by its number.
        camera: Camera of the images, at their size, stated or guessed.
        stated: Stated camera of the images, at their size; None without one.
        key: Numbers of the key images, in order.
        poses: world_from_camera of the key images, (k,).
        features: Features of each key image, in the basis.
        descriptors: Their descriptors, image by image, (f, d).
        basis: Basis of the descriptors.
        matches: Matching features of pairs of key images, by their index in `key`.
        depth_m: Median distance of the scene, metres.
    """

    truth: Poses
    sequence: Int64[np.ndarray, " n"]
    query: Callable[[int], Features]
    camera: Camera
    stated: Camera | None
    key: Int64[np.ndarray, " k"]
    poses: Poses
    features: tuple[Features, ...]
    descriptors: Float32[np.ndarray, "f d"]
    basis: Basis
    matches: Matches
    depth_m: float


@dataclass(frozen=True)
class BuiltMap:
    """A map of points and its material; `agreeing` is the fraction of matches whose rays meet."""

    material: Material
    camera: ViewCamera
    points: Float64[np.ndarray, "p 3"]
    sightings: Sightings
    agreeing: float

    @cached_property
    def landmarks(self) -> LandmarkMap:
        """The map for localization."""
        return self._map(np.ones(len(self.material.key), bool), self.points, self.sightings)

    def hiding(self, hidden: Bool[np.ndarray, " k"]) -> LandmarkMap:
        """The map without the hidden key images: their sightings are dropped, and the points triangulated again.

        Matches, basis and camera are of all images.
        """
        touched = np.zeros(len(self.points), bool)
        touched[self.sightings.point[hidden[self.sightings.view]]] = True
        left, kept = self.sightings.kept(~hidden[self.sightings.view])
        points = self.points[kept].copy()
        of, again = left.kept(touched[kept][left.point], least=1)
        if len(again):
            poses = self.material.poses.inverse()
            points[again] = triangulated(poses, self.camera.rays(of.pixels), of)
            usable = np.ones(len(points), bool)
            usable[again] = parallax(poses, points[again], of) >= _LEAST_PARALLAX
            usable[again] &= np.isfinite(points[again]).all(axis=1)
            left, kept = left.kept(usable[left.point])
            points = points[kept]
        return self._map(~hidden, points, left)

    def _map(
        self, used: Bool[np.ndarray, " k"], points: Float64[np.ndarray, "p 3"], sightings: Sightings
    ) -> LandmarkMap:
        material = self.material
        number = np.cumsum(used) - 1
        order = np.argsort(sightings.view, kind="stable")
        view = number[sightings.view[order]]
        begins = np.searchsorted(view, np.arange(used.sum() + 1))
        words, summary_axes, summaries = self._words
        poses = material.poses[np.flatnonzero(used)]
        sums = summed(material.descriptors[sightings.feature], sightings.point, len(points))
        descriptors = unit_vectors(sums.astype(np.float32))
        return LandmarkMap(
            material.stated,
            self.camera,
            material.depth_m,
            points.astype(np.float32),
            stored(descriptors),
            poses.rotation.astype(np.float32),
            poses.translation.astype(np.float32),
            begins.astype(np.int32),
            sightings.point[order].astype(np.int32),
            material.basis.mean,
            material.basis.axes,
            words,
            summary_axes,
            summaries[used],
        )

    @cached_property
    def _words(self) -> tuple[Float32[np.ndarray, "w d"], Float32[np.ndarray, "v k"], Float32[np.ndarray, "n k"]]:
        rng = np.random.default_rng(0)
        sampled = _sampled(self.material.features, rng)
        count = min(_WORDS, len(sampled))
        stop = (cv2.TERM_CRITERIA_MAX_ITER, _WORD_ROUNDS, 0)
        cv2.setRNGSeed(0)
        words = np.asarray(cv2.kmeans(sampled, count, None, stop, 1, cv2.KMEANS_PP_CENTERS)[2], np.float32)  # pyright: ignore
        whole = np.stack([summed_up(each.descriptors, words) for each in self.material.features])
        size = whole.shape[1]
        _, axes = eigh(whole.T @ whole, subset_by_index=(max(0, size - _SUMMARY), size - 1))
        axes = axes[:, ::-1].astype(np.float16).astype(np.float32)
        return words, axes, unit_vectors(whole @ axes)


def gather(
    view: View,
    poses: Poses,
    camera: Camera,
    *,
    sequence: Int64[np.ndarray, " n"] | None = None,
    stated: bool = True,
    scale_m: float,
    given: Given = lambda image: None,
    advance: Advance | None = None,
) -> Material | None:
    """Choose key images and find their features; None where no two images show the same from two sides.

    Args:
        view: Gives a grey training image by its number, in order of time.
        poses: world_from_camera of the n training images.
        camera: Camera of the images, at their size.
        sequence: Index of the sequence of each image, (n,); None for one sequence.
        stated: Whether the camera is stated, or a guess.
        scale_m: Initial distance that changes a view as much as a radian.
        given: Gives the points of a reconstruction in a training image, by its number, if any.
        advance: Called with the number of key images done, and of all.
    """

    @cache
    def raw(image: int) -> Features:
        return extract(view(image), _FEATURES, longest=VIEW_PX)

    depth_m = typical_depth_m(poses, raw, ViewCamera(camera), scale_m=scale_m)
    if depth_m is None:
        return None
    key = _key_images(poses, depth_m)
    some = np.linspace(0, len(key) - 1, min(len(key), _OF_IMAGES)).round().astype(np.int64)
    known = {image: raw(image) for image in key[some].tolist()}
    raw.cache_clear()  # what all images show is too much to be kept as it is
    sampled = _sampled([*known.values()], np.random.default_rng(0))
    if len(sampled) < _LEAST_POINTS:
        return None
    basis = Basis.of(sampled)
    count = int(np.clip(_MOST_FEATURES / len(key), _LEAST_FEATURES, _FEATURES))
    known, reduced = known if count == _FEATURES else {}, []
    for image in key.tolist():
        reduced.append(basis.reduced(known.pop(image, None) or extract(view(image), count, longest=VIEW_PX)))
        if advance is not None:
            advance(len(reduced), len(key))
    own = poses[key]
    pairs = {(min(i, j), max(i, j)) for i, others in neighbours(own, depth_m) for j in others.tolist()}
    matches = {(i, j): mutual_matches(reduced[i].descriptors, reduced[j].descriptors, RATIO) for i, j in sorted(pairs)}
    at = ViewCamera(camera)
    descriptors = np.concatenate([each.descriptors for each in reduced])
    parts = np.split(descriptors, np.cumsum([len(each) for each in reduced])[:-1])
    reduced = [replace(each, descriptors=part) for each, part in zip(reduced, parts, strict=True)]
    placed = [at_given_points(each, given(image), at) for each, image in zip(reduced, key.tolist(), strict=True)]
    matches = with_given_points(matches, [points for _, points in placed])
    return Material(
        poses,
        np.zeros(len(poses), np.int64) if sequence is None else sequence,
        cache(lambda image: query_features(view(image))),
        camera,
        camera if stated else None,
        key,
        own,
        tuple(each for each, _ in placed),
        descriptors,
        basis,
        matches,
        depth_m,
    )


def build(material: Material, camera: ViewCamera) -> BuiltMap | None:
    """The points that key images show; None where there are hardly any, or poses do not fit.

    Poses are kept as stated: adjusted poses localized no better, as errors are measured against the stated ones.
    """
    sightings, errors = find_sightings(
        material.poses, material.features, camera, material.matches, depth_m=material.depth_m, most_px=_MOST_PX
    )
    agreeing = float((errors < _AGREES_PX).mean()) if len(errors) else 0.0
    if agreeing < _LEAST_AGREEING:
        return None
    poses = material.poses.inverse()
    points, sightings = _points(camera, poses, sightings, material.depth_m, _OUTLIERS_PX)
    fine = parallax(poses, points, sightings) >= _LEAST_PARALLAX
    sightings, kept = sightings.kept(fine[sightings.point])
    points = points[kept]
    if len(points) < _LEAST_POINTS:
        return None
    sightings, kept = sightings.kept(_within_memory(sightings, len(points))[sightings.point])
    return BuiltMap(material, camera, points[kept], sightings, agreeing)


def camera_found(material: Material, stated: ViewCamera) -> Adjusted | None:
    """The camera that fits some of the key images and their poses; None where too few show the same."""
    keys = np.arange(len(material.key))
    if len(keys) > _SAMPLED_KEYS:  # runs that follow each other, evenly over all
        starts = np.linspace(0, len(keys) - _RUN, _SAMPLED_KEYS // _RUN).astype(np.int64)
        keys = np.unique((starts[:, None] + np.arange(_RUN)).ravel())
    position = {int(k): i for i, k in enumerate(keys.tolist())}
    matches = {
        (position[i], position[j]): matched
        for (i, j), matched in material.matches.items()
        if i in position and j in position
    }
    poses = material.poses[keys]
    features = [material.features[k] for k in keys.tolist()]
    camera_from_world, camera, found = poses.inverse(), stated, None
    std, principal_point = _POSE_STD, True
    for most_px in (16.0, 4.0, 4.0):
        off = np.abs(camera.centre - stated.centre).max() / stated.camera.width
        if found is not None and off < _STATED_WITHIN:
            principal_point = False
            camera = replace(camera, camera=replace(camera.camera, cx=stated.camera.cx, cy=stated.camera.cy))
        sightings, _ = find_sightings(poses, features, camera, matches, depth_m=material.depth_m, most_px=most_px)
        outliers_px = 2.0 * most_px, 1.5 * most_px, most_px
        points, sightings = _points(camera, camera_from_world, sightings, material.depth_m, outliers_px)
        if len(points) < _LEAST_POINTS:
            return None
        pose_std = std * material.depth_m, std
        found = adjusted(
            camera, camera_from_world, points, sightings, pose_std=pose_std, principal_point=principal_point
        )
        camera = found.camera
        away = (found.camera_from_world @ poses).log() / np.repeat([material.depth_m, 1.0], 3)
        std = float(np.clip(np.sqrt(np.square(away).mean()), _POSE_STD / 4.0, 4.0 * _POSE_STD))
    return found


def _points(
    camera: ViewCamera,
    poses: Poses,
    sightings: Sightings,
    depth_m: float,
    outliers_px: Sequence[float],
) -> tuple[Float64[np.ndarray, "p 3"], Sightings]:
    points = np.empty((0, 3))
    for most_px in (*outliers_px, None):
        if not len(sightings):
            return np.empty((0, 3)), sightings
        points = triangulated(poses, camera.rays(sightings.pixels), sightings)
        if most_px is None:
            break
        found = seen(poses[sightings.view], points[sightings.point])
        at = camera.undistorted(sightings.pixels)
        away = np.linalg.norm(found.at * camera.focal + camera.centre - at, axis=1)
        sightings, _ = sightings.kept((away < most_px) & (found.in_camera[:, 2] > _LEAST_DEPTH * depth_m))
    return points, sightings


def _key_images(poses: Poses, depth_m: float) -> Int64[np.ndarray, " k"]:
    wider = 1.0
    while True:
        key: list[int] = []
        for image in range(len(poses)):
            if key:
                metres, turned = poses[image].distance(poses[np.array(key)])
                apart = np.hypot(metres / (_NEW_VIEW * depth_m), turned / _NEW_VIEW_RAD)
                if apart.min() < wider:
                    continue
            key.append(image)
        if len(key) <= _MOST_KEYS:
            return np.array(key)
        wider *= max(1.2, np.sqrt(len(key) / _MOST_KEYS))


def _sampled(features: Sequence[Features], rng: np.random.Generator) -> Float32[np.ndarray, "n d"]:
    some = max(1, _SAMPLED // len(features))
    return np.concatenate([each.descriptors[rng.permutation(len(each))[:some]] for each in features])


def _within_memory(of: Sightings, count: int) -> Bool[np.ndarray, " p"]:
    views = np.bincount(of.point, minlength=count)
    order = np.argsort(-views, kind="stable")
    size = np.cumsum(_BYTES_OF_POINT + _BYTES_OF_SIGHTING * views[order])
    kept = np.zeros(count, bool)
    kept[order[size <= min(_MOST_BYTES * (1 + of.view.max(initial=-1)), _MOST_BYTES_OF_ALL)]] = True
    return kept
