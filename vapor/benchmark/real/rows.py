"""The rows of `vapor-benchmark real`: recordings made by others, and which part of each is used for what."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from vapor.benchmark.real.copied_places import CopiedPlaces
from vapor.benchmark.real.published import PoseEstimates, StoredPosteriors
from vapor.benchmark.real.row import Row
from vapor.benchmark.real.trained_network import TrainedNetwork


def _tum_fr1() -> TrainedNetwork:
    """Two sequences of one desk: one of them and half of the other are trained on, the rest is localized."""
    rpy, xyz = (f"tum_fr1/rgbd_dataset_freiburg1_{name}" for name in ("rpy", "xyz"))
    drift = f"{xyz}/rgbdslam_drift.txt"
    return TrainedNetwork("tum_fr1", (rpy, f"{xyz}@0:399"), xyz, (399, None), drift)


def _tum_fr1_one_walk() -> TrainedNetwork:
    """The same localized by one of the sequences alone, in which the camera hardly moves but turns."""
    rpy, xyz = (f"tum_fr1/rgbd_dataset_freiburg1_{name}" for name in ("rpy", "xyz"))
    return TrainedNetwork("tum_fr1_one_walk", (rpy,), xyz, (399, None), f"{xyz}/rgbdslam_drift.txt")


def _redkitchen() -> TrainedNetwork:
    """One sequence: its end is trained on, its beginning localized."""
    folder = "7scenes_redkitchen/seq-01"
    return TrainedNetwork("redkitchen", (f"{folder}@300:1000",), folder, (0, 300))


def _hololens_rooms() -> TrainedNetwork:
    """One walk: of every 30 images 20 are trained on; all are localized, the other 10 evaluated."""
    folder, images, trained, block = "hololens_rooms/seq-01", 373, 20, 30
    spans = [(start, min(start + trained, images)) for start in range(0, images, block)]
    return TrainedNetwork(
        "hololens_rooms",
        tuple(f"{folder}@{start}:{stop}" for start, stop in spans),
        folder,
        evaluated={"": lambda n: np.arange(n) % block >= trained, "all": lambda n: np.ones(n, bool)},
    )


def _copied_rooms() -> CopiedPlaces:
    """The same walk on three storeys; where the camera looks back in the first room is on the middle one only."""
    return CopiedPlaces(
        "rooms_copied",
        _hololens_rooms().training,
        "hololens_rooms/seq-01",
        lambda poses: (poses.translation[:, 0] < -2.5) & (poses.rotation[:, 2, 2] > 0.3),
        tuple((0.0, height_m, 0.0) for height_m in (0.0, 3.0, 6.0)),
        own=1,
        rate_hz=5.0,
    )


def _copied_desk() -> CopiedPlaces:
    """Two desks side by side; the parts above and below stand at the second only."""
    rpy, xyz = (f"tum_fr1/rgbd_dataset_freiburg1_{name}" for name in ("rpy", "xyz"))
    blocks = tuple(f"{rpy}@{start}:{start + 20}" for start in range(0, 719, 30))
    return CopiedPlaces(
        "desk_copied",
        (xyz, *blocks),
        rpy,
        lambda poses: np.abs(poses.rotation[:, 1, 2]) > 0.55,
        ((0.0, 0.0, 0.0), (4.0, 0.0, 0.0)),
        own=1,
        rate_hz=30.0,
    )


SCALE = 30.0
"""How much larger the scaled rows are: a car park instead of a room."""


def _stairs(scale: float = 1.0) -> Sequence[PoseEstimates]:
    """Six methods' estimates in a repetitive staircase, each alone and all together."""
    folder, group = "7scenes_stairs", "stairs" if scale == 1.0 else f"stairs_x{scale:g}"
    methods = {
        name: f"{folder}/estimates/stairs_{name}.txt"
        for name in ("hloc", "r2d2_rgb", "r2d2_rgbd", "as", "dsac_rgb", "dsac_rgbd")
    }
    inputs = {name: (file,) for name, file in methods.items()} | {
        "all": tuple(methods[name] for name in sorted(methods))
    }
    truth = f"{folder}/stairs_test.txt"
    return [PoseEstimates(f"{group}_{name}", group, files, truth, scale) for name, files in inputs.items()]


# To add a row: one of these kinds, or a subclass of `Row` of your own.
ROWS: tuple[Row, ...] = (
    _tum_fr1(),
    _tum_fr1_one_walk(),
    _redkitchen(),
    _hololens_rooms(),
    _copied_rooms(),
    replace(_copied_rooms(), name="rooms_copied_visual", visual_of="rooms_copied"),
    _copied_desk(),
    StoredPosteriors("corridor_posteriors", "corridor_posteriors/floor.npz", own_seed=4),
    *_stairs(),
    *_stairs(SCALE),
)
"""All of them, in the order of the tables."""
