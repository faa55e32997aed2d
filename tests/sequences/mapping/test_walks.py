"""The images that are chosen of walks."""

from pathlib import Path

import cv2

from sequences.mapping.config import MapConfig
from sequences.mapping.walks import read_walks
from tests.helpers.rigs import Rig
from tests.helpers.sequence_files import CAMERA


def test_of_several_cameras_the_one_that_is_localized_is_mapped(tmp_path: Path) -> None:
    path = Rig({"left": 0, "right": 0}, {}).write(tmp_path / "rig.mcap")
    (walk,) = read_walks([path], tmp_path / "images", MapConfig())
    files = [file for file in (tmp_path / "images").rglob("*") if file.is_file()]
    assert len(files) == len(walk.pictures) > 0
    for file in files:
        image = cv2.imread(str(file))
        assert image is not None
        assert image.shape == (CAMERA.height, CAMERA.width, 3)
