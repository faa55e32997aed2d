"""The recording of a ceiling with a camera rig: alike everywhere, but for a few spots.

Zangeneh, Bruns, Dekel, Pieropan and Jensfelt, "A Probabilistic Framework for Visual Localization in Ambiguous Scenes",
ICRA 2023. A scene holds `train/` and `test/`, these hold a folder a sequence, named by its number, and that holds
`poses.txt` and `images/000000.jpg`. A row is `seq image tx ty tz qw qx qy qz`, where `image` is the number in the
image's name, and the pose is camera-to-world.

OpenCV's axes, metres and the rate are assumed. Intrinsics come from an `intrinsics.json` in the sequence or up to two
folders above it, and are unknown without one.
"""

from __future__ import annotations

from pathlib import Path

from sequences.datasets.layout import Layout, PosedImages
from sequences.datasets.layout_helpers.pose_lists import NumberedLayout
from sequences.values import natural

_NAME = "Ceiling"
_NUMBERED = NumberedLayout(_NAME, "seq image tx ty tz qw qx qy qz", None, ("images", "rgb"), levels=2)


def list_images(path: Path) -> PosedImages | None:
    """Images of a sequence, or of all sequences of `train` or `test`; None where it is neither."""
    if (path / "poses.txt").is_file():
        return _NUMBERED.list_images([path / "poses.txt"])
    pose_files = sorted(path.glob("*/poses.txt"), key=lambda file: natural(file.parent.name))
    unposed = {folder for folder in path.glob("*/") if folder.is_dir()} - {file.parent for file in pose_files}
    return _NUMBERED.list_images(pose_files, unposed) if pose_files else None


LAYOUT = Layout(_NAME, looked_for="poses.txt", order=50, list_images=list_images, splits=("train", "test"))
