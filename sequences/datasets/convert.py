"""Data sets on disk -> MCAP sequences, with recorded or simulated odometry."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from filtering.se3 import Poses
from sequences.datasets.layout import PosedImages
from sequences.datasets.layout_helpers.image_files import decoded_file, read_image_bytes
from sequences.datasets.layout_helpers.packed import ImageFile
from sequences.datasets.listing import list_images, none_among
from sequences.errors import SequenceError
from sequences.files import Rows
from sequences.frame import BASE_FROM_CAMERA, Camera
from sequences.images.headers import why_skipped
from sequences.images.undistortion import Lens
from sequences.odometry import OdometryNoise, simulate_odometry
from sequences.reading.counts import uncovered
from sequences.trajectories.interpolation import MAX_ODOMETRY_GAP_S, interpolate
from sequences.trajectories.tum import read_tum
from sequences.writer import MountedCamera, SequenceWriter


@dataclass(frozen=True)
class ConversionSummary:
    """The outcome of a conversion.

    Attributes:
        num_images: Images written.
        skipped: Images left out, by reason.
        odometry: Source of the odometry, as stated in the file.
        notices: Sentences on skipped rows and images.
    """

    num_images: int
    skipped: dict[str, int]
    odometry: str
    notices: tuple[str, ...] = ()


@dataclass(frozen=True)
class _OdometryTrack:
    """Odometry of the body: stamps (k,), poses (k,) in any frame, twist covariances (k, 6, 6), and its origin."""

    times_ns: np.ndarray
    odom_from_base: Poses
    twist_covariances: np.ndarray
    description: str


def convert(
    dataset: Path,
    output: Path,
    *,
    odometry: Path | None = None,
    odometry_noise: OdometryNoise | None = None,
    frames: slice = slice(None),
    seed: int = 0,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> ConversionSummary:
    """Write a data set as an MCAP sequence; images are copied, not encoded again.

    Base and camera are one body, in the axes of a robot and of a camera. Where a data set has no time stamps they are
    made up at 30 Hz. Of other cameras on the same body the images of the same time are written beside.

    Args:
        dataset: As `sequences.datasets.listing.list_images` takes it.
        output: File to write.
        odometry: Recorded odometry, a TUM trajectory of the camera in any frame: only its relative motion counts.
        odometry_noise: How to simulate odometry from the true poses, instead; None for no odometry at all where there
            is no recorded one either.
        frames: Which of the images.
        seed: Of the simulated odometry.
        progress: Called after every image with the number done and the number of all.

    Raises:
        SequenceError: a file is missing, damaged or of an unknown layout, intrinsics are unknown or differ between
            images, or no image is left.
    """
    if seed < 0:
        raise SequenceError(f"seed {seed}, expected at least 0")
    images = list_images(dataset)
    skipped, count = Counter(images.skipped), len(images)
    images = images[frames]
    if not len(images):
        raise SequenceError(f"{dataset}: {none_among(frames, count)}")
    track = _odometry(images, odometry, odometry_noise, seed)
    images = _covered(images, track, skipped)
    description = track.description if track else "none"
    metadata = {"odometry": description, "dataset": f"{images.layout} {Path(dataset).resolve().name}"}
    if images.assumed_hz is not None:
        metadata["time_stamps"] = f"assumed, {images.assumed_hz} Hz"
    camera = _one_camera(images, dataset)
    others = {
        f"camera_{name}": MountedCamera(_one_camera(more, dataset), BASE_FROM_CAMERA @ mount)
        for name, (more, mount) in images.others.items()
    }
    moments = _all_images(images)
    num_images = 0
    with SequenceWriter(
        output, camera=camera, base_from_camera=BASE_FROM_CAMERA, others=others, metadata=metadata
    ) as writer:
        next_odometry = 0
        rows = Rows("images", why_skipped)
        for done, (time_ns, name, i, file) in rows.each(enumerate(moments)):
            progress(done + 1, len(moments))
            if isinstance(decoded := rows.use(decoded_file, file), str):
                skipped[decoded] += 1
                continue
            data = read_image_bytes(file)
            if track is not None:
                next_odometry = _write_odometry(writer, track, next_odometry, time_ns)
            format = "png" if data[:4] == b"\x89PNG" else "jpeg"
            if name is None:
                writer.write_true_pose(time_ns, images.world_from_camera[i])
                writer.write_encoded_image(time_ns, data, format)
            else:
                writer.write_encoded_image(time_ns, data, format, f"camera_{name}")
            num_images += 1
    return ConversionSummary(num_images, dict(skipped), description, (*images.notices, *rows.notices))


def _all_images(images: PosedImages) -> list[tuple[int, str | None, int, ImageFile]]:
    """Stamp, other camera, number and file of all images in order of time; of other cameras, those of the same time."""
    first_ns, last_ns = int(images.times_ns[0]), int(images.times_ns[-1])
    found: list[tuple[int, str | None, int, ImageFile]] = []
    for name, some in [(None, images), *((name, more) for name, (more, _) in images.others.items())]:
        stamped = enumerate(zip(some.times_ns.tolist(), some.files, strict=True))
        found += [(time_ns, name, i, file) for i, (time_ns, file) in stamped if first_ns <= time_ns <= last_ns]
    return sorted(found, key=lambda image: (image[0], image[1] or ""))


def _odometry(
    images: PosedImages, recorded: Path | None, noise: OdometryNoise | None, seed: int
) -> _OdometryTrack | None:
    camera_from_base = BASE_FROM_CAMERA.inverse()
    if recorded is not None:
        trajectory = read_tum(recorded)
        # The last pose before the images to the first one after them: what their increments need.
        begin = max(int(np.searchsorted(trajectory.times_ns, images.times_ns[0], side="right")) - 1, 0)
        end = int(np.searchsorted(trajectory.times_ns, images.times_ns[-1], side="left")) + 1
        times_ns = trajectory.times_ns[begin:end]
        unknown = np.zeros((len(times_ns), 6, 6))
        return _OdometryTrack(
            times_ns, trajectory.poses[begin:end] @ camera_from_base, unknown, f"recorded: {Path(recorded).name}"
        )
    if noise is None:
        return None
    rng = np.random.default_rng(seed)
    poses, covariances = simulate_odometry(images.times_ns, images.world_from_camera @ camera_from_base, noise, rng=rng)
    settings = noise.settings
    return _OdometryTrack(images.times_ns, poses, covariances, f"simulated: {settings}, seed {seed}")


def _covered(images: PosedImages, track: _OdometryTrack | None, skipped: Counter[str]) -> PosedImages:
    """The images that odometry covers; those that it does not are counted."""
    if track is None:
        return images
    first_ns, last_ns = images.times_ns[[0, -1]].tolist()
    overlap = f"expected it to overlap the images from {first_ns} to {last_ns} ns"
    if not len(track.times_ns):
        raise SequenceError(f"odometry ({track.description}) covers no image, {overlap}")
    _, covered = interpolate(track.times_ns, track.odom_from_base, images.times_ns, max_gap_s=MAX_ODOMETRY_GAP_S)
    if not covered.any():
        raise SequenceError(f"odometry ({track.description}) covers no image, {overlap}")
    if not covered.all():
        for time_ns in images.times_ns[~covered].tolist():
            skipped[uncovered(time_ns, track.times_ns)] += 1
    return images.select(np.flatnonzero(covered))


def _one_camera(images: PosedImages, dataset: Path) -> Camera | Lens:
    cameras = set(images.cameras)
    if len(cameras) > 1:
        raise SequenceError(f"{dataset}: images of {len(cameras)} cameras, expected one: a sequence has one")
    camera = cameras.pop()
    if camera is None:
        raise SequenceError(
            f"{dataset}: {images.layout} does not state intrinsics, expected intrinsics.json beside the images with"
            " width, height, fx, fy, cx and cy in pixels"
        )
    return camera


def _write_odometry(writer: SequenceWriter, track: _OdometryTrack, begin: int, until_ns: int) -> int:
    """Write odometry up to the first message that reaches a time; gives the next one to write."""
    while begin < len(track.times_ns):
        time_ns = int(track.times_ns[begin])
        writer.write_odometry(time_ns, track.odom_from_base[begin], track.twist_covariances[begin])
        begin += 1
        if time_ns >= until_ns:
            break
    return begin
