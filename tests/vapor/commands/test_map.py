"""`vapor-track map`, and what other commands say of images without poses."""

import shutil
import subprocess
import sys
from pathlib import Path
from signal import SIGKILL

import numpy as np
import pytest

from sequences.atomic import is_workspace
from tests.helpers.checkout import CHECKOUT
from tests.helpers.command_line import main, refuse
from tests.helpers.room_walks import views, write_images, write_recording
from tests.helpers.textured_room import walk
from tests.helpers.video_clips import write_clip

KILLED_WHILE_MATCHING = """
import os, sys
from pathlib import Path
from sequences.mapping.map import map_images

def kill(stage, done, total):
    if stage == "matching pairs":
        os.kill(os.getpid(), 9)

map_images([Path(sys.argv[1])], Path(sys.argv[2]), progress=kill)
"""


@pytest.fixture(scope="module")
def images(tmp_path_factory) -> Path:
    return write_images(tmp_path_factory.mktemp("film") / "walk", views(walk(10, 1)))


def test_a_killed_map_leaves_nothing_and_the_next_one_makes_it(images, tmp_path, capsys):
    process = subprocess.run([sys.executable, "-c", KILLED_WHILE_MATCHING, images, tmp_path / "place"], cwd=CHECKOUT)
    assert process.returncode == -SIGKILL
    assert [is_workspace(entry.name) for entry in tmp_path.iterdir()] == [True]
    assert main(["map", str(images), "--output", str(tmp_path / "place")]) == 0
    assert [entry.name for entry in tmp_path.iterdir()] == ["place"]
    out, err = capsys.readouterr()
    assert "10 of 10 images have a pose (walk 10 of 10)" in out
    assert "unit: arbitrary; z is up" in out
    assert "--distance-m states one distance" in out
    for stage in ("choosing images", "finding features", "matching pairs", "placing images"):
        assert f"{stage}: " in err
    assert main(["inspect", str(tmp_path / "place")]) == 1
    assert "1. record more: 10 images with true poses" in capsys.readouterr().out  # all else is well


def test_without_pycolmap_one_line_names_the_extra(images, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    words = ["map", str(images), "--output", str(tmp_path / "place")]
    refuse(words, capsys, "pycolmap is not installed, expected it: pip install vapor-track[map]")


def test_what_is_no_input_is_refused_in_words(tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    output = ["--output", str(tmp_path / "place")]
    refuse(["map", str(tmp_path / "no.mp4"), *output], capsys, "no.mp4: no such file or folder, expected a video")
    refuse(["map", str(tmp_path / "empty"), *output], capsys, "empty: no sequence or data set; looked for a video")


def test_commands_that_need_poses_name_map(images, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    images = Path(shutil.copytree(images, "walk"))
    video = write_clip(Path("walk.mp4"), np.stack(views(walk(3, 1))), [0, 100, 200])
    robot = write_recording(Path("walk.mcap"), walk(3, 1))
    for path in (video, images, robot):
        words = ["train", str(path), "--output", "out.safetensors"]
        refuse(words, capsys, f"`vapor-track map {path} --output place/` makes them", "true poses")
    for path in (video, images):
        refuse(["inspect", str(path)], capsys, f"`vapor-track map {path} --output place/` makes them")
    assert main(["inspect", str(robot)]) == 1
    assert f"`vapor-track map {robot} --output place/` makes them" in capsys.readouterr().out.replace("\n", " ")
