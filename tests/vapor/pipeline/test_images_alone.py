"""Runs on images alone: a video, a folder of images, a recording without odometry or whose odometry is not read."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from sequences.options import SequenceOptions
from sequences.reader import SequenceReader
from sequences.reading.counts import BETWEEN
from sequences.trajectories.tum import read_tum
from sequences.writer import SequenceWriter
from tests.helpers.boards import CAMERA
from tests.helpers.command_line import report_of
from tests.helpers.pages import ReadPage
from tests.helpers.sequence_files import ODOMETRY, TRUTH, rewrite
from tests.helpers.tiny_model import SMALL
from tests.helpers.video_clips import write_clip
from tests.helpers.video_files import pictures
from tests.sequences.visual_odometry.test_visual_odometry import STEP_NS, images_of, walk
from vapor.inspection.reading import read_walks
from vapor.pipeline.batch import find_sequences
from vapor.pipeline.config import RunConfig
from vapor.track import main

SAID = "odometry   made from the images; their scale is unknown, and only the filter estimates it"


def run(sequence: Path, model: Path, output: Path, *words: str) -> int:
    return main(
        ["run", str(sequence), "--model", str(model), "--output", str(output), *SMALL, "--no-recording", *words]
    )


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    """A video without intrinsics."""
    return write_clip(tmp_path / "clips" / "walk.mp4", pictures(9), range(0, 450, 50))


@pytest.fixture
def images(walk_of_25: Path, tmp_path: Path) -> Path:
    """The images of the walk as files named by their stamps."""
    (folder := tmp_path / "images").mkdir()
    for frame in SequenceReader(walk_of_25):
        cv2.imwrite(str(folder / f"{frame.time_ns * 1e-9:.6f}.png"), frame.image[:, :, ::-1])
    return folder


@pytest.fixture
def without(walk_of_25: Path, tmp_path: Path) -> Path:
    """The walk as a recording without odometry."""
    return rewrite(walk_of_25, tmp_path / "without.mcap", keep=lambda topic, _: topic != ODOMETRY)


def test_a_video_is_localized(clip, tiny_model, tmp_path, capsys):
    (clip.parent / "intrinsics.json").write_text(
        json.dumps({"width": 96, "height": 64, "fx": 80.0, "fy": 80.0, "cx": 47.5, "cy": 31.5})
    )
    assert run(clip, tiny_model, tmp_path / "out") == 0
    assert SAID in capsys.readouterr().out
    report = report_of(tmp_path / "out")
    assert report["images"] == {"stated": 9, "read": 9, "used": 5, "skipped": {BETWEEN: 4}}
    assert report["duration_s"] == pytest.approx(0.4)
    stamps = read_tum(tmp_path / "out" / "trajectory.tum").times_ns
    assert stamps.tolist() == [50_000_000 * i for i in range(0, 9, 2)]


def test_without_any_intrinsics_each_hypothesis_has_a_velocity_of_its_own(clip, tiny_model, tmp_path, capsys):
    assert run(clip, tiny_model, tmp_path / "out") == 0
    assert (
        "odometry   none, as the intrinsics are unknown: each hypothesis moves by a velocity" in capsys.readouterr().out
    )
    assert report_of(tmp_path / "out")["images"]["used"] == 9
    assert run(clip, tiny_model, tmp_path / "visual", "--odometry", "visual") == 1
    assert "--odometry visual without intrinsics, expected" in capsys.readouterr().err
    assert not (tmp_path / "visual").exists()


def test_a_recording_without_odometry_gives_what_its_images_give(without, walk_of_25, images, tiny_model, tmp_path):
    assert run(without, tiny_model, tmp_path / "without") == 0
    assert run(walk_of_25, tiny_model, tmp_path / "unread", "--odometry", "visual") == 0
    assert run(images, tiny_model, tmp_path / "folder") == 0
    found = [read_tum(tmp_path / name / "trajectory.tum").poses.translation for name in ("without", "unread", "folder")]
    assert found[0].shape == (25, 3)
    assert found[0].tolist() == found[1].tolist()
    assert abs(found[0] - found[2]).max() < 1e-3  # names state microseconds
    assert report_of(tmp_path / "without")["frames_with_true_pose"] == 25


def test_odometry_is_used_where_there_is_any(walk_of_25, tiny_model, tmp_path, capsys):
    assert run(walk_of_25, tiny_model, tmp_path / "auto") == 0
    assert SAID not in capsys.readouterr().out
    assert run(walk_of_25, tiny_model, tmp_path / "recorded", "--odometry", "recorded") == 0
    auto, recorded = ((tmp_path / name / "trajectory.tum").read_text() for name in ("auto", "recorded"))
    assert auto == recorded


@pytest.fixture
def boards(tmp_path: Path) -> Path:
    """A recording of textured boards, a second of it, whose odometry is exact."""
    poses, images = walk("sideways", 30), images_of(walk("sideways", 30))
    with SequenceWriter(tmp_path / "boards.mcap", camera=CAMERA, base_from_camera=Poses.identity()) as writer:
        for i, image in enumerate(images):
            writer.write_odometry(STEP_NS * i, poses[i], 1e-4 * np.eye(6))
            writer.write_image(STEP_NS * i, image)
    return tmp_path / "boards.mcap"


def test_odometry_of_the_images_is_used_instead_of_or_beside_what_is_recorded(boards, tiny_model, tmp_path, capsys):
    found = {}
    for odometry in ("recorded", "visual", "both", "none"):
        out = tmp_path / odometry
        assert run(boards, tiny_model, out, "--odometry", odometry, "--localize-hz", "100") == 0
        assert (SAID in capsys.readouterr().out) == (odometry == "visual")
        found[odometry] = (out / "trajectory.tum").read_text()
        described = json.loads((out / "config.json").read_text())["sequence"]["odometry"]
        assert ("visual" in (described or "")) == (odometry in ("visual", "both"))
        assert report_of(out)["images"]["used"] == 31
    assert len(set(found.values())) == 4


def test_both_without_recorded_odometry_is_refused(clip, without, tiny_model, tmp_path, capsys):
    for sequence in (clip, without):
        assert run(sequence, tiny_model, tmp_path / "out", "--odometry", "both") == 1
        assert "odometry" in capsys.readouterr().err
        assert not (tmp_path / "out").exists()


def test_odometry_that_is_ignored_is_not_taken_for_true_poses(walk_of_25, tiny_model, tmp_path):
    def renamed(topic: str, _: int, data: bytes) -> bytes:
        return data.replace(b"odom\0", b"wrld\0") if topic == ODOMETRY else data

    path = rewrite(walk_of_25, tmp_path / "world.mcap", keep=lambda topic, _: topic != TRUTH, data=renamed)
    assert run(path, tiny_model, tmp_path / "out", "--odometry", "none") == 0
    assert report_of(tmp_path / "out")["frames_with_true_pose"] == 0
    assert report_of(tmp_path / "out")["odometry"] is None


def test_why_there_is_no_odometry_is_said(without, tiny_model, tmp_path, capsys):
    assert run(without, tiny_model, tmp_path / "out") == 0
    (said,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("odometry ")]
    looked_for = "no topic is of type nav_msgs/Odometry, and in tf camera_optical_frame does not move in a frame odom"
    assert said == f"{SAID}; none is recorded: {looked_for}"
    assert report_of(tmp_path / "out")["odometry"] == "visual"
    assert not any("odometry" in notice for notice in report_of(tmp_path / "out")["notices"])  # it is a plain fact
    page = ReadPage.of((tmp_path / "out" / "report.html").read_text())
    assert "Odometry: made from the images; their scale is unknown" in page.words
    assert f"No odometry is recorded: {looked_for}." in page.words


def test_odometry_that_is_used_as_true_poses_is_not_said_to_be_absent(walk_of_25, tiny_model, tmp_path, capsys):
    path = rewrite(walk_of_25, tmp_path / "walk.mcap", keep=lambda topic, _: topic != TRUTH)
    assert run(path, tiny_model, tmp_path / "out", "--ground-truth-topic", ODOMETRY) == 0
    (said,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("odometry ")]
    assert "none is recorded: no other topic is of type nav_msgs/Odometry, and in tf " in said
    lacks = read_walks([path], SequenceOptions(ground_truth_topic=ODOMETRY))[0].source
    assert lacks.lacks["odometry"].startswith("no other odometry topic, expected one of type nav_msgs/Odometry;")
    assert not lacks.unused_odometry


@pytest.mark.usefixtures("unchecked")
def test_an_unknown_source_of_odometry_is_refused():
    with pytest.raises(
        VaporTrackError, match="odometry is 'wheels', expected one of auto, recorded, visual, both, none"
    ):
        RunConfig(odometry="wheels")  # pyright: ignore[reportArgumentType]


def test_videos_in_a_folder_are_sequences_and_images_beside_them_are_not(clip, tmp_path):
    cv2.imwrite(str(clip.parent / "preview.png"), pictures(1)[0])
    assert list(find_sequences([clip.parent], tmp_path / "out").values()) == [clip]
    assert find_sequences([clip], tmp_path / "out") == {"walk": clip}
