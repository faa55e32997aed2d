from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from filtering.se3 import Poses
from sequences.frame import Frame
from tests.helpers.data_sets import make_7scenes, make_colmap
from tests.helpers.sequence_files import Walk, as_split_folder
from tests.helpers.simulation import frames_of
from tests.helpers.tiny_training import TINY, make_frames, pose
from vapor.benchmark.regressors.training_runs import identity
from vapor.track import main
from vapor.training.train import train, train_on
from vapor.training_data.checks import Colours, said_of_colours
from vapor.training_data.entries import as_entry, name_entries, open_sequences, require_no_leakage
from vapor.training_data.ground import odometry_segments, pass_numbers, some_runs
from vapor.training_data.load import load_training_set
from vapor.training_data.training_set import TrainingError


def test_training_images_are_scaled_to_cover_the_frame_and_keep_their_order():
    frames = make_frames(5)
    whole = load_training_set({"a": frames[:2], "b": frames[2:]}, (18, 18), central=False)
    assert whole.images.shape == (5, 18, 24, 3)
    np.testing.assert_array_equal(whole.sequence, [0, 0, 1, 1, 1])
    np.testing.assert_array_equal(whole.poses[3].as_matrix(), pose(frames[3]).as_matrix())
    means = frames[3].image.reshape(18, 2, 24, 2, 3).mean(axis=(1, 3))  # halved: each pixel the mean of four
    np.testing.assert_allclose(whole.images[3], means, atol=0.5)
    square = load_training_set({"a": frames}, (18, 18))
    np.testing.assert_array_equal(square.images, whole.images[:, :, 3:21])
    flat = load_training_set({"a": frames}, (24, 12))
    np.testing.assert_array_equal(flat.images, whole.images[:, 3:15])


def test_without_odometry_the_same_images_and_poses_are_read(walk_of_25):
    whole, bare = (
        load_training_set(open_sequences([walk_of_25], None, odometry), (32, 24)) for odometry in ("optional", "unread")
    )
    assert any(step is not None for step in whole.odometry)
    assert not any(step is not None for step in bare.odometry)
    np.testing.assert_array_equal(bare.images, whole.images)
    np.testing.assert_array_equal(bare.poses.as_matrix(), whole.poses.as_matrix())
    np.testing.assert_array_equal(bare.times_ns, whole.times_ns)


def test_each_sequence_of_a_split_has_its_own_name(tmp_path):
    scene = make_7scenes(tmp_path / "chess", sequences=("seq-01", "seq-02"))
    (scene / "TrainSplit.txt").write_text("sequence1\nsequence2\n")
    loaded = load_training_set(open_sequences([scene / "TrainSplit.txt", scene / "seq-01"]), (32, 24))
    np.testing.assert_array_equal(loaded.sequence, np.repeat([0, 1, 2], 10))
    assert loaded.names == ("chess/TrainSplit.txt, sequence 1", "chess/TrainSplit.txt, sequence 2", "seq-01")


def test_a_slash_before_the_part_of_a_folder_is_no_part_of_its_name():
    assert [*name_entries(["data/chess/@0:30", "data/chess//@30:", "fire@:9"])] == [
        "chess@0:30",
        "chess@30:",
        "fire@:9",
    ]
    assert name_entries(["data/chess/@0:30"])["chess@0:30"] == (Path("data/chess"), slice(0, 30))
    assert [str(as_entry(entry)) for entry in ("/@0:3", "a/@b", "a/@0:3/b")] == ["/@0:3", "a/@b", "a/@0:3/b"]


def test_what_is_left_out_of_the_data_is_told(tmp_path, capsys):
    scene = make_7scenes(tmp_path / "chess", num_images=24)
    (scene / "seq-01" / "frame-000003.pose.txt").unlink()
    (scene / "seq-01" / "frame-000007.color.png").unlink()
    (scene / "seq-01" / "frame-000009.color.png").write_bytes(b"no image")
    config = replace(TINY, calibrate=False, epochs=1)
    result = train([scene / "seq-01"], tmp_path / "model.safetensors", config)
    assert result.images_seen == 21  # nothing is held out of one pass
    assert result.skipped == {"no true pose": 1, "no image": 1, "undecodable image": 1}
    words = ["--network.image-width", "32", "--network.image-height", "32", "--network.shortest-edge", "34"]
    words += ["--epochs", "1", "--no-calibrate"]
    main(["train", str(scene / "seq-01"), "--output", str(tmp_path / "again.safetensors"), *words])
    printed = capsys.readouterr().out
    assert "skipped 1: no true pose" in printed
    assert "skipped 1: undecodable image" in printed


def test_images_that_are_trained_on_are_not_taken_for_held_out_ones(tmp_path, monkeypatch):
    recording, scene = Walk(12).write(tmp_path / "walk.mcap"), make_7scenes(tmp_path / "chess")
    (tmp_path / "again.mcap").symlink_to(recording)
    as_split_folder(recording, tmp_path)
    (scene / "TrainSplit.txt").write_text("sequence1\n")
    monkeypatch.chdir(tmp_path)
    for data, held_out in (
        ([scene / "seq-01"], ["chess/seq-01@8:"]),
        ([scene / "TrainSplit.txt"], [f"{scene}/seq-01@3:"]),
        ([f"{recording}@:9"], ["walk.mcap@8:"]),
        ([recording], ["again.mcap"]),
        (["bag"], [next((tmp_path / "bag").glob("*.mcap"))]),
        ([f"{recording}@:9", recording], []),  # of both the last part is held out
    ):
        with pytest.raises(
            TrainingError, match=r"shares images with .*; expected each image once, trained on or held out"
        ):
            train(data, tmp_path / "model.safetensors", TINY, validation=held_out)
    require_no_leakage([f"{recording}@:9", scene / "seq-01"], [f"{recording}@9:"])
    require_no_leakage([tmp_path / "absent"])


def test_fewer_images_than_a_batch_are_one_batch(tmp_path):
    config = replace(TINY, batch_size=64, calibrate=False, validation_fraction=0.0, epochs=2)
    result = train_on({"a": make_frames(5)}, tmp_path / "model.safetensors", config)
    assert result.images_seen == 10


def test_images_of_different_size_are_cropped_alike_or_refused():
    frames = make_frames(2)
    frames[1] = replace(frames[1], image=np.zeros((100, 90, 3), np.uint8))
    assert load_training_set({"a": frames}, (36, 36)).images.shape == (2, 36, 36, 3)
    with pytest.raises(TrainingError, match="a: image 2, at 1 ns, is 36 x 40 after scaling, expected 48 x 36"):
        load_training_set({"a": frames}, (36, 36), central=False)


def test_sequences_without_usable_poses_are_refused_by_name():
    frames = [replace(f, world_from_camera=None) for f in make_frames(3)]
    with pytest.raises(TrainingError, match="b: no image with a true pose"):
        load_training_set({"a": make_frames(3), "b": frames}, (36, 36))
    frames[1] = replace(frames[1], world_from_camera=Poses(np.eye(3), np.array([0.0, np.nan, 0.0])))
    with pytest.raises(TrainingError, match="b: true pose at 1 ns is not finite"):
        load_training_set({"b": frames}, (36, 36))


def _variety(count: int, *, moving: bool = True, seeing: bool = True, at: float = 0.0) -> dict[str, list[Frame]]:
    rng = np.random.default_rng(0)
    images = (
        rng.integers(0, 256, (count, 36, 48, 3), dtype=np.uint8)
        if seeing
        else rng.integers(9, 12, (count, 36, 48, 3), np.uint8)
    )
    where = [np.array([at + 0.1 * i * moving, 0.0, 0.0]) for i in range(count)]
    return {"walk.mcap": [Frame(i, images[i], None, Poses(np.eye(3), where[i])) for i in range(count)]}


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (_variety(30, moving=False), "walk.mcap: the camera does not move: all 30 true poses are within 5 mm and 0.5°"),
        (_variety(30, seeing=False), "walk.mcap: all 30 images are alike, to within a level of grey"),
        (_variety(30, at=5e6), "positions up to 5e\\+06 m from zero.*--ground-truth-origin"),
    ],
)
def test_data_from_which_nothing_can_be_learned_are_refused(data, said, tmp_path):
    with pytest.raises(TrainingError, match=said):
        train_on(data, tmp_path / "m.safetensors", TINY)
    assert not list(tmp_path.iterdir())


def test_few_images_are_learned_from_and_told(tmp_path):
    config = replace(TINY, epochs=1, calibrate=False)
    few, none = (
        "10 images to learn from: a place takes hundreds, along every path that will be walked",
        "no landmarks: no two images show the same from two sides; places stay as coarse as the network's",
    )
    assert train_on(_variety(10), tmp_path / "m.safetensors", config).notices == (few, none)
    assert train_on(_variety(100), tmp_path / "n.safetensors", config).notices == (none,)
    config = replace(config, landmarks=False)
    assert train_on(_variety(100), tmp_path / "n.safetensors", config).notices == ()


def test_points_of_two_reconstructions_are_not_taken_for_the_same(tmp_path) -> None:
    roots = [make_colmap(tmp_path / name, "sparse/0", "images") for name in "ab"]
    for root in roots:
        images = root / "sparse" / "0" / "images.txt"
        images.write_text(images.read_text().replace("2362.39 248.498 58396 1784.7 268.254 -1", "31 20 7 32 24 900"))
        (root / "sparse" / "0" / "points3D.txt").write_text("900 0 0 1 1 1 1 0\n7 1 0 1 1 1 1 0\n")
    loaded = load_training_set(open_sequences(roots), (32, 24), views=True)
    shown = [set(seen.point.tolist()) for seen in loaded.seen_points if seen and len(seen.point)]
    assert [len(each) for each in shown] == [2, 2]
    assert not shown[0] & shown[1]
    assert len(loaded.seen_points) == len(loaded) == 6
    assert load_training_set(open_sequences(roots), (32, 24)).seen_points == ()  # they are for landmarks only


@pytest.mark.parametrize("split", ["TrainSplit.txt", "transforms_train.json"])
def test_lists_of_splits_are_named_with_their_folder_as_they_are_all_named_alike(split):
    assert [*name_entries([f"a/{split}", f"b/{split}@3:5"])] == [f"a/{split}", f"b/{split}@3:5"]


@pytest.mark.parametrize("split", ["TrainSplit.txt", "transforms_train.json"])
def test_a_list_is_another_one_when_an_image_beside_it_changes(split, tmp_path):
    (tmp_path / split).write_text("")
    image = tmp_path / "image.png"
    image.write_bytes(b"one")
    before = identity(str(tmp_path / split))
    assert identity(str(tmp_path / split)) == before
    image.write_bytes(b"another")
    assert identity(str(tmp_path / split)) != before


def spans(numbers: np.ndarray) -> list[tuple[int, int]]:
    begins = np.flatnonzero(np.diff(numbers, prepend=-1))
    return list(zip(begins.tolist(), [*begins[1:].tolist(), len(numbers)], strict=True))


def test_passes_break_where_sequences_and_time_do():
    late = [replace(f, time_ns=f.time_ns + (2 * 10**9 if i >= 90 else 0)) for i, f in enumerate(frames_of(150))]
    slow = frames_of(20, step_ns=2 * 10**9)  # one image in two seconds is usual there
    images = load_training_set({"a": frames_of(60), "b": late, "slow": slow}, (36, 36))
    assert spans(pass_numbers(images)) == [(0, 60), (60, 150), (150, 210), (210, 230)]


def test_of_many_images_runs_of_ten_are_taken_all_over():
    np.testing.assert_array_equal(some_runs(70, 70), np.arange(70))
    chosen = some_runs(1000, 100)
    assert len(chosen) == 100
    assert (chosen[0], chosen[-1]) == (0, 999)
    assert sorted(set(np.diff(chosen).tolist())) == [1, 101]
    assert len(some_runs(60, 55)) <= 55
    np.testing.assert_array_equal(some_runs(9, 4), [0, 1, 2, 3])


def test_segments_of_odometry_have_one_true_pose_more_than_increments():
    frames = frames_of(150)
    frames[60] = replace(frames[60], odometry=None)
    images = load_training_set({"a": frames, "b": frames_of(30, odometry=False), "c": frames_of(30)}, (36, 36))
    segments = odometry_segments(images)
    assert [(len(s.odometry), len(s.truth), s.recording) for s in segments] == [(59, 60, 0), (89, 90, 0), (29, 30, 2)]
    np.testing.assert_array_equal(segments[1].truth[0].translation, frames[60].world_from_camera.translation)
    assert images.select(np.arange(5, 9)).odometry == (None, *images.odometry[6:9])
    assert odometry_segments(images.select(np.arange(0, 150, 2))) == []
    assert odometry_segments(images.select(np.arange(0))) == []


def colours(seed: int, *, warmth: int = 30, swapped: bool = False) -> Colours:
    """Of images of warm or cold light, each recording a little different."""
    rng, found = np.random.default_rng(seed), Colours()
    for _ in range(20):
        grey = rng.integers(60, 180, (12, 16, 1))
        image = np.clip(grey + np.array([warmth, 0, -warmth]) + rng.integers(-20, 20, (12, 16, 3)), 0, 255)
        found.take(np.ascontiguousarray((image[..., ::-1] if swapped else image).astype(np.uint8)))
    return found


def test_of_alike_recordings_nothing_is_said():
    assert said_of_colours({name: colours(i) for i, name in enumerate("abc")}) == []
    assert said_of_colours({"a": colours(0)}) == []
    assert said_of_colours({"grey": colours(0, warmth=0), "warm": colours(1)}) == []


@pytest.mark.parametrize(
    ("names", "said"),
    [("abc", "b: red and blue are swapped, beside"), ("ab", "a and b: red and blue are swapped in some of these")],
)
def test_the_recording_whose_colours_are_swapped_is_named_and_of_two_both(names, said):
    (notice,) = said_of_colours({name: colours(i, swapped=name == "b") for i, name in enumerate(names)})
    assert notice.startswith(said)


@pytest.mark.parametrize("count", [1, 3])
def test_where_all_are_bluish_it_is_asked(count):
    (said,) = said_of_colours({f"w{i}": colours(i, swapped=True) for i in range(count)})
    assert "more blue than red in nearly all images" in said
