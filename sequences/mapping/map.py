"""Videos of a place -> a folder of images with their poses, in COLMAP's layout."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float64

from filtering.errors import counted
from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.mapping.alignment import Scale, find_scale, require_moments, upright
from sequences.mapping.colmap import LEAST, Progress, Reconstructed, reconstruct, require_pycolmap
from sequences.mapping.config import MapConfig
from sequences.mapping.diagnosis import what_is_missing, why_no_model
from sequences.mapping.walks import Walk, read_walks
from sequences.options import SequenceOptions
from sequences.outputs import require_replaceable, results_folder

if TYPE_CHECKING:
    import pycolmap

RESULTS = ("images", "sparse", "map.json", "intrinsics.json")
"""Names in a folder that `map_images` writes."""
_LITTLE_PARALLAX_DEG = 1.5  # median angle between the rays to a point
_WIDE_SPREAD = 0.1  # of the scale, from part to part of a walk


@dataclass(frozen=True)
class MapResult:
    """What became of images.

    Attributes:
        images: How many were used.
        placed: How many have a pose.
        walks: How many of how many, by the name of the walk.
        scale: Where the unit is from.
        points: How many points there are.
        error_px: Mean reprojection error.
        notices: Sentences for users.
    """

    images: int
    placed: int
    walks: dict[str, tuple[int, int]]
    scale: Scale
    points: int
    error_px: float
    notices: tuple[str, ...]


def map_images(
    inputs: Sequence[Path],
    output: Path,
    config: MapConfig | None = None,
    *,
    reading: SequenceOptions | None = None,
    command: str = "",
    overwrite: bool = False,
    reads: Iterable[Path] = (),
    progress: Progress = lambda stage, done, total: None,
) -> MapResult:
    """Place the images of walks through one place in one model, and write it with them.

    The folder has COLMAP's layout, which `sequences.datasets` reads: `images/` with a folder for each walk, whose
    images are named by their times where these are known, and `sparse/0/`; beside them `map.json`, and
    `intrinsics.json` where all images are of one camera. Z is up as far as cameras were held upright, the origin is the
    first placed image. The same inputs give the same images and matches, and nearly the same poses.

    Args:
        inputs: Videos, folders of images, data sets or recordings; each continuous one is a walk.
        output: The folder, new or an earlier map.
        config: How many images, and what the scale is from.
        reading: What to read of recordings.
        command: The command, for the manifest.
        overwrite: Take any folder, and replace what has the names of the results.
        reads: Further files that are read, never replaced.
        progress: Called with the stage, how much of it is done, and of how much.

    Raises:
        SequenceError: pycolmap is not installed, an input cannot be read, or too few images fit together; the message
            says why.
    """
    config, reads = config or MapConfig(), [*inputs, *reads]
    require_pycolmap()
    require_replaceable(output, RESULTS, reads, overwrite=overwrite)
    with results_folder(output, command, writes=RESULTS, reads=reads, overwrite=overwrite) as folder:
        images, work = folder / "images", folder.parent / "work"
        walks = read_walks(
            inputs, images, config, reading, progress=lambda read: progress("choosing images", read, None)
        )
        total = sum(len(walk.pictures) for walk in walks)
        if total < LEAST:
            raise SequenceError(f"{_names(inputs)}: {counted(total, 'image')}, expected at least {LEAST}")
        require_moments(walks, config)
        work.mkdir()
        found = reconstruct(walks, images, work, progress)
        if (model := found.model) is None:
            raise SequenceError(f"{_names(inputs)}: no image could be placed: {why_no_model(walks, found)}")
        scale = _align(model, walks, config)
        (folder / "sparse" / "0").mkdir(parents=True)
        model.write_binary(folder / "sparse" / "0")
        result = _result(walks, found, model, scale)
        _write_intrinsics(model, folder / "intrinsics.json")
        text = json.dumps(asdict(result), indent=2, ensure_ascii=False)
        (folder / "map.json").write_text(f"{text}\n", encoding="utf-8")
    return result


def _align(model: pycolmap.Reconstruction, walks: Sequence[Walk], config: MapConfig) -> Scale:
    """Bring a model to metres, z up, with its origin at the first image."""
    pycolmap = require_pycolmap()
    placed = _placed(model)
    cameras = Poses.stack([placed[p.name] for walk in walks for p in walk.pictures if p.name in placed])
    scale = find_scale(walks, placed, config, _median_depth(model, cameras))
    rotation = upright(cameras)
    shift = -scale.factor * rotation @ cameras.translation[0]
    model.transform(pycolmap.Sim3d(scale.factor, pycolmap.Rotation3d(rotation), shift))
    return scale


def _placed(model: pycolmap.Reconstruction) -> dict[str, Poses]:
    """world_from_camera by the name of the image."""
    camera_from_world = {each.name: each.cam_from_world().matrix() for each in model.images.values() if each.has_pose}
    return {name: Poses(pose[:, :3], pose[:, 3]).inverse() for name, pose in camera_from_world.items()}


def _median_depth(model: pycolmap.Reconstruction, cameras: Poses) -> float:
    points = np.array([point.xyz for point in model.points3D.values()])
    some = points[:: max(len(points) // 1000, 1)]
    depths = [(camera.inverse().apply(some))[:, 2] for camera in (cameras[i] for i in range(len(cameras)))]
    ahead = np.concatenate(depths)
    return float(np.median(ahead[ahead > 0.0]))


def _result(walks: Sequence[Walk], found: Reconstructed, model: pycolmap.Reconstruction, scale: Scale) -> MapResult:
    names = [picture.name for walk in walks for picture in walk.pictures]
    kept = _placed(model).keys()
    placed = np.array([name in kept for name in names])
    index = {name: i for i, name in enumerate(names)}
    others = [[index[name] for name in part] for part in found.others]
    notices = [*what_is_missing(walks, placed, others, found.matches), *_said_of_scale(scale)]
    if (angle := _median_parallax(model)) < _LITTLE_PARALLAX_DEG:
        notices.append(f"little parallax ({angle:.1f}° at the median point): distances are uncertain, walk sideways")
    counts = {w.name: (sum(p.name in kept for p in w.pictures), len(w.pictures)) for w in walks}
    error_px = float(model.compute_mean_reprojection_error())
    return MapResult(len(names), int(placed.sum()), counts, scale, model.num_points3D(), error_px, tuple(notices))


def _said_of_scale(scale: Scale) -> list[str]:
    if not scale.source:
        return [
            "the unit is arbitrary: no odometry, poses or measured distance. It is such that what is seen is 3 units"
            " away (median). Positions and errors are in this unit, and odometry in metres will not fit; --distance-m"
            " states one distance"
        ]
    if scale.spread is not None and scale.spread > _WIDE_SPREAD:
        return [
            f"the scale varies by {100 * scale.spread:.0f} % from part to part of the walks: {scale.source} and images"
            " do not agree; perhaps places that look alike were taken for one, or wheels slipped"
        ]
    return []


def _median_parallax(model: pycolmap.Reconstruction) -> float:
    """Angle between the outermost rays to a point, degrees, at the median point."""
    centres = {image_id: image.projection_center() for image_id, image in model.images.items() if image.has_pose}
    points = [*model.points3D.values()]
    angles = [
        _widest(np.array([centres[e.image_id] for e in point.track.elements]) - point.xyz)
        for point in points[:: max(len(points) // 1000, 1)]
    ]
    return float(np.degrees(np.median(angles)))


def _widest(rays: Float64[np.ndarray, "k 3"]) -> float:
    unit = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    return float(np.arccos(np.clip(unit @ unit.T, -1.0, 1.0).min()))


def _write_intrinsics(model: pycolmap.Reconstruction, file: Path) -> None:
    """As `intrinsics.json`, where all images are of one camera; the first pixel's centre is at (0, 0) there."""
    if len(model.cameras) != 1:
        return
    (camera,) = model.cameras.values()
    fx, fy = camera.focal_length_x, camera.focal_length_y
    stated = {"width": camera.width, "height": camera.height, "fx": fx, "fy": fy}
    stated |= {"cx": camera.principal_point_x - 0.5, "cy": camera.principal_point_y - 0.5}
    distortion = {"distortion": [camera.params[3], 0.0, 0.0, 0.0]} if camera.model.name == "SIMPLE_RADIAL" else {}
    file.write_text(f"{json.dumps(stated | distortion, indent=2)}\n", encoding="utf-8")


def _names(inputs: Sequence[Path]) -> str:
    return ", ".join(map(str, inputs[:3])) + (" and others" if len(inputs) > 3 else "")
