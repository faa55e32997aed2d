"""Data sets as they lie on disk -> posed frames, and -> MCAP."""

import json
import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from filtering.se3 import Poses
from sequences.datasets.convert import convert
from sequences.datasets.frames import posed_frames
from sequences.datasets.listing import list_images
from sequences.errors import SequenceError
from sequences.files import UNUSABLE
from sequences.frame import Trajectory
from sequences.odometry import OdometryNoise
from sequences.options import SequenceOptions
from sequences.reader import SequenceReader
from sequences.recordings.bag import Bag
from sequences.trajectories.tum import write_tum
from tests.helpers.data_sets import STEP_NS, make_7scenes, make_tum, same, truth_at
from tests.helpers.sequence_files import BEGIN_NS, Walk, rewrite, world_from_camera

# --- training --------------------------------------------------------------------------------------


def test_mcap_frames_without_a_true_pose_are_left_out(tmp_path: Path) -> None:
    walk = Walk()
    walk.truth = walk.truth[:5]
    path = walk.write(tmp_path / "walk.mcap")
    assert len(list(posed_frames(path))) == 5
    with pytest.raises(SequenceError, match="no image with a true pose"):
        list(posed_frames(path, options=SequenceOptions(ground_truth_topic="")))
    with pytest.raises(SequenceError, match="count from the end"):
        list(posed_frames(path, frames=slice(-3, None)))


def test_a_tum_folder_gives_frames_with_interpolated_poses(tmp_path: Path) -> None:
    folder = make_tum(tmp_path / "rgbd_dataset_freiburg1_test")
    assert len(list(posed_frames(folder))) == 10
    frames = list(posed_frames(folder, frames=slice(1, None, 2)))
    assert [int(frame.image[0, 0, 0]) for frame in frames] == [15, 35, 55, 75, 95]
    for frame in frames:
        assert same(frame.world_from_camera, world_from_camera(frame.time_ns), 1e-4)
    camera = frames[0].camera
    assert camera is not None
    # The known camera of freiburg1 at a twentieth of its size.
    assert (camera.width, camera.height) == (32, 24)
    np.testing.assert_allclose([camera.fx, camera.cx], [517.3 / 20, 319.1 / 20 - 0.5])


def test_what_is_left_out_of_frames_is_counted(tmp_path: Path) -> None:
    folder = make_tum(tmp_path / "tum")
    write_tum(folder / "groundtruth.txt", truth_at([BEGIN_NS + 10_000_000 * i for i in range(-1, 28)]))
    files = sorted((folder / "rgb").iterdir())
    files[2].unlink()
    files[4].write_bytes(b"no image")
    frames = posed_frames(folder)
    assert [int(frame.image[0, 0, 0]) // 10 for frame in frames] == [0, 1, 3, 5, 6, 7, 8]
    assert frames.skipped == {"no image": 1, "undecodable image": 1, "no true pose near its time": 1}
    rows = (folder / "rgb.txt").read_text().splitlines()
    (folder / "rgb.txt").write_text("\n".join(rows[:-1]))
    assert list_images(folder).skipped == {"no image": 1, "image not in the list": 1}
    walk = Walk()
    walk.images[5] = (walk.images[5][0], b"no image")
    bag = posed_frames(walk.write(tmp_path / "walk.mcap"))
    assert len(list(bag)) == 11
    assert bag.skipped == {"undecodable image": 1}


@pytest.mark.parametrize("sequence", ["", "seq-01"])
def test_a_7_scenes_folder_gives_frames_of_a_sequence_or_of_all(sequence: str, tmp_path: Path) -> None:
    scene = make_7scenes(tmp_path / "scene", sequences=("seq-01", "seq-02"))
    (scene / "intrinsics.json").write_text(
        json.dumps({"width": 64, "height": 48, "fx": 58.5, "fy": 58.5, "cx": 31.5, "cy": 23.5})
    )
    frames = list(posed_frames(scene / sequence))
    assert len(frames) == (10 if sequence else 20)
    times_ns = [frame.time_ns for frame in frames]
    assert times_ns[:2] == [0, STEP_NS]
    assert times_ns == sorted(set(times_ns))
    for i, frame in enumerate(frames):
        assert int(frame.image[0, 0, 0]) == 10 * (i % 10) + 5
        assert same(frame.world_from_camera, world_from_camera(BEGIN_NS + (i % 10) * STEP_NS), 1e-12)
        assert frame.camera is not None
        assert (frame.camera.width, frame.camera.fx, frame.camera.cx) == (32, 29.25, 15.5)


@pytest.mark.parametrize(
    ("content", "said"),
    [("1 0 0\n0 1 0\n", r"shape \(2, 3\)"), ("x 0 0 0\n", "1: 'x' is no number"), ("2 0 0 0\n" * 4, "no rotation")],
)
def test_a_7_scenes_pose_that_is_none_is_left_out_and_named(content: str, said: str, tmp_path: Path) -> None:
    scene = make_7scenes(tmp_path / "scene", num_images=2)
    (scene / "seq-01" / "frame-000001.pose.txt").write_text(content)
    frames = posed_frames(scene)
    assert len(list(frames)) == 1
    assert frames.skipped == {UNUSABLE: 1}
    (notice,) = frames.notices
    assert re.search(rf"frame-000001\.pose\.txt:.*{said}", notice)
    assert convert(scene, tmp_path / "out.mcap").notices == (notice,)


def test_damaged_intrinsics_are_refused_and_damaged_rows_of_a_list_left_out_and_named(tmp_path: Path) -> None:
    folder = make_tum(tmp_path / "tum")
    (folder / "intrinsics.json").write_text('{"width": 3}')
    with pytest.raises(SequenceError, match=r"intrinsics\.json: no height, .* expected JSON with width"):
        list(posed_frames(folder))
    (folder / "intrinsics.json").unlink()
    with open(folder / "rgb.txt", "a") as file:
        file.write("1800000000.0\n")
    truth = (folder / "groundtruth.txt").read_text().splitlines()
    truth[4] = truth[4].replace(" ", " nan ", 1).rsplit(" ", 1)[0]
    truth[9] = " ".join([*truth[9].split()[:4], "0", "0", "0", "0"])
    truth[11:11] = ["1 2 3", truth[2]]
    (folder / "groundtruth.txt").write_text("\n".join(truth))
    frames = posed_frames(folder)
    assert len(list(frames)) == 10
    assert frames.skipped == {UNUSABLE: 1}
    true_poses, images = frames.notices
    assert re.match(r"4 of 42 true poses left out, the first: .*groundtruth\.txt:5: pose is not finite", true_poses)
    assert re.match(r"1 of 11 images left out, .*rgb\.txt:13: '1800000000\.0', expected `time file`", images)
    (folder / "groundtruth.txt").write_text("\n".join([*truth, *["1 2 3"] * 60]))
    with pytest.raises(SequenceError, match=r"groundtruth\.txt:5: .*; 63 of 102 true poses cannot be used"):
        list_images(folder)


def test_images_of_which_more_than_half_are_none_are_refused_by_the_first(tmp_path: Path) -> None:
    scene = make_7scenes(tmp_path / "scene", num_images=3)
    files = sorted((scene / "seq-01").glob("*.png"))
    files[0].write_bytes(b"no image")
    frames = posed_frames(scene)
    assert len(list(frames)) == 2
    assert re.match(r"1 of 3 images left out, the first: .*frame-000000\.color\.png: 8 bytes are no", frames.notices[0])
    files[2].write_bytes(files[2].read_bytes()[:-20])
    said = r"frame-000000\.color\.png: 8 bytes are no image .*; 2 of 3 images cannot be used, expected at most one"
    with pytest.raises(SequenceError, match=said):
        list(posed_frames(scene))
    with pytest.raises(SequenceError, match=said):
        convert(scene, tmp_path / "out.mcap")
    assert not (tmp_path / "out.mcap").exists()


# --- conversion ------------------------------------------------------------------------------------


def camera_increments(path: Path) -> list[tuple[Poses, Poses]]:
    """Recorded and true motion between frames."""
    frames = list(SequenceReader(path))
    increments = []
    for before, frame in pairwise(frames):
        assert before.world_from_camera is not None
        assert frame.world_from_camera is not None
        assert frame.odometry is not None
        truth = before.world_from_camera.inverse() @ frame.world_from_camera
        increments.append((frame.odometry.previous_from_current, truth))
    return increments


def test_recorded_odometry_in_another_frame_gives_the_true_increments(tmp_path: Path) -> None:
    folder = make_tum(tmp_path / "tum")
    elsewhere = Poses.exp(np.array([5.0, -3, 2, 1, 2, 0.5]))
    times_ns = [BEGIN_NS - 50_000_000 + 20_000_000 * i for i in range(40)]
    truth = truth_at(times_ns)
    odometry = tmp_path / "odometry.tum"
    write_tum(odometry, Trajectory(truth.times_ns, elsewhere @ truth.poses))
    output = tmp_path / "out.mcap"
    summary = convert(folder, output, odometry=odometry)
    assert (summary.num_images, summary.skipped, summary.odometry) == (10, {}, "recorded: odometry.tum")
    assert SequenceReader(output).odometry_description == "recorded: odometry.tum"
    increments = camera_increments(output)
    assert len(increments) == 9
    assert all(same(found, true, 1e-3) for found, true in increments)


def test_simulated_odometry_says_so_and_depends_on_the_seed_only(tmp_path: Path) -> None:
    scene = make_7scenes(tmp_path / "scene")
    paths = [tmp_path / name for name in ("a.mcap", "b.mcap", "c.mcap")]
    for path, seed in zip(paths, (1, 1, 2), strict=True):
        summary = convert(scene, path, odometry_noise=OdometryNoise(), seed=seed)
        assert summary.num_images == 10
    assert paths[0].read_bytes() == paths[1].read_bytes()
    description = SequenceReader(paths[2]).odometry_description
    assert description is not None
    assert description.startswith("simulated: ")
    assert description.endswith("seed 2")
    first, third = camera_increments(paths[0]), camera_increments(paths[2])
    assert not same(first[3][0], third[3][0], 1e-6)
    assert all(same(found, true, 0.05) for found, true in first)


def test_images_are_copied_as_they_are(tmp_path: Path) -> None:
    scene = make_7scenes(tmp_path / "scene", num_images=3)
    convert(scene, tmp_path / "out.mcap", frames=slice(1, None))
    stored = (scene / "seq-01" / "frame-000002.color.png").read_bytes()
    messages = Bag(tmp_path / "out.mcap").messages(["/camera/image/compressed"])
    assert stored in (data := b"".join(raw.data for raw in messages))
    assert (scene / "seq-01" / "frame-000000.color.png").read_bytes() not in data
    with pytest.raises(SequenceError, match="no odometry topic"):
        SequenceReader(tmp_path / "out.mcap")


def test_what_a_conversion_leaves_out_is_counted(tmp_path: Path) -> None:
    folder = make_tum(tmp_path / "tum")
    write_tum(folder / "groundtruth.txt", truth_at([BEGIN_NS + 10_000_000 * i for i in range(-1, 28)]))
    file = sorted((folder / "rgb").iterdir())[4]
    file.write_bytes(b"no image")
    odometry = tmp_path / "odometry.tum"
    write_tum(odometry, truth_at([BEGIN_NS + 50_000_000 + 10_000_000 * i for i in range(40)]))
    summary = convert(folder, tmp_path / "out.mcap", odometry=odometry)
    # 0 and 1 come before the odometry, 9 after the true poses, 4 is broken.
    assert summary.skipped == {"no true pose near its time": 1, "before odometry begins": 2, "undecodable image": 1}
    assert summary.num_images == 6
    reader = SequenceReader(tmp_path / "out.mcap")
    assert len(list(reader)) == 6
    assert reader.skipped == {}


def test_a_conversion_that_fails_leaves_no_file(tmp_path: Path) -> None:
    folder = make_tum(tmp_path / "tum")
    odometry = tmp_path / "odometry.tum"
    write_tum(odometry, truth_at([BEGIN_NS + 100_000_000_000, BEGIN_NS + 100_010_000_000]))
    with pytest.raises(SequenceError, match=r"odometry\.tum.* covers no image"):
        convert(folder, tmp_path / "out.mcap", odometry=odometry)
    for file in (folder / "rgb").iterdir():
        file.write_bytes(b"no image")
    with pytest.raises(SequenceError, match="10 of 10 images cannot be used"):
        convert(folder, tmp_path / "out.mcap")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["odometry.tum", "tum"]


# --- data of others --------------------------------------------------------------------------------


def test_real_tum_images_and_odometry_convert(shared_data: Path, tmp_path: Path) -> None:
    folder = shared_data / "tum_fr1" / "rgbd_dataset_freiburg1_xyz"
    output = tmp_path / "out.mcap"
    summary = convert(folder, output, odometry=folder / "rgbdslam_drift.txt", frames=slice(0, 60))
    assert summary.num_images >= 55
    errors = [found.distance(true) for found, true in camera_increments(output)]
    # A real SLAM estimate at 30 Hz: millimetres from image to image. In a wrong convention it would be centimetres.
    assert np.median([e[0] for e in errors]) < 0.005
    moved = [true.distance(Poses.identity())[0] for _, true in camera_increments(output)]
    assert np.median(moved) > 0.007


# --- odometry of posed frames ----------------------------------------------------------------------


def test_posed_frames_bring_the_odometry_between_them_and_none_across_a_frame_left_out(tmp_path: Path) -> None:
    walk = Walk()
    del walk.truth[5]
    walk.odometry = [(t, pose) for t, pose in walk.odometry if t < BEGIN_NS + 1_050_000_000]  # one image longer
    frames = list(posed_frames(walk.write(tmp_path / "walk.mcap"), frames=slice(1, None)))
    numbers = [(frame.time_ns - BEGIN_NS) // 100_000_000 for frame in frames]
    assert numbers == [1, 2, 3, 4, 6, 7, 8, 9, 10, 11]  # the last is not covered by odometry, and not left out
    assert [n for n, f in zip(numbers, frames, strict=True) if f.odometry is None] == [1, 6, 11]
    for before, frame in pairwise(frames):
        if frame.odometry is not None and before.world_from_camera is not None:
            moved = before.world_from_camera @ frame.odometry.previous_from_current
            assert same(frame.world_from_camera, moved, 1e-3)


@pytest.mark.parametrize("trouble", ["no such topic", "no transform", "damaged"])
def test_odometry_that_cannot_be_used_costs_no_posed_frame(trouble: str, tmp_path: Path) -> None:
    path, whole = tmp_path / "walk.mcap", Walk().write(tmp_path / "whole.mcap")
    if trouble == "damaged":
        rewrite(whole, path, data=lambda topic, _, data: data[:9] if topic == "/odom" else data)
    elif trouble == "no transform":
        rewrite(whole, path, keep=lambda topic, _: not topic.startswith("/tf"))
    else:
        rewrite(whole, path)
        options = SequenceOptions(odometry_topic="/other")
        assert len(list(posed_frames(path, options=options))) == 12
    frames = list(posed_frames(path))
    assert len(frames) == 12
    assert (trouble == "no such topic") == any(frame.odometry is not None for frame in frames)
