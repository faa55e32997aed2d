"""The Ambiguous Relocalization data set: five scenes that look alike from several places.

Bui, Birdal, Deng, Albarqouni, Guibas, Ilic and Navab, "6D Camera Relocalization in Ambiguous Scenes via Continuous
Multimodal Inference", ECCV 2020. A scene holds `train/` and `test/`, these hold `seq00`, `seq01` and so on, and a
sequence holds `poses_seq00.txt` and `rgb_matched/frame-color-0000.png`. A row is
`seq, frame, qw, qx, qy, qz, tx, ty, tz`, where `frame` is the number in the image's name.

The data set states neither the direction of its poses nor times. Published code that renders its scenes takes the poses
as camera-to-world in OpenCV's axes, and so they are read here; metres and the rate are assumed.
Intrinsics come from an `intrinsics.json` in the sequence or up to three folders above it, and are unknown without one.
"""

from __future__ import annotations

from pathlib import Path

from sequences.datasets.layout import Layout, PosedImages
from sequences.datasets.layout_helpers.pose_lists import NumberedLayout
from sequences.errors import SequenceError
from sequences.values import natural

_NAME = "Ambiguous Relocalization"
_NUMBERED = NumberedLayout(_NAME, "seq frame qw qx qy qz tx ty tz", ",", ("rgb_matched", "rgb", "images"), levels=3)


def list_images(path: Path) -> PosedImages | None:
    """Images of a sequence, or of all sequences of `train` or `test`; None where it is neither."""
    if not path.is_dir():
        return None
    folders = [path]
    if not _pose_files(path):
        folders = sorted((p for p in path.iterdir() if p.is_dir()), key=lambda p: natural(p.name))
    found = {folder: _pose_files(folder) for folder in folders}
    if not any(found.values()):
        return None
    for files in found.values():
        if len(files) > 1:
            names = " and ".join(file.name for file in files)
            raise SequenceError(f"{files[0].parent}: {names}, expected one file of poses a sequence")
    unposed = [folder for folder, files in found.items() if not files]
    return _NUMBERED.list_images([files[0] for files in found.values() if files], unposed)


def _pose_files(folder: Path) -> list[Path]:
    return sorted(folder.glob("poses_seq*.txt"))


LAYOUT = Layout(_NAME, looked_for="poses_seq*.txt", order=40, list_images=list_images, splits=("train", "test"))
