"""Recordings inspected: figures against what is known of simulated ones, and what is said of bad ones."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from filtering.error_model import ErrorModel
from filtering.motion import Odometry
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from sequences.counts import OUTSIDE
from sequences.errors import SequenceError
from sequences.frame import Camera
from sequences.odometry import OdometryNoise, simulate_odometry
from sequences.pairing import interpolate
from sequences.scenes.paths import walk_stairs
from sequences.writer import SequenceWriter
from tests.sequence_files import BEGIN_NS as BEGIN_NS_OF_WALK
from tests.sequence_files import rewrite
from tests.test_datasets import make_tum
from tests.test_holding_out import corridor, recorded, stairwell
from vapor.evaluation.floors import find_floors
from vapor.inspection import odometry as odometry_module
from vapor.inspection.coverage import Coverage
from vapor.inspection.inspect import Inspection, inspect
from vapor.inspection.odometry import OdometryCheck, check_odometry
from vapor.inspection.plan import Plan
from vapor.inspection.reading import posed_images, read_walks
from vapor.inspection.verdict import GOOD_ENOUGH
from vapor.track import main
from vapor.training.holding_out import shown_by
from vapor.training_data.training_set import TrainingSet

SECOND = 10**9
BEGIN_NS = 1_700_000_000 * SECOND
CAMERA = Camera(64, 48, 50.0, 50.0, 31.5, 23.5)
LEVEL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # a camera that looks along the world's x
SCENERY = np.random.default_rng(0).integers(0, 256, (CAMERA.height, CAMERA.width, 3), np.uint8)


def scenery(index: int) -> np.ndarray:
    """Sharp, and another one each time."""
    return np.roll(SCENERY, index, axis=1)


def detailed(index: int) -> np.ndarray:
    """Likewise, in the size at which blur is judged, with coarse and fine detail."""
    coarse = cv2.resize(SCENERY, (320, 240), interpolation=cv2.INTER_CUBIC)
    return np.roll(coarse // 2 + np.tile(SCENERY, (5, 5, 1)) // 2, index, axis=1)


def write(
    path: Path,
    poses: Poses | None,
    *,
    count: int = 0,
    image: Callable[[int], np.ndarray] = scenery,
    times_s: np.ndarray | None = None,
    odometry: bool = True,
) -> Path:
    """A recording with exact odometry, ten images a second."""
    number = count if poses is None else len(poses)
    times_s = 0.1 * np.arange(number) if times_s is None else times_s
    with SequenceWriter(path, camera=CAMERA, base_from_camera=Poses.identity(), metadata={}) as writer:
        for i, time_s in enumerate(times_s):
            time_ns = BEGIN_NS + round(time_s * SECOND)
            if poses is not None and odometry:
                writer.write_odometry(time_ns, poses[0].inverse() @ poses[i], 1e-4 * np.eye(6))
            writer.write_image(time_ns, image(i))
            if poses is not None:
                writer.write_true_pose(time_ns, poses[i])
    return path


def walked(count: int = 120, *, at: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Poses:
    """Twice round a ring of two metres radius, looking ahead."""
    turn = np.linspace(0.0, 4.0 * np.pi, count)
    about = np.zeros((count, 3, 3))
    about[:, 0, 0] = about[:, 1, 1] = np.cos(turn + np.pi / 2)
    about[:, 1, 0] = np.sin(turn + np.pi / 2)
    about[:, 0, 1] = -about[:, 1, 0]
    about[:, 2, 2] = 1.0
    return Poses(about @ LEVEL, np.column_stack([2 * np.cos(turn), 2 * np.sin(turn), 0 * turn]) + np.array(at))


def compared(
    *, scale: float = 0.0, late_s: float = 0.0, turned: np.ndarray | None = None, seconds: float = 30.0
) -> OdometryCheck:
    """Odometry of a simulated walk of stairs at ten images a second, wrong as asked for, against its true poses."""
    rng = np.random.default_rng(3)
    path = walk_stairs(seconds + 2.0, rng=rng)
    path_ns = BEGIN_NS + np.arange(len(path)) * (SECOND // 50)
    noise = OdometryNoise(fixed_scale=scale, translation_bias_m_per_s=0.001, heading_bias_rad_per_s=0.0002)
    odometry, covariances = simulate_odometry(path_ns, path, noise, rng=rng)
    about = Poses(np.eye(3) if turned is None else turned, np.zeros(3))
    times_ns = BEGIN_NS + SECOND + np.arange(int(10 * seconds)) * (SECOND // 10)
    truth, _ = interpolate(path_ns, path, times_ns, max_gap_s=1.0)
    reported, _ = interpolate(path_ns, odometry, times_ns - round(late_s * SECOND), max_gap_s=1.0)
    reported = about.inverse() @ reported @ about
    steps = [None]
    for i in range(1, len(times_ns)):
        steps.append(Odometry(reported[i - 1].inverse() @ reported[i], 0.1 * covariances[1] * 0.1, 0.1))
    images = TrainingSet(
        np.zeros((len(times_ns), 1, 1, 3), np.uint8),
        np.arange(len(times_ns)),
        truth,
        np.zeros(len(times_ns), np.int64),
        ("walk",),
        (1, 1),
        times_ns,
        tuple(steps),
    )
    found = check_odometry(images)
    assert found is not None
    return found


def only(inspection: Inspection, *said: str) -> str:
    """The one sentence of a verdict that says all this."""
    (sentence,) = [each for each in inspection.verdict if all(words in each for words in said)]
    return sentence


# --- odometry ------------------------------------------------------------------------------------------


@pytest.fixture(autouse=True)
def unfitted(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    """Leaves out the fit of errors, which takes a second, but where it is what is tested."""

    def refuse(stretches: object) -> None:
        raise SequenceError("not in this test")

    if "fitted" not in request.fixturenames:
        monkeypatch.setattr(odometry_module, "fit_odometry", refuse)


@pytest.fixture
def fitted() -> None:
    """Asks for the fit of errors."""


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("late_s", [0.041, -0.12])
def test_odometry_that_is_late_is_said_to_be_by_as_many_milliseconds(late_s):
    found = compared(late_s=late_s, seconds=60.0)
    assert found.typical_late_ms == pytest.approx(1e3 * late_s, abs=8.0)
    assert found.axes is not None
    assert not found.axes.swapped


@pytest.mark.usefixtures("unchecked", "fitted")
def test_a_scale_error_of_three_percent_is_found():
    found = compared(scale=0.03)
    assert found.fit is not None
    assert found.fit.scale == pytest.approx(0.03, abs=0.008)
    assert found.axes is not None
    assert found.axes.correlation > 0.95
    assert not any((found.axes.swapped, found.axes.tilted, found.axes.unlike))


@pytest.mark.usefixtures("unchecked", "fitted")
def test_swapped_axes_are_named_and_put_right_before_errors_are_fitted():
    left = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])  # odometry's z is the true poses' -x
    found = compared(turned=left, scale=0.03)
    assert found.axes is not None
    assert found.axes.swapped
    np.testing.assert_allclose(found.axes.turned, left)
    assert found.axes.said().startswith("odometry's forward looks like the true poses' left")
    assert found.fit is not None
    assert found.fit.scale == pytest.approx(0.03, abs=0.008)


@pytest.mark.usefixtures("unchecked")
def test_a_camera_turned_by_less_on_its_base_is_noticed_too():
    turned = Poses.exp(np.array([0.0, 0.0, 0.0, 0.0, np.radians(25.0), 0.0])).rotation
    found = compared(turned=turned)
    assert found.axes is not None
    assert found.axes.tilted
    assert np.degrees(found.axes.off_rad) == pytest.approx(25.0, abs=2.0)


# --- clocks --------------------------------------------------------------------------------------------

SKY = np.zeros((180, 360), np.float32)
for size in (6, 15, 45, 180):
    noise = np.random.default_rng(size).uniform(0.0, 255.0 / 4, (size, 2 * size)).astype(np.float32)
    SKY += cv2.resize(noise, (360, 180), interpolation=cv2.INTER_CUBIC)


def panorama(pose: Poses) -> np.ndarray:
    """What a camera sees that is far away: bright or dark by the direction, coarse and fine."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(u.shape)], -1) @ pose.rotation.T
    around = 180 + np.degrees(np.arctan2(rays[..., 1], rays[..., 0]))
    down = 90 - np.degrees(np.arctan2(rays[..., 2], np.hypot(rays[..., 0], rays[..., 1])))
    seen = cv2.remap(SKY, around.astype(np.float32), down.astype(np.float32), cv2.INTER_LINEAR, None, cv2.BORDER_WRAP)
    return np.repeat(np.asarray(seen).clip(0, 255).astype(np.uint8)[..., None], 3, axis=-1)


def clocked(path: Path, *, seconds: float = 30.0, image: Callable[[Poses], np.ndarray] = panorama, **late_s: float):
    """A walk of stairs: images and true poses at 10 Hz, odometry at 50, each by a clock of its own."""
    rng = np.random.default_rng(3)
    walk = walk_stairs(seconds, rng=rng)
    times_ns = BEGIN_NS + np.arange(len(walk)) * (SECOND // 50)
    odometry, covariances = simulate_odometry(times_ns, walk, OdometryNoise(), rng=rng)
    base_from_camera = Poses(LEVEL, np.zeros(3))
    with SequenceWriter(path, camera=CAMERA, base_from_camera=base_from_camera, metadata={}) as writer:

        def write_image(time_ns: int, i: int) -> None:
            writer.write_image(time_ns, image(walk[i] @ base_from_camera))

        def write_odometry(time_ns: int, i: int) -> None:
            writer.write_odometry(time_ns, odometry[i], covariances[i])

        def write_pose(time_ns: int, i: int) -> None:
            writer.write_true_pose(time_ns, walk[i] @ base_from_camera)

        every = {"odometry": (1, write_odometry), "poses": (5, write_pose), "images": (5, write_image)}
        due = [
            (int(times_ns[i]) + round(late_s.get(what, 0.0) * SECOND), i, tell)
            for what, (step, tell) in every.items()
            for i in range(0, len(walk), step)
        ]
        for time_ns, i, tell in sorted(due, key=lambda each: each[:2]):
            tell(time_ns, i)
    return path


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("late_s", "odometry_ms", "images_ms"),
    [
        ({}, 0.0, 0.0),
        ({"images": 0.5}, 0.0, 500.0),
        ({"images": -1.5}, 0.0, -1500.0),
        ({"odometry": 0.5}, 500.0, -500.0),
        ({"poses": 0.5}, -500.0, 0.0),
        ({"poses": 0.5, "images": 0.5}, -500.0, 500.0),
    ],
)
def test_a_clock_that_is_off_is_found_and_named(late_s, odometry_ms, images_ms, tmp_path):
    found = inspect([clocked(tmp_path / "w.mcap", **late_s)])
    (clock,) = found.clocks
    assert clock.against == "odometry"
    assert clock.late_ms == pytest.approx(images_ms, abs=30.0)
    assert found.odometry is not None
    assert found.odometry.typical_late_ms == pytest.approx(odometry_ms, abs=8.0)
    said = [sentence for sentence in found.verdict if " against the " in sentence]
    assert len(said) == (odometry_ms != 0) + (images_ms != 0)
    if odometry_ms:
        assert re.match(rf"odometry is {OFF[odometry_ms > 0]} against the true poses", said[0])
    if images_ms:
        assert re.match(rf"the images of w\.mcap are {OFF[images_ms > 0]} against the odometry", said[-1])


OFF = (r"\d+ ms early", r"\d+ ms late")


@pytest.mark.usefixtures("unchecked")
def test_images_whose_view_does_not_shift_as_the_camera_turns_tell_no_clock(tmp_path):
    found = inspect([clocked(tmp_path / "w.mcap", image=lambda _: scenery(0), images=0.5)])
    assert [clock.late_ms for clock in found.clocks] == [None]
    assert not any("clock" in sentence or "against" in sentence for sentence in found.verdict)


# --- what is shown -------------------------------------------------------------------------------------


def test_a_floor_that_one_walk_alone_shows_is_said_with_its_images_and_height():
    coverage = Coverage.of(stairwell(top=(4,)))
    (stretch,) = coverage.alone()
    assert str(stretch) == "walk4: images 300 to 399 (height 9.0 m)"
    assert [floor.names for floor in coverage.floors()][-1] == ("walk4",)
    assert len(coverage.floors()) == 4
    np.testing.assert_array_equal(coverage.others == 0, coverage.images.poses.translation[:, 2] > 8.9)


def test_a_top_floor_where_all_walks_end_is_told_with_who_shows_it_and_how_late():
    walks = [
        Poses.concatenate(
            [corridor(0, 10, y_m=0.1 * i, z_m=3.0 * floor) for floor in range(3)] + [corridor(0, 3, y_m=0.1 * i, z_m=9)]
        )
        for i in range(5)
    ]
    coverage = Coverage.of(recorded(*walks))
    assert coverage.alone() == []
    top = coverage.floors()[-1]
    assert (len(top.names), top.trained, top.images) == (5, 4, 150)
    assert top.late == pytest.approx(30 / 330)
    assert (coverage.split.judged & (coverage.floor == 3)).sum() == 30


def test_what_is_shown_is_what_holding_out_calls_so():
    images = stairwell(top=(0, 1))
    coverage = Coverage.of(images)
    for number in np.unique(images.sequence[coverage.split.judged]):
        judged = coverage.split.judged & (images.sequence == number)
        assert (coverage.others[judged] > 0).all()


def test_another_pass_of_the_same_walk_counts_and_a_straight_one_does_not():
    once = recorded(corridor(0, 20))
    assert not shown_by(once, 1.0).any()
    twice = recorded(Poses.concatenate([corridor(0, 20), corridor(20, 0, y_m=0.2)]))
    assert shown_by(twice, 1.0).mean() > 0.8
    assert Coverage.of(twice).passes[len(Coverage.of(twice).passes) // 4].passes == 2
    backwards = recorded(Poses.concatenate([corridor(0, 20), corridor(20, 0, y_m=0.2, ahead=False)]))
    assert not shown_by(backwards, 1.0).any()


def test_cells_count_the_walks_through_them_and_which_way_they_looked():
    coverage = Coverage.of(recorded(*(corridor(0, 10, y_m=0.02 * i) for i in range(3)), corridor(10, 5, ahead=False)))
    middle = [cell for cell in coverage.passes if coverage.plan.cell_m * cell.column < 4.0]
    far = [cell for cell in coverage.passes if 6.0 < coverage.plan.cell_m * cell.column < 9.0]
    assert {cell.passes for cell in middle} == {3}
    assert {cell.passes for cell in far} == {4}
    assert all(dict(cell.looked) == {0: 3, 4: 1} for cell in far)


@pytest.mark.parametrize(
    ("rotation", "names", "looking"),
    [(np.eye(3), ("x", "y"), "east"), (np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]).T, ("x", "-z"), "+x")],
)
def test_up_is_where_cameras_are_upright(rotation, names, looking):
    poses = corridor(0, 10)
    turned = Poses(rotation @ poses.rotation, poses.translation @ rotation.T)
    plan = Plan.of(turned, 0.5)
    np.testing.assert_allclose(plan.axes[2], rotation[:, 2], atol=1e-12)
    assert plan.names == names
    assert {plan.direction(sector) for sector in plan.sectors(turned).tolist()} == {looking}


def test_floors_are_found_where_places_lie_above_each_other():
    x = np.linspace(0.0, 10.0, 101)
    cells = np.concatenate([np.floor(x), np.floor(x)]).astype(np.int64)
    floor, count = find_floors(np.concatenate([0 * x, 0 * x + 3.0]), cells)
    assert count == 2
    np.testing.assert_array_equal(floor, np.repeat([0, 1], 101))
    assert find_floors(0.5 * np.concatenate([x, x]), cells)[1] == 1  # a ramp
    assert find_floors(np.concatenate([0 * x, 0 * x + 0.8]), cells)[1] == 1  # a camera held higher


# --- images --------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("blur_px", [1.5, 6.0])
def test_a_gap_a_blurred_stretch_and_dark_images_are_counted_where_they_are(blur_px, tmp_path):
    def image(index: int) -> np.ndarray:
        if 30 <= index < 50:
            return cv2.GaussianBlur(detailed(index), (0, 0), blur_px)
        return detailed(index) // 40 if index >= 110 else detailed(index)

    times_s = 0.1 * np.arange(120) + 3.0 * (np.arange(120) >= 70)
    path = write(tmp_path / "w.mcap", walked(), image=image, times_s=times_s)
    found = inspect([path])
    (walk,) = found.walks
    assert walk.gaps == [(pytest.approx(6.9), pytest.approx(3.1))]
    np.testing.assert_array_equal(np.flatnonzero(walk.looks.blurred), np.arange(30, 50))
    np.testing.assert_array_equal(np.flatnonzero(walk.looks.dark), np.arange(110, 120))
    np.testing.assert_array_equal(np.flatnonzero(walk.looks.jumps), [110])
    assert walk.path_m == pytest.approx(8 * np.pi, rel=0.01)
    only(found, "17 % of the images of w.mcap are blurred")
    only(found, "8 % of the images of w.mcap are nearly black")
    only(found, "a gap of 3.1 s, 6.9 s after its start")


@pytest.mark.usefixtures("unchecked")
def test_a_dull_view_is_not_taken_for_blur(tmp_path):
    def image(index: int) -> np.ndarray:
        return detailed(index) if index < 80 else 100 + detailed(index) // 3

    (walk,) = read_walks([write(tmp_path / "w.mcap", walked(), image=image)])
    assert not walk.looks.blurred.any()


@pytest.mark.usefixtures("unchecked")
def test_images_all_alike_and_frozen_ones_are_said(tmp_path):
    same = inspect([write(tmp_path / "same.mcap", walked(), image=lambda _: scenery(0))])
    assert same.verdict[0] == "record same.mcap again: its 120 images are all one and the same"
    frozen = inspect([write(tmp_path / "f.mcap", walked(), image=lambda i: scenery(i if i < 40 else max(i, 60)))])
    assert frozen.walks[0].frozen == [(40, 60)]
    only(frozen, "20 images of f.mcap repeat the one before, such as 40 to 60")


# --- recordings that lack something --------------------------------------------------------------------


@pytest.mark.usefixtures("unchecked")
def test_a_good_recording_is_good_enough(tmp_path):
    paths = [write(tmp_path / f"w{i}.mcap", walked(60, at=(0.05 * i, 0.0, 0.0))) for i in range(4)]
    assert inspect(paths).verdict == (GOOD_ENOUGH,)


def test_without_true_poses_all_else_is_said_and_what_to_give(tmp_path):
    found = inspect([write(tmp_path / "w.mcap", None, count=30)])
    assert found.coverage is None
    assert found.odometry is None
    assert len(found.walks[0]) == 30
    assert found.verdict[0].startswith("give w.mcap true poses, which `train` needs: no ")
    json.dumps(found.as_json(), allow_nan=False)


@pytest.mark.parametrize("count", [1, 10])
def test_few_images_are_no_error(count, tmp_path):
    found = inspect([write(tmp_path / "w.mcap", walked(count))])
    only(found, "record more: ", f"{count} image")
    only(found, "nothing can be held out")
    json.dumps(found.as_json(), allow_nan=False)


def test_a_camera_that_stands_is_told_to_walk(tmp_path):
    still = Poses(np.tile(LEVEL, (110, 1, 1)), np.zeros((110, 3)))
    found = inspect([write(tmp_path / "w.mcap", still)])
    only(found, "the camera does not move (by 0.0 cm")
    assert found.odometry is not None
    assert found.odometry.axes is None


@pytest.mark.usefixtures("unchecked")
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
    damaged = BEGIN_NS_OF_WALK + 300_000_000
    path = rewrite(
        walk_of_25,
        tmp_path / "w.mcap",
        data=lambda topic, time_ns, data: b"" if topic.startswith("/camera/image") and time_ns == damaged else data,
    )
    assert main(["inspect", str(path)]) == 0
    said = capfd.readouterr().out
    assert "images     25 stated, 25 read, 24 used, 1 skipped" in said
    assert "skipped 1: undecodable image" in said
    assert main(["inspect", f"{path}@:10", f"{walk_of_25}@5:", "--json"]) == 0
    first, second = (walk["counts"] for walk in json.loads(capfd.readouterr().out)["walks"])
    assert (first["stated"], first["used"]) == (25, 10)
    assert first["skipped"] == {"undecodable image": 1, OUTSIDE: 14}
    assert (second["stated"], second["used"], second["skipped"]) == (25, 20, {OUTSIDE: 5})


def test_a_data_set_on_disk_is_inspected_as_well(tmp_path):
    found = inspect([make_tum(tmp_path / "desk")])
    assert found.coverage is not None
    assert found.odometry is None
    assert not any("odometry" in sentence for sentence in found.verdict)


# --- with a model --------------------------------------------------------------------------------------


class Mistaken:
    """Knows where each image is, in turn, but for a stretch that it puts elsewhere."""

    def __init__(self, poses: Poses, wrong: slice) -> None:
        self._poses, self._wrong, self._next = poses, range(*wrong.indices(len(poses))), 0

    def observe(self, image: np.ndarray, *, rng: np.random.Generator) -> PosePosterior:
        pose = self._poses[self._next]
        off = np.array([2.0, 0.0, 0.0]) * (self._next in self._wrong)
        self._next += 1
        return PosePosterior.from_samples(Poses(pose.rotation[None], pose.translation[None] + off), ErrorModel())


def test_where_a_model_errs_is_said_with_place_direction_and_passes(tmp_path):
    poses = corridor(0, 12)
    path = write(tmp_path / "w.mcap", poses)
    found = inspect([path], model=Mistaken(poses, slice(40, 50)))
    assert found.predictions is not None
    assert found.predictions.right.mean() == pytest.approx(1 - 10 / 120)
    sentence = only(found, "another walk should show")
    assert "looking east: median error 2 m over" in sentence
    assert "of one pass only" in sentence
    x = float(sentence.split("near (")[1].split(",")[0])
    assert 4.0 <= x <= 5.0


# --- the command ---------------------------------------------------------------------------------------


def test_the_command_writes_report_and_map_and_says_its_verdict(tmp_path, tiny_model, walk_of_25, capfd):
    words = ["inspect", str(walk_of_25), "--output", str(tmp_path / "out" / "deeper")]
    assert main([*words, "--model", str(tiny_model), "--num-samples", "20"]) == 0
    said = capfd.readouterr().out
    assert "Verdict" in said
    assert "1. record more: 25 images with true poses" in said
    report = json.loads((tmp_path / "out" / "deeper" / "report.json").read_text())
    assert report["walks"][0]["images"] == 25
    assert report["model"]["images"] == 25
    picture = cv2.imread(str(tmp_path / "out" / "deeper" / "map.png"))
    assert picture is not None
    assert picture.std() > 10
    assert main(["inspect", str(walk_of_25), "--json"]) == 0
    assert json.loads(capfd.readouterr().out)["verdict"] == report["verdict"][: len(report["verdict"])]


def test_the_command_refuses_what_it_cannot_read_with_one_line(tmp_path, capfd):
    assert main(["inspect", str(tmp_path / "none.mcap"), "--output", str(tmp_path / "out")]) == 1
    assert capfd.readouterr().err.count("\n") <= 2
    assert not (tmp_path / "out").exists()
    assert main(["inspect", str(tmp_path / "none.mcap@1:x")]) == 1
    assert "expected START:STOP" in capfd.readouterr().err
