"""`vapor-benchmark faults`, on synthetic walks and recorded ones."""

import json
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest

from filtering.se3 import Poses
from sequences.frame import Trajectory
from sequences.reader import SequenceReader
from sequences.trajectories.tum import write_tum
from tests.helpers.full import full
from tests.helpers.measured import tables_on_the_page
from vapor import track
from vapor.benchmark.__main__ import main
from vapor.benchmark.faults import runs, table, walks
from vapor.benchmark.faults.table import NONE
from vapor.benchmark.faults.walks import RecordedWalk, SyntheticWalk
from vapor.benchmark.trials.replay import Replay

pytestmark = pytest.mark.usefixtures("unchecked", "rough_light_in_module")

OPTIONS = [
    "--walks", "1", "--frames", "50", "--width", "32", "--height", "24", "--num-samples", "20", "--workers", "1",
    "--first-seed", "700", "--localizer.max-hypotheses", "4", "--faults", "black", "tripled", "upside-down",
    "three-times",
]  # fmt: skip

ALWAYS_SURE = [
    "--localizer.converged-weight", "0", "--localizer.converged-std-m", "1e9",
    "--localizer.converged-agreement", "1e-9", "--localizer.lost-unassigned", "1",
]  # fmt: skip


def run(folder, tiny_model, *more: str) -> int:
    words = ["faults", "ceiling", "--models", str(tiny_model), "--output", str(folder)]
    return main([*words, *OPTIONS, *more])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """For all runs: they share recordings."""
    return tmp_path_factory.mktemp("faults")


@pytest.fixture
def short(monkeypatch) -> None:
    for name, duration_s in (("CONVERGED_S", 1.0), ("FAULT_S", 1.0), ("SETTLED_S", 1.0), ("REMAINING_S", 2.0)):
        monkeypatch.setattr(table, name, duration_s)


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
    (shown,) = tables_on_the_page("faults", folder / "summary.json")
    assert {name for name, _ in shown["rows"]} == {f"ceiling, {each['fault']}" for each in content["runs"]}
    assert run(folder, tiny_model, *ALWAYS_SURE) == 0
    assert len(followed) == 5
    assert (capsys.readouterr().out, (folder / "summary.json").read_bytes()) == (out, summary)


@pytest.mark.usefixtures("short")
def test_walks_that_never_converge_are_an_error_in_the_end(folder, tiny_model, monkeypatch, capsys):
    monkeypatch.setattr(runs, "_BARREN", 0)
    assert run(folder, tiny_model, "--localizer.converged-std-m", "0") == 1
    said = "ceiling, seeds 700 on: 0 of 1 walks are converged for 1 s with 3 s to go, expected 1"
    assert said in capsys.readouterr().err


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
    assert track.main(words) == 0
    return path


def run_recorded(folder, tiny_model, *recordings: Path, more: tuple[str, ...] = ()) -> int:
    words = ["faults", "--recordings", *map(str, recordings), "--models", str(tiny_model)]
    words += ["--output", str(folder), *OPTIONS[4:-5], "--faults", *RECORDED_FAULTS]
    return main([*words, *ALWAYS_SURE, *more])


@full
@pytest.mark.usefixtures("short")
def test_faults_befall_recordings_as_they_do_synthetic_walks(recording, tiny_model, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(walks, "_OTHER_IMAGES", 3)
    followed = []
    follow = RecordedWalk.beliefs
    monkeypatch.setattr(RecordedWalk, "beliefs", lambda walk, replay: followed.append(replay) or follow(walk, replay))
    before = recording.read_bytes()
    assert run_recorded(tmp_path, tiny_model, recording) == 0
    out, content = capsys.readouterr().out, json.loads((tmp_path / "summary.json").read_bytes())
    assert {each["fault"] for each in content["runs"]} == {NONE, *RECORDED_FAULTS} - {"three-times"}
    assert {each["name"] for each in content["runs"]} == {"walk"}
    assert "recorded: 1 walks" in out
    assert "left out, as recordings have no images between theirs: three-times" in " ".join(out.split())
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
    return [replay.observed(image).samples.translation for image in range(len(replay.times_ns))]


@pytest.mark.usefixtures("short")
def test_recordings_that_no_fault_can_befall_are_named(recording, tiny_model, tmp_path, capsys):
    assert run_recorded(tmp_path, tiny_model, recording, more=("--localizer.converged-std-m", "0")) == 1
    said = "recordings: 0 of 1 walks are converged for 1 s with 3 s to go, expected 1"
    assert said in capsys.readouterr().err.replace("\n", " ")


def test_options_of_scenes_and_of_recordings_do_not_go_together(recording, tiny_model, tmp_path, capsys):
    with pytest.raises(SystemExit):
        run_recorded(tmp_path, tiny_model, recording, more=("--models", "staircase", "ceiling"))
    said = "--recordings beside 0 scenes and 2 --models, expected no scene and one"
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
