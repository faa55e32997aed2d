"""Hypotheses in the form in which Rerun shows them: ellipsoids, weights and cameras."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from jaxtyping import UInt8

from filtering.estimate import Mode
from filtering.se3 import Poses
from vapor.reporting.rerun_shapes import ellipsoids, frusta


def shown_modes(
    modes: Sequence[Mode], colors: UInt8[np.ndarray, "n 3"], *, camera_m: float
) -> Iterator[tuple[str, Any, dict[str, Any]]]:
    """What is to be shown of hypotheses: entity, archetype, and its components by name.

    Args:
        modes: The hypotheses, n ≥ 1.
        colors: Of each.
        camera_m: Size of a camera, metres.
    """
    import rerun as rr

    poses = Poses.stack([mode.world_from_camera for mode in modes])
    sigma, axes = ellipsoids(np.stack([mode.covariance[:3, :3] for mode in modes]))
    turned = Poses(poses.rotation @ axes, poses.translation)
    yield (
        "world/modes",
        rr.Ellipsoids3D,
        {
            "centers": poses.translation,
            "half_sizes": 2.0 * sigma,
            "quaternions": turned.as_quat_xyzw(known_valid=True),
            "colors": colors,
        },
    )
    labels = [f"{100 * mode.weight:.0f} %" for mode in modes]
    points = poses.translation.astype(np.float32)
    yield "world/modes/weights", rr.Points3D, {"positions": points, "colors": colors, "labels": labels}
    yield "world/modes/cameras", rr.LineStrips3D, {"strips": frusta(poses, camera_m), "colors": colors}
