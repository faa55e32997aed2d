"""Structure from motion by COLMAP: features, matches, and models of the images that match (Schönberger 2016)."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float64, Int64, UInt8

from sequences.errors import SequenceError
from sequences.frame import Camera
from sequences.mapping.pairs import image_pairs
from sequences.mapping.walks import Walk

if TYPE_CHECKING:
    import pycolmap

LEAST = 10
"""Images of a model, at least."""
_FEATURES = 2048  # of an image, at most: more make matching slow, and place few more images
_FOCAL = 0.85  # of the longer edge, a first guess where intrinsics are unknown: about 61° wide
_AT_ONCE = 8, 400  # images and pairs between two reports of progress
_SEED = 0
_FATAL = 3

Progress = Callable[[str, int, int | None], None]
"""Called with a stage, how much of it is done, and of how much."""


@dataclass(frozen=True)
class Match:
    """Two images that show the same, as their geometry confirms.

    Attributes:
        first, second: Their indices.
        count: How many features agree.
        shift: Median way of these from image to image, as a fraction of the image's width.
        turned: Whether a rotation alone explains it.
    """

    first: int
    second: int
    count: int
    shift: float
    turned: bool


@dataclass(frozen=True)
class Reconstructed:
    """What COLMAP made of images.

    Attributes:
        models: Models of images that are connected, that of most images first; each in a unit and frame of its own.
        num_features: Of each image, (n,), in the order of the walks.
        matches: Images that show the same.
    """

    models: Sequence[pycolmap.Reconstruction]
    num_features: Int64[np.ndarray, " n"]
    matches: Sequence[Match]


def require_pycolmap() -> Any:
    """The module `pycolmap`. Raises SequenceError where it is not installed."""
    try:
        found = importlib.import_module("pycolmap")
    except ImportError as error:
        raise SequenceError("pycolmap is not installed, expected it: pip install vapor-track[map]") from error
    found.logging.minloglevel = _FATAL  # it prints what it finds; what matters of it is said in our words
    return found


def reconstruct(walks: Sequence[Walk], images: Path, work: Path, progress: Progress) -> Reconstructed:
    """Models of the images of walks.

    Features and pairs are found by all processors. Placing images is done by one: several would add numbers in another
    order each time, and give another model.

    Args:
        walks: With at least one image.
        images: The folder of their images.
        work: A folder for a database.
        progress: Called in each stage.

    Raises:
        SequenceError: pycolmap is not installed.
    """
    pycolmap = require_pycolmap()
    database = work / "database.db"
    names = [picture.name for walk in walks for picture in walk.pictures]
    constant = _extract(pycolmap, walks, database, images, progress)
    with pycolmap.Database.open(database) as opened:
        ids = {image.name: image.image_id for image in opened.read_all_images()}
        descriptors = [_descriptors(opened, ids.get(name)) for name in names]
    pairs = image_pairs([len(walk.pictures) for walk in walks], descriptors, np.random.default_rng(_SEED))
    _match(pycolmap, database, work, [(names[a], names[b]) for a, b in pairs], progress)
    with pycolmap.Database.open(database) as opened:
        widths = [picture.size[0] for walk in walks for picture in walk.pictures]
        index = {ids[name]: i for i, name in enumerate(names) if name in ids}
        matches = list(_matches(pycolmap, opened, index, widths))
    models = _place(pycolmap, database, images, work, constant, len(names), progress) if matches else []
    return Reconstructed(models, np.array([len(some) for some in descriptors], np.int64), matches)


def _extract(pycolmap: Any, walks: Sequence[Walk], database: Path, images: Path, progress: Progress) -> set[int]:
    """Find the features of all images; gives the ids of the cameras whose intrinsics are known."""
    by_camera: dict[tuple[Camera | None, tuple[int, int]], list[str]] = {}
    for walk in walks:
        for picture in walk.pictures:
            by_camera.setdefault((picture.camera, picture.size), []).append(picture.name)
    constant: set[int] = set()
    readers: list[tuple[Any, list[str]]] = []
    with pycolmap.Database.open(database) as opened:
        for (camera, size), names in by_camera.items():
            camera_id = opened.write_camera(_camera(pycolmap, camera, size))
            if camera is not None:
                constant.add(camera_id)
            reader = pycolmap.ImageReaderOptions()
            reader.existing_camera_id = camera_id
            readers.append((reader, names))
    single = pycolmap.CameraMode.SINGLE
    for reader, names in readers:  # in this order, so that images have the same numbers each time
        pycolmap.import_images(database, images, camera_mode=single, image_names=names, options=reader)
    options = pycolmap.FeatureExtractionOptions()
    options.use_gpu = False
    options.sift.max_num_features = _FEATURES
    done, total = 0, sum(len(names) for _, names in readers)
    for reader, names in readers:
        for some in _parts(names, _AT_ONCE[0]):
            pycolmap.extract_features(
                database,
                images,
                image_names=some,
                camera_mode=single,
                reader_options=reader,
                extraction_options=options,
            )
            done += len(some)
            progress("finding features", done, total)
    return constant


def _camera(pycolmap: Any, camera: Camera | None, size: tuple[int, int]) -> Any:
    """COLMAP has the first pixel's centre at (0.5, 0.5), a `Camera` at (0, 0)."""
    width, height = size
    if camera is not None:
        stated = [camera.fx, camera.fy, camera.cx + 0.5, camera.cy + 0.5]
        found = pycolmap.Camera(model="PINHOLE", width=width, height=height, params=stated)
    else:
        guess = [_FOCAL * max(size), 0.5 * width, 0.5 * height, 0.0]
        found = pycolmap.Camera(model="SIMPLE_RADIAL", width=width, height=height, params=guess)
    found.has_prior_focal_length = camera is not None
    return found


def _descriptors(opened: Any, image_id: int | None) -> UInt8[np.ndarray, "k d"]:
    if image_id is None or not opened.exists_descriptors(image_id):
        return np.zeros((0, 128), np.uint8)
    return np.asarray(opened.read_descriptors(image_id).data)


def _match(pycolmap: Any, database: Path, work: Path, pairs: Sequence[tuple[str, str]], progress: Progress) -> None:
    matching, verification = pycolmap.FeatureMatchingOptions(), pycolmap.TwoViewGeometryOptions()
    matching.use_gpu = False
    verification.ransac.random_seed = _SEED
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = work / "pairs.txt"
    done = 0
    for some in _parts(pairs, _AT_ONCE[1]):
        (work / "pairs.txt").write_text("".join(f"{a} {b}\n" for a, b in some), encoding="utf-8")
        pycolmap.match_image_pairs(
            database, matching_options=matching, pairing_options=pairing, verification_options=verification
        )
        done += len(some)
        progress("matching pairs", done, len(pairs))


def _matches(pycolmap: Any, opened: Any, index: Mapping[int, int], widths: Sequence[int]) -> Iterator[Match]:
    kinds = pycolmap.TwoViewGeometryConfiguration
    places: dict[int, Float64[np.ndarray, "k 2"]] = {}
    for pair, geometry in zip(*opened.read_two_view_geometries(), strict=True):
        if not len(geometry.inlier_matches):
            continue
        ids = pycolmap.pair_id_to_image_pair(pair)
        for each in ids:
            if each not in places:
                places[each] = np.asarray(opened.read_keypoints(each), np.float64)[:, :2]
        matched = np.asarray(geometry.inlier_matches, np.int64)
        ways = places[ids[0]][matched[:, 0]] - places[ids[1]][matched[:, 1]]
        first, second = sorted(index[each] for each in ids)
        shift = float(np.median(np.linalg.norm(ways, axis=1))) / widths[first]
        turned = kinds(geometry.config) in (kinds.PANORAMIC, kinds.PLANAR_OR_PANORAMIC)
        yield Match(first, second, len(matched), shift, turned)


def _place(
    pycolmap: Any, database: Path, images: Path, work: Path, constant: set[int], total: int, progress: Progress
) -> list[Any]:
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads, options.random_seed, options.extract_colors = 1, _SEED, False
    options.min_model_size, options.constant_cameras = LEAST, constant
    stage, placed = "placing images", 0

    def begin() -> None:
        nonlocal placed
        placed = 2
        progress(stage, placed, total)

    def go_on() -> None:
        nonlocal placed
        placed += 1
        progress(stage, placed, total)

    (work / "models").mkdir()
    models = pycolmap.incremental_mapping(
        database,
        images,
        work / "models",
        options,
        initial_image_pair_callback=begin,
        next_image_callback=go_on,
    )
    found = [model for model in models.values() if model.num_reg_images() >= LEAST]
    return sorted(found, key=lambda model: -model.num_reg_images())


def _parts(things: Sequence[Any], count: int) -> Iterator[Sequence[Any]]:
    for begin in range(0, len(things), count):
        yield things[begin : begin + count]
