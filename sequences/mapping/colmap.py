"""Structure from motion by COLMAP: features, matches, and one model of all images (GLOMAP; Pan et al., ECCV 2024)."""

from __future__ import annotations

import importlib
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float64, Int64, UInt8
from scipy.sparse.csgraph import connected_components

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
_AGREE, _AGREE_PX = 0.004, (1.0, 4.0)  # of the longer edge: how far features may be off the geometry of a pair
_PAIR, _PAIR_SHARE = 20, 0.25  # features of a pair that must agree, and of those that look alike
_SHARED = 30  # points by which an image is held to the others; by fewer, parts of a model lie where they happen to
_AT_ONCE = 8, 400  # images and pairs between two reports of progress
_SEED = 0
_WAIT_S = 0.1  # for COLMAP, between two looks at signals
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
        model: The largest part of the images that hold together, in a unit and frame of its own; None where there is
            none.
        others: Names of the images of each other part, the largest first.
        num_features: Of each image, (n,), in the order of the walks.
        matches: Images that show the same.
    """

    model: pycolmap.Reconstruction | None
    others: Sequence[frozenset[str]]
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
    """The model of the images of walks.

    Features and matches are the same each time, and found by all processors. Images are placed by one, with all
    generators seeded; COLMAP still takes things in another order each time, so poses differ a little. An image belongs
    to the model where chains of images that share enough points lead to it.

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
    known = _extract(pycolmap, walks, database, images, progress)
    with pycolmap.Database.open(database) as opened:
        ids = {image.name: image.image_id for image in opened.read_all_images()}
        descriptors = [_descriptors(opened, ids.get(name)) for name in names]
    pairs = image_pairs([len(walk.pictures) for walk in walks], descriptors, np.random.default_rng(_SEED))
    edge = max(max(picture.size) for walk in walks for picture in walk.pictures)
    _match(pycolmap, database, work, [(names[a], names[b]) for a, b in pairs], edge, progress)
    with pycolmap.Database.open(database) as opened:
        widths = [picture.size[0] for walk in walks for picture in walk.pictures]
        index = {ids[name]: i for i, name in enumerate(names) if name in ids}
        matches = list(_matches(pycolmap, opened, index, widths))
    model, others = None, []
    if matches:
        model, others = _place(pycolmap, database, images, work, known, len(names), progress)
    return Reconstructed(model, others, np.array([len(some) for some in descriptors], np.int64), matches)


def _extract(pycolmap: Any, walks: Sequence[Walk], database: Path, images: Path, progress: Progress) -> bool:
    """Find the features of all images; gives whether the intrinsics of all of them are known."""
    by_camera: dict[tuple[Camera | None, tuple[int, int]], list[str]] = {}
    for walk in walks:
        for picture in walk.pictures:
            by_camera.setdefault((picture.camera, picture.size), []).append(picture.name)
    readers: list[tuple[Any, list[str]]] = []
    with pycolmap.Database.open(database) as opened:
        for (camera, size), names in by_camera.items():
            camera_id = opened.write_camera(_camera(pycolmap, camera, size))
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
    return all(camera is not None for camera, _ in by_camera)


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


def _match(
    pycolmap: Any, database: Path, work: Path, pairs: Sequence[tuple[str, str]], edge: int, progress: Progress
) -> None:
    matching, verification = pycolmap.FeatureMatchingOptions(), pycolmap.TwoViewGeometryOptions()
    matching.use_gpu = False
    verification.ransac.random_seed = _SEED
    verification.ransac.max_error = float(np.clip(_AGREE * edge, *_AGREE_PX))
    verification.min_num_inliers, verification.min_inlier_ratio = _PAIR, _PAIR_SHARE
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
    pycolmap: Any, database: Path, images: Path, work: Path, known: bool, total: int, progress: Progress
) -> tuple[Any, list[frozenset[str]]]:
    """The model, None where there is none, and the names of the images of each other part of at least `LEAST`."""
    progress("placing images", 0, total)
    options = pycolmap.GlobalPipelineOptions()
    options.num_threads, options.random_seed, options.min_model_size = 1, _SEED, LEAST
    mapper, adjustment = options.mapper, options.mapper.bundle_adjustment
    mapper.num_threads = 1
    for part in (mapper, mapper.rotation_averaging, mapper.global_positioning, mapper.retriangulation):
        part.random_seed = _SEED
    mapper.global_positioning.use_gpu = False
    adjustment.ceres.solver_options.num_threads = 1
    adjustment.ceres.use_gpu = False
    adjustment.refine_focal_length = adjustment.refine_extra_params = not known
    (work / "models").mkdir()

    def place() -> Any:
        if not known:
            pycolmap.calibrate_view_graph(database)
        return pycolmap.global_mapping(database, images, work / "models", options)

    models = _in_thread(place)
    parts = [(model, part) for model in models.values() for part in _held_together(model) if len(part) >= LEAST]
    if not parts:
        return None, []
    parts.sort(key=lambda each: -len(each[1]))
    model, kept = parts[0]
    others = [frozenset(model.images[image_id].name for image_id in part) for model, part in parts[1:]]
    for image_id in {*model.reg_image_ids()} - kept:
        model.deregister_frame(model.images[image_id].frame_id)
    progress("placing images", len(kept), total)
    return model, others


def _held_together(model: Any) -> list[set[int]]:
    """The images of a model, by their ids, in parts that chains of images with enough points in common lead through."""
    ids = sorted(model.reg_image_ids())
    index = {image_id: number for number, image_id in enumerate(ids)}
    shared = np.zeros((len(ids), len(ids)), np.int64)
    for point in model.points3D.values():
        seen = [*{index[element.image_id] for element in point.track.elements}]
        if len(seen) > 2:  # two images agree on a point wherever they are along its rays
            shared[np.ix_(seen, seen)] += 1
    count, part = connected_components(shared >= _SHARED, directed=False)
    return [{ids[i] for i in np.flatnonzero(part == number)} for number in range(count)]


def _in_thread(work: Callable[[], Any]) -> Any:
    """The result of work that no signal interrupts, done in a thread, so that Ctrl-C ends the wait for it."""
    results: list[Any] = []
    errors: list[BaseException] = []

    def run() -> None:
        try:
            results.append(work())
        except BaseException as error:
            errors.append(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    while thread.is_alive():
        thread.join(_WAIT_S)
    if errors:
        raise errors[0]
    return results[0]


def _parts(things: Sequence[Any], count: int) -> Iterator[Sequence[Any]]:
    for begin in range(0, len(things), count):
        yield things[begin : begin + count]
