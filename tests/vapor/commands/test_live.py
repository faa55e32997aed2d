"""`vapor-track live` and `replay`, as commands."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.command_line import refuse
from tests.helpers.live_system import free_domain, wait_for

LIVE = [sys.executable, "-m", "vapor.track", "live", "--localhost"]


def test_what_is_replayed_is_localized_until_sigterm_ends_it_well(
    walk_of_25: Path, tiny_model: Path, tmp_path: Path
) -> None:
    domain, log = str(free_domain()), tmp_path / "live.log"
    command = [*LIVE, "--domain", domain, "--model", str(tiny_model), "--engine", "torch", "--record", "drive.mcap"]
    replay = [sys.executable, "-m", "vapor.track", "replay", str(walk_of_25), "--localhost", "--domain", domain]
    with log.open("wb") as out:
        live = subprocess.Popen(command, stdout=out, stderr=subprocess.STDOUT, cwd=tmp_path)
        try:
            wait_for("waits: ", log)
            told = subprocess.run(replay, check=True, capture_output=True, text=True, timeout=60).stdout
            live.send_signal(signal.SIGTERM)
            assert live.wait(20) == 0
        finally:
            live.kill()
    assert f"messages published in ROS domain {domain}" in told
    said = log.read_text()
    assert "localizes by /camera/image/compressed, /camera/camera_info and /odom" in said
    assert " images localized in " in said
    assert [file.name for file in tmp_path.iterdir() if file.suffix == ".mcap"] == ["drive.mcap"]


def test_a_model_that_is_missing_is_told_before_anything_is_joined(capsys: pytest.CaptureFixture[str]) -> None:
    refuse(["live", "--model", "nowhere.safetensors"], capsys, "nowhere.safetensors")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--domain", "300"], "ROS domain is 300, expected 0 to 232"),
        (["--peer", "a b"], "peer is 'a b', expected an address"),
        (["--tf-ahead-s", "-1"], "tf_ahead_s is -1.0, expected"),
        (["--under", "estimate"], "under is 'estimate', expected"),
        (["--foxglove-port", "70000"], "foxglove_port is 70000, expected"),
        (["--odometry-topic", "/odom", "--odometry-frame", "odom"], "expected one of them"),
    ],
)
def test_wrong_options_are_refused(words: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    from vapor.track import main

    with pytest.raises(SystemExit) as ended:
        main(["live", "--model", "staircase", *words])
    assert ended.value.code == 2
    assert said in capsys.readouterr().err


def test_a_recording_that_is_missing_is_refused_by_replay(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    refuse(["replay", str(tmp_path / "none.mcap"), "--localhost"], capsys, "none.mcap")


def test_a_domain_of_the_environment_that_is_none_is_told(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from vapor.track import main

    monkeypatch.setenv("ROS_DOMAIN_ID", "nine")
    with pytest.raises(SystemExit):
        main(["live", "--model", "staircase"])
    assert "ROS_DOMAIN_ID is 'nine', expected a number from 0 to 232" in capsys.readouterr().err


def test_a_domain_that_cannot_be_joined_is_told(
    monkeypatch: pytest.MonkeyPatch, tiny_model: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("CYCLONEDDS_URI", "<CycloneDDS><Domain><General><Interfaces>")
    domain = str(free_domain())
    line = refuse(["live", "--model", str(tiny_model), "--domain", domain], capsys, f"ROS domain {domain} cannot be")
    assert "joined" in line
