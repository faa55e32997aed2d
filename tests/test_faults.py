"""Faults of camera and odometry: what each changes, how it is evaluated, and the command."""

import json
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest

from filtering.estimate import Mode
from filtering.localizer import ParticleLocalizer
from filtering.motion import Odometry
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from sequences.frame import Trajectory
from sequences.reader import SequenceReader
from sequences.trajectories.tum import write_tum
from vapor.benchmark.faults import benchmark as fault_benchmark
from vapor.benchmark.faults import recorded_walks, timing
from vapor.benchmark.faults.effects import (
    a_third,
    ahead,
    frozen,
    late,
    no_images,
    set_back,
    shown,
    standing_still,
    too_long,
    tripled,
)
from vapor.benchmark.faults.metrics import evaluate_fault, longest_run
from vapor.benchmark.faults.recorded_walks import RecordedWalk
from vapor.benchmark.faults.summary import summarise_faults
from vapor.benchmark.faults.table import FAULTS, NONE, impossible
from vapor.benchmark.faults.timing import find_moment, image_after
from vapor.benchmark.faults.walks import SyntheticWalk
from vapor.benchmark.trials.replay import Replay
from vapor.track import main
from vapor.tracking.belief import Belief
from vapor.tracking.dead_reckoning import dead_reckoning
from vapor.tracking.passage import posterior_of

pytestmark = pytest.mark.usefixtures("unchecked")

N = 30
DURING = range(10, 15)
OUTSIDE = [image for image in range(N) if image not in DURING]
TIMES_NS = 100_000_000 * np.arange(N, dtype=np.int64)


def walk() -> Replay:
    """Ever further ahead, and around; each image has two samples, which tell its number."""
    motions = [Poses.exp(np.array([0.01 * i, 0.0, 0.1, 0.0, 0.02, 0.0])) for i in range(N)]
    odometry = tuple(Odometry(motion, 1e-4 * np.eye(6), 0.1) for motion in motions)
    truth = dead_reckoning(Poses.identity(), odometry)
    return Replay(TIMES_NS, odometry, truth, lambda image: translated([[image, 0.0, 0.0]] * 2), np.full(N, 0.25), 0)


def translated(points) -> Poses:
    return Poses(np.tile(np.eye(3), (len(points), 1, 1)), np.array(points))


def motions(replay: Replay) -> np.ndarray:
    return np.stack([odometry.previous_from_current.as_matrix() for odometry in replay.odometry])


def seen(replay: Replay) -> list[float | None]:
    """The number of the image that the camera shows, None for one that says nothing."""
    poses = [replay.posterior_poses(image) for image in range(N)]
    return [float(each.translation[0, 0]) if len(each) else None for each in poses]


def assert_odometry_is_untouched(faulty: Replay, images=range(N)) -> None:
    np.testing.assert_array_equal(motions(faulty)[list(images)], motions(walk())[list(images)])
    for image in images:
        np.testing.assert_array_equal(faulty.odometry[image].covariance, walk().odometry[image].covariance)


def test_without_images_nothing_is_said_and_nothing_is_foreign():
    faulty = no_images(walk(), DURING)
    assert seen(faulty) == [None if image in DURING else image for image in range(N)]
    assert set(faulty.unfamiliarity[DURING]) == {0.0}
    assert set(faulty.unfamiliarity[OUTSIDE]) == {0.25}
    assert_odometry_is_untouched(faulty)


def test_an_image_that_says_nothing_moves_the_filter_as_no_image_does():
    replay, (one, other) = walk(), [ParticleLocalizer(None, rng=np.random.default_rng(0)) for _ in range(2)]
    for localizer in (one, other):
        localizer.update(PosePosterior.from_samples(translated([[0.0, 0.0, 0.0]]), posterior().errors), None)
    predicted, updated = one.predict(replay.odometry[3]), other.update(posterior(), replay.odometry[3])
    np.testing.assert_array_equal(predicted.log_weights, updated.log_weights)
    np.testing.assert_array_equal(predicted.covariances, updated.covariances)
    np.testing.assert_array_equal(predicted.particles.as_matrix(), updated.particles.as_matrix())
    assert (predicted.status, predicted.agreement) == (updated.status, updated.agreement)


def posterior(unfamiliarity: float = 0.0) -> PosePosterior:
    return posterior_of(Poses.identity(0), PosePosterior.nothing().errors, unfamiliarity)


def test_a_frozen_camera_says_nothing_and_is_as_unfamiliar_as_its_last_image():
    replay = walk()
    replay.unfamiliarity[9] = 1.5
    faulty = frozen(replay, DURING)
    assert seen(faulty) == [None if image in DURING else image for image in range(N)]
    assert set(faulty.unfamiliarity[DURING]) == {1.5}
    np.testing.assert_array_equal(faulty.unfamiliarity[OUTSIDE], replay.unfamiliarity[OUTSIDE])
    assert_odometry_is_untouched(faulty)
    assert posterior(1.5).is_foreign  # as ParticleLocalizer.observe leaves it


def test_other_images_are_shown_while_the_fault_lasts():
    faulty = shown(walk(), DURING, lambda image: translated([[100.0 + image, 0.0, 0.0]]), np.arange(float(N)))
    assert seen(faulty) == [100.0 + image if image in DURING else image for image in range(N)]
    np.testing.assert_array_equal(faulty.unfamiliarity[DURING], list(DURING))
    assert set(faulty.unfamiliarity[OUTSIDE]) == {0.25}
    assert_odometry_is_untouched(faulty)


def test_odometry_that_stands_still_reports_what_a_robot_at_rest_does():
    faulty = standing_still(walk(), DURING)
    assert_odometry_is_untouched(faulty, OUTSIDE)
    np.testing.assert_array_equal(motions(faulty)[list(DURING)], np.tile(np.eye(4), (len(DURING), 1, 1)))
    for image in DURING:
        std = np.sqrt(np.diagonal(faulty.odometry[image].covariance) / 0.1)  # after a second
        assert ((std[:3] > 0.008) & (std[:3] < 0.02)).all()
        assert ((std[3:] > 0.003) & (std[3:] < 0.01)).all()
        assert faulty.odometry[image].duration_s == 0.1


def test_tripled_odometry_goes_three_times_as_far_along_the_same_curve():
    faulty = tripled(walk(), DURING)
    assert_odometry_is_untouched(faulty, OUTSIDE)
    for image in DURING:
        once = motions(walk())[image]
        np.testing.assert_allclose(motions(faulty)[image], once @ once @ once, atol=1e-12)


def test_a_scale_error_makes_distances_longer_and_leaves_turns():
    faulty = too_long(walk(), DURING)
    assert_odometry_is_untouched(faulty, OUTSIDE)
    longer = motions(walk())
    longer[list(DURING), :3, 3] *= 1.2
    np.testing.assert_allclose(motions(faulty), longer, atol=1e-15)


def test_odometry_that_is_set_back_jumps_once_to_where_it_began():
    faulty = set_back(walk(), DURING)
    assert_odometry_is_untouched(faulty, [image for image in range(N) if image != DURING.start])
    poses, once = dead_reckoning(Poses.identity(), faulty.odometry), dead_reckoning(Poses.identity(), walk().odometry)
    assert np.linalg.norm(once.translation[9]) > 0.5
    np.testing.assert_allclose(poses[10].as_matrix(), motions(walk())[10], atol=1e-12)


def test_late_odometry_is_that_of_two_images_before():
    faulty = late(walk(), range(N))
    np.testing.assert_array_equal(motions(faulty)[3:], motions(walk())[1:-2])
    np.testing.assert_array_equal(motions(faulty)[:3], motions(walk())[[0, 1, 1]])


def test_a_clock_that_jumps_ahead_gives_the_motion_of_later_and_skips_images_when_it_is_back():
    faulty = ahead(walk(), DURING)
    poses, truth = dead_reckoning(Poses.identity(), faulty.odometry), walk().truth
    when = [*range(10), *range(20, 25), *[24] * 10, *range(25, 30)]  # what odometry tells of at each image
    np.testing.assert_allclose(poses.as_matrix(), truth[np.array(when)].as_matrix(), atol=1e-12)
    assert seen(faulty) == [None if image in range(15, 25) else image for image in range(N)]
    assert [each.duration_s for each in faulty.odometry][15:25] == [0.0] * 10
    assert sum(each.duration_s for each in faulty.odometry) == pytest.approx(0.1 * N)


def test_of_a_third_of_the_images_two_between_say_nothing():
    faulty = a_third(walk(), range(N))
    assert seen(faulty) == [None if image % 3 else image for image in range(N)]
    assert_odometry_is_untouched(faulty)


def test_faults_last_a_while_to_the_end_or_throughout():
    times_ns = 100_000_000 * np.arange(300, dtype=np.int64)
    assert FAULTS["black"].during(100, times_ns) == range(100, 150)
    assert FAULTS["black"].during(20, times_ns[::5]) == range(20, 30)
    assert FAULTS["noise"].during(100, times_ns) == range(100, 300)
    assert FAULTS["late"].during(100, times_ns) == range(300)


def test_a_fault_begins_once_the_filter_was_converged_for_a_while_and_never_too_late():
    times_ns = 100_000_000 * np.arange(300, dtype=np.int64)
    status = ["converged"] * 300
    assert find_moment(status, times_ns) == 50
    status[40] = "ambiguous"
    assert find_moment(status, times_ns) == 91
    assert find_moment(status[:240], times_ns[:240]) is None
    assert find_moment(status[:241], times_ns[:241]) == 91
    assert find_moment(["lost"] * 300, times_ns) is None


def test_the_longest_run_is_found_at_both_ends_and_between():
    for said, expected in (
        ("..xx.x", (2, 2)),
        ("xxx.xx", (0, 3)),
        ("x.xx", (2, 2)),
        ("xx.xx", (0, 2)),
        ("...", (0, 0)),
    ):
        assert longest_run(np.array([each == "x" for each in said])) == expected


def test_a_fault_is_evaluated_on_the_images_from_its_beginning_on():
    n, begin = 200, 40
    times_ns, truth = 100_000_000 * np.arange(n, dtype=np.int64), Poses.identity(n)
    off_m = np.zeros(n)
    off_m[60:80] = 1.0  # wrong, and sure of it for 15 images
    status = np.array(["ambiguous"] * n)
    status[begin:75] = "converged"
    status[75:90] = "lost"
    modes = [(Mode(translated([[x, 0.0, 0.0]])[0], np.eye(6), 1.0),) for x in off_m]
    found = evaluate_fault(Belief(modes, status.tolist()), times_ns, truth, begin, range(begin, begin + 50))
    assert found == {
        "success": True,
        "right": 140 / 160,
        "right_after": 1.0,
        "converged": 35 / 160,
        "lost": 15 / 160,
        "noticed": 15 / 20,
        "lost_ever": 15 / 200,
        "sure_and_wrong": 15 / 160,
        "longest_s": pytest.approx(1.5),
        "longest_at_s": 6.0,
    }


def evaluated(**more) -> dict:
    fractions = dict.fromkeys(
        ("right", "right_after", "converged", "lost", "noticed", "lost_ever", "sure_and_wrong"), 0.5
    )
    return {"success": True, **fractions, "longest_s": 0.0, "longest_at_s": None, **more}


def test_a_summary_averages_fractions_and_names_the_walks_that_failed():
    results = [
        {"name": name, "scene": "ceiling", "fault": fault, "begin": 50, "methods": {"filter": found}}
        for name, fault, found in (
            ("b", "black", evaluated(right=1.0, noticed=None, longest_s=1.2, longest_at_s=7.0)),
            ("a", "black", evaluated(right=0.0, success=False, longest_s=0.9, longest_at_s=3.0)),
            ("a", NONE, evaluated()),
            ("b", NONE, evaluated()),
        )
    ]
    summary = summarise_faults(results)
    assert list(summary["ceiling"]) == [NONE, "black"]
    total = summary["ceiling"]["black"]
    assert total["walks"] == 2
    ours = total["methods"]["filter"]
    assert (ours["successes"], ours["right"], ours["noticed"], ours["longest_s"]) == (1, 0.5, 0.5, 1.2)
    assert ours["unsuccessful"] == ["a"]
    assert ours["sure_and_wrong_walks"] == {"b": [7.0, 1.2]}


OPTIONS = [
    "--walks", "1", "--frames", "50", "--width", "32", "--height", "24", "--num-samples", "20", "--workers", "1",
    "--first-seed", "700", "--localizer.max-hypotheses", "4", "--faults", "black", "tripled", "upside-down",
    "three-times",
]  # fmt: skip
ALWAYS_SURE = [
    "--localizer.converged-weight", "0", "--localizer.converged-std-m", "1e9",
    "--localizer.converged-agreement", "1e-9",
]  # fmt: skip


def run(folder, tiny_model, *more: str) -> int:
    words = ["benchmark", "faults", "ceiling", "--models", str(tiny_model), "--output", str(folder)]
    return main([*words, *OPTIONS, *more])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """For all runs: they share recordings."""
    return tmp_path_factory.mktemp("faults")


@pytest.fixture
def short(monkeypatch) -> None:
    for name, duration_s in (("CONVERGED_S", 1.0), ("FAULT_S", 1.0), ("SETTLED_S", 1.0), ("REMAINING_S", 2.0)):
        monkeypatch.setattr(timing, name, duration_s)


@pytest.mark.usefixtures("short")
def test_a_walk_runs_without_and_with_every_fault_once(folder, tiny_model, monkeypatch, capsys):
    followed = []
    follow = SyntheticWalk.beliefs
    monkeypatch.setattr(SyntheticWalk, "beliefs", lambda walk, replay: followed.append(replay) or follow(walk, replay))
    assert run(folder, tiny_model, *ALWAYS_SURE) == 0
    assert len(followed) == 5
    out, summary = capsys.readouterr().out, (folder / "summary.json").read_bytes()
    for said in ("ceiling: 1 walks", "no fault", "black images", "odometry tripled", "images upside down"):
        assert said in out
    content = json.loads(summary)
    assert {each["fault"]: each["begin"] for each in content["runs"]} == dict.fromkeys(
        [NONE, "black", "tripled", "upside-down", "three-times"], 10
    )
    once, *_, more = followed
    np.testing.assert_array_equal(more.times_ns[::3], once.times_ns)
    np.testing.assert_allclose(more.truth[::3].as_matrix(), once.truth.as_matrix(), atol=1e-9)
    assert content["summary"]["ceiling"].keys() == {each["fault"] for each in content["runs"]}
    assert run(folder, tiny_model, *ALWAYS_SURE) == 0
    assert len(followed) == 5
    assert (capsys.readouterr().out, (folder / "summary.json").read_bytes()) == (out, summary)


@pytest.mark.usefixtures("short")
def test_walks_that_never_converge_are_an_error_in_the_end(folder, tiny_model, monkeypatch, capsys):
    monkeypatch.setattr(fault_benchmark, "_BARREN", 0)
    assert run(folder, tiny_model, "--localizer.converged-std-m", "0") == 1
    assert "ceiling: 0 of 1 walks from seed 700 on are converged for 1 s with 3 s to go, expected 1" in (
        capsys.readouterr().err
    )


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--faults", "fog"], "unknown fault 'fog', expected one of black, frozen"),
        (["--faults", "black", "black"], "expected each at most once"),
        (["--frames", "199"], "frames is 199, expected at least 200"),
        (["--walks", "0"], "walks is 0"),
    ],
)
def test_settings_that_cannot_be_are_refused(more, said, tmp_path, tiny_model, capsys):
    with pytest.raises(SystemExit):
        run(tmp_path, tiny_model, "--frames", "200", *more)
    assert said in capsys.readouterr().err.replace("\n", " ")


RECORDED_FAULTS = ("black", "frozen", "upside-down", "three-times", "elsewhere")


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> Path:
    """A walk of 5 s, as a file."""
    path = tmp_path_factory.mktemp("recordings") / "walk.mcap"
    words = ["synthesize", "ceiling", str(path), "--frames", "50", "--seed", "3", "--width", "32", "--height", "24"]
    assert main(words) == 0
    return path


def run_recorded(folder, tiny_model, *recordings: Path, more: tuple[str, ...] = ()) -> int:
    words = ["benchmark", "faults", "--recordings", *map(str, recordings), "--models", str(tiny_model)]
    words += ["--output", str(folder), *OPTIONS[4:-5], "--faults", *RECORDED_FAULTS]
    return main([*words, *ALWAYS_SURE, *more])


@pytest.mark.usefixtures("short")
def test_faults_befall_recordings_as_they_do_synthetic_walks(recording, tiny_model, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(recorded_walks, "_OTHER_IMAGES", 3)
    followed = []
    follow = RecordedWalk.beliefs
    monkeypatch.setattr(RecordedWalk, "beliefs", lambda walk, replay: followed.append(replay) or follow(walk, replay))
    before = recording.read_bytes()
    assert run_recorded(tmp_path, tiny_model, recording) == 0
    out, content = capsys.readouterr().out, json.loads((tmp_path / "summary.json").read_bytes())
    assert {each["fault"] for each in content["runs"]} == {NONE, *RECORDED_FAULTS} - {"three-times"}
    assert {each["name"] for each in content["runs"]} == {"walk"}
    assert "recorded: 1 walks" in out
    assert "left out, as recordings with this rate cannot have them: three-times" in " ".join(out.split())
    assert content["recordings"] == {"walk": str(recording)}
    assert content["partial"] == {}
    plain = followed[0]
    during = range(10, 20)  # a second, from the second of convergence on
    shown = {fault: seen_samples(replay) for fault, replay in zip((NONE, *RECORDED_FAULTS[:3]), followed, strict=False)}
    for image in range(50):
        same = {fault for fault, samples in shown.items() if np.array_equal(samples[image], shown[NONE][image])}
        assert same == (set(shown) if image not in during else {NONE})
    reader = SequenceReader(recording)
    np.testing.assert_array_equal(plain.times_ns, [frame.time_ns for frame in reader])
    (elsewhere,) = (tmp_path / "recordings").glob("corridor-*/settings.json")  # what this camera would see there
    assert reader.camera is not None
    assert json.loads(elsewhere.read_text())["camera"] == list(astuple(reader.camera))
    assert run_recorded(tmp_path, tiny_model, recording) == 0
    assert len(followed) == 5
    assert recording.read_bytes() == before


def seen_samples(replay: Replay) -> list[np.ndarray]:
    return [replay.posterior_poses(image).translation for image in range(len(replay.times_ns))]


@pytest.mark.usefixtures("short")
def test_recordings_that_no_fault_can_befall_are_named(recording, tiny_model, tmp_path, capsys):
    assert run_recorded(tmp_path, tiny_model, recording, more=("--localizer.converged-std-m", "0")) == 1
    said = "none of 1 recordings, the longest of 4.9 s, is converged for 1 s with 3 s to go, expected one at least"
    assert said in capsys.readouterr().err.replace("\n", " ")


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (
            ["--models", "staircase", "ceiling"],
            "--recordings beside 0 scenes and 2 --models, expected no scene and one",
        ),
        (["--walks", "3"], "--walks beside --recordings, expected it with scenes only"),
        (["--frames", "400"], "--frames beside --recordings"),
        (["--odometry-scale", "0.02"], "--odometry-scale beside --recordings"),
        (["--faults", "three-times"], "no fault but three-times, expected others"),
    ],
)
def test_what_recordings_cannot_have_is_refused(more, said, recording, tiny_model, tmp_path, capsys):
    with pytest.raises(SystemExit):
        run_recorded(tmp_path, tiny_model, recording, more=tuple(more))
    assert said in " ".join(capsys.readouterr().err.split())
    with pytest.raises(SystemExit):
        run(tmp_path, tiny_model, "--frames", "200", "--start-s", "7")
    assert "options of what to read without --recordings" in capsys.readouterr().err


@pytest.mark.usefixtures("short")
def test_a_recording_without_true_poses_is_refused_and_one_of_which_a_part_has_them_is_told(
    recording, tiny_model, tmp_path, capsys
):
    assert run_recorded(tmp_path, tiny_model, recording, more=("--ground-truth-topic", "")) == 1
    assert "true pose" in capsys.readouterr().err
    assert run_recorded(tmp_path, tiny_model, tmp_path / "missing.mcap") == 1
    assert "missing.mcap" in capsys.readouterr().err
    assert not list((tmp_path / "recordings").glob("*"))
    reader = SequenceReader(recording)
    frames = [frame for frame in reader if frame.world_from_camera is not None][:46]
    poses = Poses.stack([frame.world_from_camera for frame in frames if frame.world_from_camera is not None])
    write_tum(tmp_path / "part.tum", Trajectory(np.array([frame.time_ns for frame in frames]), poses))
    more = ("--poses", str(tmp_path / "part.tum"), "--faults", "frozen")
    twin = tmp_path / "other" / "walk.mcap"
    twin.parent.mkdir()
    twin.write_bytes(recording.read_bytes())
    assert run_recorded(tmp_path / "out", tiny_model, recording, twin, more=more) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "other-walk: 46 of 50 images have a true pose and odometry, and were used" in out


def test_images_are_counted_by_stamps_where_some_are_missing():
    times_ns = np.delete(TIMES_NS, range(12, 20))  # 0.8 s
    assert FAULTS["black"].during(2, np.append(times_ns, times_ns[-1] + 10**10)) == range(2, 22)
    assert image_after(1.0, 5, times_ns) == 12
    assert image_after(-0.5, 12, times_ns) == 12
    assert impossible(TIMES_NS) == []
    assert impossible(5 * TIMES_NS) == ["late"]
    assert find_moment(["converged"], TIMES_NS[:1]) is None
