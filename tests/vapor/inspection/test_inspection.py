"""Recordings inspected as a whole: what is said of good and bad ones."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from filtering.measurement_noise import MeasurementNoise
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from sequences.datasets.frames import posed_frames
from sequences.errors import SequenceError
from sequences.options import SequenceOptions
from sequences.reading.counts import OUTSIDE
from tests.helpers.corridors import corridor
from tests.helpers.data_sets import make_colmap, make_tum
from tests.helpers.inspected import LEVEL, detailed, only, panorama, scenery, walked, write
from tests.helpers.pages import ReadPage, entities_of
from tests.helpers.rigs import FRONT, LEFT, Rig
from tests.helpers.sequence_files import BEGIN_NS, Walk, rewrite
from vapor.inspection.inspect import inspect
from vapor.inspection.reading import posed_images, read_walks
from vapor.inspection.verdict import Verdict, verdict
from vapor.track import main

pytestmark = pytest.mark.usefixtures("no_odometry_fit")


# --- images --------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("unchecked", "no_views")
@pytest.mark.parametrize("blur_px", [1.5, 6.0])
def test_a_gap_a_blurred_segment_and_dark_images_are_counted_where_they_are(blur_px, tmp_path):
    def image(index: int) -> np.ndarray:
        if 30 <= index < 50:
            return cv2.GaussianBlur(detailed(index), (0, 0), blur_px)
        return detailed(index) // 40 if index >= 110 else detailed(index)

    times_s = 0.1 * np.arange(120) + 3.0 * (np.arange(120) >= 70)
    path = write(tmp_path / "w.mcap", walked(), image=image, times_s=times_s)
    found = inspect([path])
    (walk,) = found.walks
    assert walk.gaps == [(pytest.approx(6.9), pytest.approx(3.1))]
    np.testing.assert_array_equal(np.flatnonzero(walk.blurred), np.arange(30, 50))
    np.testing.assert_array_equal(np.flatnonzero(walk.dark), np.arange(110, 120))
    np.testing.assert_array_equal(np.flatnonzero(walk.jumps), [110])
    assert walk.path_m == pytest.approx(8 * np.pi, rel=0.01)
    only(found, "17 % of the images of w.mcap are blurred")
    only(found, "8 % of the images of w.mcap are nearly black")
    only(found, "the longest of 3.1 s, 6.9 s after its start")


@pytest.mark.usefixtures("unchecked")
def test_a_dull_view_is_not_taken_for_blur(tmp_path):
    def image(index: int) -> np.ndarray:
        return detailed(index) if index < 80 else 100 + detailed(index) // 3

    (walk,) = read_walks([write(tmp_path / "w.mcap", walked(), image=image)])
    assert not walk.blurred.any()


@pytest.mark.usefixtures("unchecked", "no_views")
def test_images_all_alike_and_frozen_ones_are_said(tmp_path):
    same = inspect([write(tmp_path / "same.mcap", walked(), image=lambda _: scenery(0))])
    assert same.verdict.points[0] == "record same.mcap again: its 120 images are all one and the same"
    frozen = inspect([write(tmp_path / "f.mcap", walked(), image=lambda i: scenery(i if i < 40 else max(i, 60)))])
    assert frozen.walks[0].frozen == [(40, 60)]
    only(frozen, "20 images of f.mcap repeat the one before, such as 40 to 60")


@pytest.mark.usefixtures("unchecked", "no_views")
def test_recordings_most_images_of_which_show_nothing_are_not_good_enough_and_those_some_of_which_do_are(tmp_path):
    for black, good_enough in ((100, False), (40, True)):
        images = [scenery(i) // (100 if i < black else 1) for i in range(len(walked()))]
        path = write(tmp_path / f"{black}.mcap", walked(), image=images.__getitem__)
        found = inspect([path])
        sentence = only(found, "of the images of", "are nearly black")
        assert (sentence in found.verdict.advice) == good_enough
        assert found.verdict.answer.startswith("Good enough" if good_enough else "Not good enough")


@pytest.mark.usefixtures("unchecked", "no_views", "no_camera")
def test_images_of_a_part_have_their_numbers_in_the_recording(tmp_path):
    black = [scenery(i) // (100 if i < 60 else 1) for i in range(120)]
    path = write(tmp_path / "w.mcap", walked(), image=lambda i: black[i if i < 100 else max(i, 110)])
    found = inspect([f"{path}@70:"])
    assert found.coverage is not None
    segments = found.coverage.alone()
    assert segments
    assert all(70 <= segment.first <= segment.last <= 119 for segment in segments)
    assert max(segment.last for segment in segments) == 119
    assert found.walks[0].frozen == [(100, 110)]
    only(found, "repeat the one before, such as 100 to 110")


def test_images_of_a_part_of_a_data_set_have_their_numbers_in_it(tmp_path):
    (walk,) = read_walks([f"{make_tum(tmp_path / 'desk')}@4:8"])
    assert walk.numbers.tolist() == [4, 5, 6, 7]
    images = posed_images([walk])
    assert images is not None
    assert images.number.tolist() == [4, 5, 6, 7]


def test_parts_that_share_images_are_refused_as_by_train(tmp_path, capfd):
    data = make_tum(tmp_path / "desk")
    for command in (["inspect"], ["train", "--output", str(tmp_path / "m.safetensors")]):
        assert main([*command, f"{data}@:6", f"{data}@4:"]) == 1
        said = f"{data}@4:: shares images with {data}@:6; expected each image once, trained on or held out"
        assert said in capfd.readouterr().err


@pytest.mark.usefixtures("unchecked", "no_views", "no_camera")
@pytest.mark.parametrize("recorded", [False, True])
def test_a_range_beyond_the_end_is_said_and_one_wholly_beyond_refused(recorded, tmp_path, walk_of_25):
    data, count = (walk_of_25, 25) if recorded else (make_tum(tmp_path / "desk"), 10)
    found = inspect([f"{data}@4:900"])
    said = f"images 4:900 were asked for, and there are {count}, numbered 0 to {count - 1}: 4 to {count - 1} were taken"
    assert found.walks[0].source.notices.count(f"{data}: {said}") == 1
    assert not any("were asked for" in each for each in inspect([f"{data}@4:{count}"]).walks[0].source.notices)
    frames = posed_frames(data, frames=slice(4, 900))
    assert [frame.number for frame in frames] == list(range(4, count))
    assert frames.notices.count(f"{data}: {said}") == 1
    with pytest.raises(SequenceError, match=f"frames 800:: there are {count}, numbered 0 to {count - 1}$"):
        inspect([f"{data}@800:"])


@pytest.mark.usefixtures("unchecked", "no_views", "no_camera")
def test_a_range_beyond_the_end_of_one_of_several_cameras_names_the_camera(tmp_path):
    path = Rig({"left": 0}, {"left": 4}).write(tmp_path / "rig.mcap", Walk(11))
    (source,) = {id(walk.source): walk.source for walk in read_walks([f"{path}@2:12"])}.values()
    asked = "images 2:12 were asked for, and there are"
    said = [notice for notice in source.notices if asked in notice]
    assert said == [
        f"{path}, {FRONT}: {asked} 11, numbered 0 to 10: 2 to 10 were taken",
        f"{path}, {LEFT}: {asked} 3, numbered 0 to 2: 2 was taken",
    ]


# --- recordings that lack something --------------------------------------------------------------------


@pytest.mark.usefixtures("unchecked")
def test_a_good_recording_is_good_enough(tmp_path):
    walks = [walked(60, at=(0.05 * i, 0.0, 0.0)) for i in range(4)]
    paths = [write(tmp_path / f"w{i}.mcap", w, image=lambda j, w=w: panorama(w[j])) for i, w in enumerate(walks)]
    found = inspect(paths)
    assert found.verdict == Verdict((), ())
    assert found.verdict.answer == "Good enough to train on: nothing found that another recording would mend"


def test_without_true_poses_all_else_is_said_and_what_to_give(tmp_path):
    found = inspect([write(tmp_path / "w.mcap", None, count=30)])
    assert found.coverage is None
    assert found.odometry is None
    assert len(found.walks[0]) == 30
    assert found.verdict.points[0].startswith("give w.mcap true poses, which `train` needs: no ")
    json.dumps(found.as_json(), allow_nan=False)


def test_few_images_without_true_poses_are_said_to_be_few(tmp_path):
    found = inspect([write(tmp_path / "w.mcap", None, count=3)])
    only(found, "record more: 3 images, expected some hundreds at least")


def test_odometry_that_is_recorded_and_cannot_be_used_is_not_said_to_be_absent(tmp_path, capfd):
    path = write(tmp_path / "w.mcap", walked(12))
    path = rewrite(path, tmp_path / "loose.mcap", keep=lambda topic, _: topic != "/tf_static")
    found = inspect([path])
    sentence = only(found, "odometry of loose.mcap")
    assert sentence.startswith("make the odometry of loose.mcap usable, 12 messages of /odom: no transform from ")
    assert "`run --odometry visual` makes it from the images" in sentence
    none = inspect([rewrite(path, tmp_path / "none.mcap", keep=lambda topic, _: topic != "/odom")])
    sentence = only(none, "odometry")
    assert sentence.startswith("record odometry too: none in none.mcap (")
    assert sentence.endswith("; training does without, and `run` makes it from the images, less exactly")


def test_recordings_with_odometry_that_cannot_be_used_and_those_without_are_said_apart(tmp_path):
    path = write(tmp_path / "w.mcap", walked(12))
    loose = [rewrite(path, tmp_path / f"loose{i}.mcap", keep=lambda t, _: t != "/tf_static") for i in range(2)]
    none = rewrite(path, tmp_path / "none.mcap", keep=lambda topic, _: topic != "/odom")
    found = inspect([none, *loose])
    sentence = only(found, "make the odometry of")
    assert sentence.startswith("make the odometry of loose0.mcap and loose1.mcap usable, 24 messages of /odom: no tra")
    assert only(found, "record odometry too").startswith("record odometry too: none in none.mcap (")


def test_the_command_that_makes_poses_names_the_camera_that_was_named(tmp_path):
    path = write(tmp_path / "w.mcap", None, count=3)
    found = inspect([path], SequenceOptions(image_topic="/camera/image/compressed"))
    only(found, f"`vapor-track map {path} --image-topic /camera/image/compressed --output place/` makes them")


@pytest.mark.usefixtures("unchecked", "no_views", "no_camera")
def test_ground_that_is_shown_once_is_told_to_be_walked_again_with_what_that_means_for_train(tmp_path):
    once = inspect([write(tmp_path / "once.mcap", corridor(0, 20))])
    sentence = only(once, "walk again over what no other pass shows, 100 % of the images: once.mcap: images 0 to 199")
    assert sentence.endswith("finds errors only between images that it learned from, not on another walk")
    assert once.verdict.answer == "Good enough to train on; the points say what would make a better model"


@pytest.mark.parametrize("count", [1, 10])
def test_few_images_are_no_error(count, tmp_path):
    found = inspect([write(tmp_path / "w.mcap", walked(count))])
    only(found, f"record more: {count} image")
    only(found, "nothing can be held out")
    json.dumps(found.as_json(), allow_nan=False)


def test_a_camera_that_stands_is_told_to_walk(tmp_path):
    still = Poses(np.tile(LEVEL, (110, 1, 1)), np.zeros((110, 3)))
    found = inspect([write(tmp_path / "w.mcap", still)])
    only(found, "the camera does not move (by 0.0 cm")
    assert found.odometry is not None
    assert found.odometry.axes is None


@pytest.mark.usefixtures("unchecked", "no_views")
def test_poses_far_from_zero_give_the_same_figures(tmp_path):
    near, far = (
        inspect([write(tmp_path / f"{name}.mcap", walked(at=at))])
        for name, at in (("near", (0.0, 0.0, 0.0)), ("far", (1e5, -1e5, 0.0)))
    )
    assert near.coverage is not None
    assert far.coverage is not None
    np.testing.assert_array_equal(near.coverage.others, far.coverage.others)
    assert [cell.passes for cell in near.coverage.passes] == [cell.passes for cell in far.coverage.passes]
    assert far.notices
    assert "from zero" in far.notices[0]


@pytest.mark.usefixtures("unchecked")
def test_a_range_takes_the_images_that_training_takes(tmp_path):
    path = write(tmp_path / "w.mcap", walked())
    images = posed_images(read_walks([f"{path}@20:50", f"{path}@60:"]))
    assert images is not None
    assert np.bincount(images.sequence).tolist() == [30, 60]
    assert [i for i, step in enumerate(images.odometry) if step is None] == [0, 30]
    np.testing.assert_allclose(images.poses[0].translation, walked()[20].translation, atol=1e-9)


def test_images_are_counted_as_a_run_counts_them(walk_of_25, tmp_path, capfd):
    damaged = BEGIN_NS + 300_000_000
    path = rewrite(
        walk_of_25,
        tmp_path / "w.mcap",
        data=lambda topic, time_ns, data: b"" if topic.startswith("/camera/image") and time_ns == damaged else data,
    )
    assert main(["inspect", str(path)]) == 1
    said = capfd.readouterr().out
    assert "images     25 stated, 25 read, 24 used, 1 skipped" in said
    assert "skipped 1: undecodable image" in said
    first, second = (walk.as_json()["counts"] for walk in inspect([f"{path}@:10", f"{walk_of_25}@5:"]).walks)
    assert (first["stated"], first["used"]) == (25, 10)
    assert first["skipped"] == {"undecodable image": 1, OUTSIDE: 14}
    assert (second["stated"], second["used"], second["skipped"]) == (25, 20, {OUTSIDE: 5})


def test_a_data_set_on_disk_is_inspected_as_well(tmp_path):
    found = inspect([make_tum(tmp_path / "desk")])
    assert found.coverage is not None
    assert found.odometry is None
    assert not any("odometry" in sentence for sentence in found.verdict.points)


# --- with a model --------------------------------------------------------------------------------------


class Mistaken:
    """Knows where each image is, in turn, but for a segment that it puts elsewhere."""

    def __init__(self, poses: Poses, wrong: slice) -> None:
        self._poses, self._wrong, self._next = poses, range(*wrong.indices(len(poses))), 0

    def observe(self, image: np.ndarray, *, rng: np.random.Generator) -> PosePosterior:
        pose = self._poses[self._next]
        off = np.array([2.0, 0.0, 0.0]) * (self._next in self._wrong)
        self._next += 1
        return PosePosterior.from_samples(Poses(pose.rotation[None], pose.translation[None] + off), MeasurementNoise())


def test_where_a_model_errs_is_said_with_place_direction_and_passes(tmp_path):
    poses = corridor(0, 12)
    path = write(tmp_path / "w.mcap", poses)
    found = inspect([path], model=Mistaken(poses, slice(40, 50)))
    assert found.predictions is not None
    assert found.predictions.right.mean() == pytest.approx(1 - 10 / 120)
    sentence = only(found, "another walk should show")
    assert "looking +x: median error 2 m over" in sentence
    assert "of one pass" in sentence
    x = float(sentence.split("near (")[1].split(",")[0])
    assert 4.0 <= x <= 5.0
    unlike = replace(found.predictions, ood_score=np.full(120, 2.0))
    said = verdict(found.walks, found.coverage, None, (), unlike).points
    assert said[-1] == "train on more of this: 100 % of the images look unlike all that the model was trained on"
    unlike = replace(unlike, why_out_of_distribution="they are dark")
    said = verdict(found.walks, found.coverage, None, (), unlike).points
    assert said[-1] == "100 % of the images look unlike all that the model was trained on: they are dark"


@pytest.mark.usefixtures("unchecked", "no_views")
def test_dim_images_poses_in_millimetres_and_swapped_colours_are_said(tmp_path):
    coloured = scenery(0) // 2 + np.array([60, 30, 0], np.uint8)
    changes = {
        "good": lambda i: np.roll(coloured, i, axis=1),
        "dim": lambda i: np.roll(coloured, i, axis=1) // 4,
        "swapped": lambda i: np.ascontiguousarray(np.roll(coloured, i, axis=1)[..., ::-1]),
    }
    paths = [write(tmp_path / f"{name}.mcap", walked(), image=image) for name, image in changes.items()]
    far = Poses(walked().rotation, 1e3 * walked().translation)
    paths.append(write(tmp_path / "mm.mcap", far, image=changes["good"]))
    found = inspect(paths)
    only(found, "make light, or expose for longer: the images of dim.mcap are dark, ")
    assert found.verdict.answer == "Not good enough to train on yet: put right the first 2 points"
    assert [sentence.split()[0] for sentence in found.verdict.faults] == ["check", "swapped.mcap:"]  # the unit, colours
    only(found, "swapped.mcap: red and blue are swapped, beside the other recordings")
    only(found, "check the unit of the poses of mm.mcap: the camera moves at", "are they in millimetres?")
    assert not any("good.mcap" in sentence and "record" not in sentence for sentence in found.verdict.points)


# --- the command ---------------------------------------------------------------------------------------


def test_the_command_writes_report_and_map_and_says_its_verdict(tmp_path, tiny_model, walk_of_25, capfd):
    words = ["inspect", str(walk_of_25), "--output", str(tmp_path / "out" / "deeper")]
    assert main([*words, "--model", str(tiny_model)]) == 1
    said, err = capfd.readouterr()
    assert err.endswith("\nvapor-track inspect: not good enough to train on yet: 1 point to put right\n")
    assert "Verdict" in said
    assert "Not good enough to train on yet: put right the first " in said
    assert "1. record more: 25 images with true poses" in said
    report = json.loads((tmp_path / "out" / "deeper" / "report.json").read_text())
    assert report["walks"][0]["images"] == 25
    assert report["model"]["images"] == 25
    page = ReadPage.of((tmp_path / "out" / "deeper" / "report.html").read_text())
    assert f"{report['verdict']['answer']}." in page.words
    assert all(sentence in page.words for sentence in report["verdict"]["faults"] + report["verdict"]["advice"])
    assert page.cells[page.cells.index("images") + 10 :][:3] == [walk_of_25.name, "25", "25"]
    picture = cv2.imread(str(tmp_path / "out" / "deeper" / "map.png"))
    assert picture is not None
    assert picture.std() > 10


def test_the_command_records_cameras_images_and_predictions_in_space_unless_told_not_to(
    tmp_path, tiny_model, walk_of_25, capfd
):
    words = ["inspect", str(walk_of_25), "--output", str(tmp_path / "out")]
    assert main([*words, "--model", str(tiny_model)]) == 1
    assert f"rerun {tmp_path / 'out' / 'recording.rrd'}" in capfd.readouterr().out
    entities = entities_of(tmp_path / "out" / "recording.rrd")
    assert {f"/world/images/{number}" for number in range(25)} <= entities
    assert "/world/cameras/1_pass" in entities
    assert {"/world/model/right", "/world/model/wrong"} & entities
    assert "/legend" in entities
    assert main([*words, "--no-recording"]) == 1
    assert "rerun" not in capfd.readouterr().out
    assert not (tmp_path / "out" / "recording.rrd").exists()


def test_the_recording_holds_the_sparse_points_of_a_colmap_model(tmp_path):
    root = make_colmap(tmp_path / "scene", "sparse", "images")
    (root / "sparse" / "points3D.txt").write_text("1 0.5 1 1.5 10 20 30 0.5 1 0\n")
    assert main(["inspect", str(root), "--output", str(tmp_path / "out")]) == 1
    assert "/world/place/points/0" in entities_of(tmp_path / "out" / "recording.rrd")


@pytest.mark.usefixtures("unchecked", "no_views")
def test_the_table_of_recordings_fits_80_columns(tmp_path, capfd, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert main(["inspect", str(make_tum(tmp_path / ("a-long-name-of-a-walk-" * 3)))]) == 1
    out = capfd.readouterr().out
    assert "…" not in out
    table = [line for line in out.splitlines() if set("│┃┏┡└") & set(line)]
    assert len(table) > 4
    assert max(map(len, table)) <= 80


def test_the_command_refuses_what_it_cannot_read_with_one_line(tmp_path, capfd):
    assert main(["inspect", str(tmp_path / "none.mcap"), "--output", str(tmp_path / "out")]) == 1
    assert capfd.readouterr().err.count("\n") <= 2
    assert not (tmp_path / "out").exists()
    assert main(["inspect", str(tmp_path / "none.mcap@1:x")]) == 1
    assert "none.mcap@1:x: @1:x is no part, expected @START:STOP" in capfd.readouterr().err
