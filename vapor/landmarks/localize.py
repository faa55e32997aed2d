"""An image and a map -> poses of the camera, each verified by landmarks.

Sources: Arandjelović and Zisserman, "All about VLAD", CVPR 2013 (retrieval); Sattler, Leibe and Kobbelt, "Efficient and
effective prioritized matching", 2017 (guided matching); Larsson et al., PoseLib (P3P in locally optimised RANSAC).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import poselib
from jaxtyping import Bool, Float64, Int64, UInt8

from filtering.mapped_views import MappedViews
from filtering.se3 import Poses
from sequences.frame import Camera
from vapor.landmarks.features import Features, extract, mutual_matches, mutual_matches_among, restored, within
from vapor.landmarks.landmark_map import LEAST_INLIERS, LandmarkMap
from vapor.landmarks.points import by_pose, seen

INLIER_PX = 3.0
"""Greatest distance, pixels, between a feature and the projection of its point that agree."""
ROBUST_PX = 1.0
"""Scale of the robust (Cauchy) cost of refinements, pixels."""
_LEAST_SUPPORT = 8  # least number of matches that agree with a pose
_TRIES = {"max_reproj_error": INLIER_PX, "max_iterations": 1000, "min_iterations": 50, "seed": 0}
_LOSS = {"loss_type": "CAUCHY", "loss_scale": ROBUST_PX}
_RATIO = 0.9  # of the distances of a feature's nearest and second nearest descriptor of the map, in a match
_COSINE = 0.65  # of the descriptors of a match that lies where it must be
_QUERY_PX, _FEATURES = 230, 300
_ALIKE = 16  # key images that look most like an image
_NEAR = 6  # key images nearest to a pose that is proposed
_SHARED = 8  # points that key images of one place share
_KNOWN = 0.2  # fraction of a key image's points near a verified pose, above which it is skipped
_MOST_PLACES = 8  # searched places
_MOST_POINTS = 1000  # matched points of a place
_LEAST_MATCHES = 8
_GUIDED_PX = 5.0
_GUIDED_FROM = 20  # key images near a pose, whose points are looked for
_DAMPING, _MOST_CONDITION = 1e-9, 1e12
_ROUNDS = 6
_LOOKS_ALONG = 0.7  # cosine between the axes of two cameras that may show the same
_APART = 0.25, 0.2  # depths and radians: poses within are one


def lo_ransac(pixels: Float64[np.ndarray, "n 2"], points: Float64[np.ndarray, "n 3"], camera: Camera) -> Poses | None:
    """camera_from_world that most matches of undistorted pixels and points agree with; None where hardly any do."""
    pinhole = {
        "model": "PINHOLE",
        "width": camera.width,
        "height": camera.height,
        "params": [camera.fx, camera.fy, camera.cx, camera.cy],
    }
    pose, report = poselib.estimate_absolute_pose(pixels, points, pinhole, _TRIES, _LOSS)
    if report["num_inliers"] < _LEAST_SUPPORT:
        return None
    return Poses(np.asarray(pose.R, np.float64), np.asarray(pose.t, np.float64)).orthonormal()


@dataclass(frozen=True)
class VerifiedPose:
    """A pose from which landmarks are seen where an image shows them.

    Attributes:
        world_from_camera: One pose.
        covariance: Of ξ = (v, ω) in its tangent, metres and radians, from the residuals.
        inliers: Number of landmarks that agree.
        pixels: Their undistorted pixels in the image.
        residuals: Projections from the pose minus these.
    """

    world_from_camera: Poses
    covariance: Float64[np.ndarray, "6 6"]
    inliers: int
    pixels: Float64[np.ndarray, "k 2"]
    residuals: Float64[np.ndarray, "k 2"]


def query_features(view: UInt8[np.ndarray, "h w"]) -> Features:
    """Features of a grey image to be localized, with SIFT's 128 numbers."""
    return extract(view, _FEATURES, longest=_QUERY_PX)


class LandmarkLocalizer:
    """Finds the poses from which images show landmarks, without looking in ignored key images (n,)."""

    def __init__(self, landmarks: LandmarkMap, ignored: Bool[np.ndarray, " n"] | None = None) -> None:
        self.landmarks = landmarks
        self._ignored = np.zeros(len(landmarks.poses), bool) if ignored is None else ignored

    @cached_property
    def _times_shown(self) -> Int64[np.ndarray, " p"]:
        return np.bincount(self.landmarks.shown, minlength=len(self.landmarks.points))

    def features(self, view: UInt8[np.ndarray, "h w"], *, distorted: bool = True) -> Features:
        """Features of a grey image of the map's camera, distorted or not, at undistorted pixels."""
        return self.described(query_features(view), distorted=distorted)

    def described(self, found: Features, *, distorted: bool = True) -> Features:
        """Features from `query_features` in the basis of the map, at undistorted pixels."""
        reduced = self.landmarks.basis.reduced(found)
        if not distorted:
            return reduced
        return Features(self.landmarks.camera.undistorted(reduced.pixels), reduced.descriptors)

    def localize(self, features: Features, proposed: Poses | None = None) -> list[VerifiedPose]:
        """Verified poses, by decreasing number of landmarks.

        Args:
            features: From `features`.
            proposed: Poses near which the map is searched, beside similar key images, (k,), the likeliest first.
        """
        found: list[VerifiedPose] = []
        if len(features) < LEAST_INLIERS:
            return found
        shown = np.zeros(len(self.landmarks.points), bool)  # where poses are that are verified
        for images in self._places(features, proposed):
            own = self.landmarks.shown_by(images[0])
            if np.count_nonzero(shown[own]) > _KNOWN * len(own):
                continue
            points = self._points_of(images)
            a, b = mutual_matches(features.descriptors, restored(self.landmarks.descriptors[points]), _RATIO)
            if len(a) < _LEAST_MATCHES:
                continue
            at = self.landmarks.points[points[b]].astype(np.float64)
            pose = lo_ransac(features.pixels[a], at, self.landmarks.camera.camera)
            if pose is None or self._is_known(pose.inverse(), found):
                continue
            verified = self._refined(features, pose)
            if verified is not None and not self._is_known(verified.world_from_camera, found):
                found.append(verified)
                for image in self._near(verified.world_from_camera, _NEAR).tolist():
                    shown[self.landmarks.shown_by(image)] = True
        return sorted(found, key=lambda each: -each.inliers)

    def _places(self, features: Features, proposed: Poses | None) -> list[list[int]]:
        m = self.landmarks
        likeness = m.summaries @ m.summary(features)
        likeness[self._ignored] = -np.inf
        order = np.argpartition(-likeness, min(_ALIKE, len(likeness)) - 1)[:_ALIKE]
        order = order[np.argsort(-likeness[order], kind="stable")]
        groups = self._grouped(order[np.isfinite(likeness[order])].tolist())
        looked_at, proposals = [set(group) for group in groups], []
        for pose in () if proposed is None else (proposed[i] for i in range(len(proposed))):
            near = self._near(pose, _NEAR).tolist()
            if near and not any(group & set(near[:3]) for group in looked_at):
                proposals.append(near)
                looked_at.append(set(near))
        return [*groups[:1], *proposals, *groups[1:]][:_MOST_PLACES]

    def _grouped(self, images: Sequence[int]) -> list[list[int]]:
        groups: list[list[int]] = []
        marks: list[Bool[np.ndarray, " p"]] = []
        for image in images:
            own = self.landmarks.shown_by(image)
            for group, mark in zip(groups, marks, strict=True):
                if np.count_nonzero(mark[own]) >= _SHARED:
                    group.append(image)
                    mark[own] = True
                    break
            else:
                mark = np.zeros(len(self.landmarks.points), bool)
                mark[own] = True
                groups.append([image])
                marks.append(mark)
        return groups

    def ignoring(self, ignored: Bool[np.ndarray, " n"]) -> LandmarkLocalizer:
        """A localizer that ignores these key images, too."""
        return LandmarkLocalizer(self.landmarks, self._ignored | ignored)

    def view_distances(self, pose: Poses) -> Float64[np.ndarray, " n"]:
        """Distance of key images from a pose's view: 1 is a depth or a radian, infinite if they show none of it."""
        poses = self.landmarks.poses
        along = poses.rotation[:, :, 2] @ pose.rotation[:, 2]
        away = poses.translation - pose.translation
        distance = np.sqrt(np.vecdot(away, away) / self.landmarks.depth_m**2 + np.maximum(2.0 * (1.0 - along), 0.0))
        distance[(along < _LOOKS_ALONG) | self._ignored] = np.inf
        return distance

    def mapped(self, reach: float = 1.0, elsewhere: float = 0.0) -> MappedViews:
        """The views that are searched, see `MappedViews`."""
        return self.landmarks.mapped(reach, elsewhere, self._ignored)

    def _near(self, pose: Poses, most: int) -> Int64[np.ndarray, " k"]:
        cost = self.view_distances(pose)
        order = np.argsort(cost, kind="stable")[:most]
        return order[np.isfinite(cost[order])]

    def _points_of(self, images: Sequence[int] | Int64[np.ndarray, " k"]) -> Int64[np.ndarray, " q"]:
        m = self.landmarks
        rows = [m.shown_by(int(image)) for image in images]
        if not rows:
            return np.empty(0, np.int64)
        points, times = np.unique(np.concatenate(rows), return_counts=True)
        if len(points) > _MOST_POINTS:
            order = np.lexsort([-self._times_shown[points], -times])[:_MOST_POINTS]
            points = points[order]
        return points.astype(np.int64)

    def _refined(self, features: Features, camera_from_world: Poses) -> VerifiedPose | None:
        m, camera = self.landmarks, self.landmarks.camera
        points = self._points_of(self._near(camera_from_world.inverse(), _GUIDED_FROM))
        found = seen(camera_from_world, m.points[points].astype(np.float64))
        at = found.at * camera.focal + camera.centre
        inside = (found.inverse_depth > 0.0) & ((at > -0.5) & (at < camera.size - 0.5)).all(axis=1)
        points = points[inside]
        a, b = within(features.pixels, at[inside], _GUIDED_PX)
        likeness = np.vecdot(features.descriptors[a], restored(m.descriptors[points[b]]))
        alike = likeness > _COSINE
        a, b = mutual_matches_among(likeness[alike], a[alike], b[alike])
        if len(a) < LEAST_INLIERS:
            return None
        pixels, at = features.pixels[a], m.points[points[b]].astype(np.float64)
        information = np.eye(6)
        for _ in range(_ROUNDS):
            found = seen(camera_from_world, at)
            residual = found.at * camera.focal + camera.centre - pixels
            weight = 1.0 / (1.0 + np.square(residual).sum(axis=1) / ROBUST_PX**2)
            jacobian = camera.focal[:, None] * by_pose(found)
            weighted = (jacobian * weight[:, None, None]).reshape(-1, 6)
            information = weighted.T @ jacobian.reshape(-1, 6)
            try:
                step = -np.linalg.solve(
                    information + _DAMPING * np.diag(information.diagonal()), weighted.T @ residual.ravel()
                )
            except np.linalg.LinAlgError:  # of points that lie almost in one place
                return None
            if not np.abs(step[:3]).max() < m.depth_m or not np.abs(step[3:]).max() < 1.0:
                return None
            camera_from_world = Poses.exp(step) @ camera_from_world
            if np.abs(step).max() < 1e-5:
                break
        camera_from_world = camera_from_world.orthonormal()
        residual = seen(camera_from_world, at).at * camera.focal + camera.centre - pixels
        inlier = np.square(residual).sum(axis=1) < INLIER_PX**2
        if np.count_nonzero(inlier) < LEAST_INLIERS:
            return None
        spread = float(np.square(residual[inlier]).sum() / (2.0 * np.count_nonzero(inlier) - 6.0))
        if not np.linalg.cond(information) < _MOST_CONDITION:
            return None
        covariance = spread * np.linalg.inv(information)
        return VerifiedPose(
            camera_from_world.inverse(),
            0.5 * (covariance + covariance.T),
            int(np.count_nonzero(inlier)),
            pixels[inlier],
            residual[inlier],
        )

    def disagreeing(self, features: Features, pose: Poses) -> Float64[np.ndarray, "m 2"]:
        """Undistorted pixels of features that match points near a pose (world_from_camera) but are not where it is."""
        m, camera = self.landmarks, self.landmarks.camera
        points = self._points_of(self._near(pose, _NEAR))
        a, b = mutual_matches(features.descriptors, restored(m.descriptors[points]), _RATIO)
        found = seen(pose.inverse(), m.points[points[b]].astype(np.float64))
        off = np.linalg.norm(found.at * camera.focal + camera.centre - features.pixels[a], axis=1)
        return features.pixels[a[(off > INLIER_PX) | (found.inverse_depth <= 0.0)]]

    def _is_known(self, pose: Poses, found: Sequence[VerifiedPose]) -> bool:
        if not found:
            return False
        metres, turned = Poses.stack([each.world_from_camera for each in found]).distance(pose)
        return bool(((metres < _APART[0] * self.landmarks.depth_m) & (turned < _APART[1])).any())
