"""Recordings of a benchmark: the user's own path through a file, kept exactly, once, and for nothing else."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from filtering.errors import VaporTrackError
from sequences.reader import SequenceReader
from sequences.synthesize import synthesize, write_synthetic
from vapor import recordings
from vapor.checkpoint import Checkpoint, load_checkpoint
from vapor.observation import VaporObservationModel
from vapor.recordings import RecordingSettings, camera_path, load_recording, make_recording
from vapor.trials import assemble
from vapor.windows import Piece, Trial

SETTINGS = RecordingSettings("ceiling", 5, "early", 12, 48, 36, "0" * 64, 30)


@pytest.fixture(scope="module")
def checkpoint(tiny_model: Path) -> Checkpoint:
    return load_checkpoint(tiny_model)


@pytest.fixture(scope="module")
def directory(checkpoint, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("recordings")
    make_recording(SETTINGS, checkpoint, path)
    make_recording(replace(SETTINGS, seed=6), checkpoint, path)
    return path


def test_a_recording_holds_what_reading_and_observing_the_file_gives(directory, checkpoint, tmp_path):
    recording = load_recording(SETTINGS, directory)
    sequence = synthesize("ceiling", seed=5, num_frames=12, width=48, height=36)
    write_synthetic(sequence, tmp_path / "s.mcap")
    model = VaporObservationModel(checkpoint, num_samples=30, device="cpu")
    rng = np.random.default_rng([5, 30])
    frames = list(SequenceReader(tmp_path / "s.mcap"))
    assert len(frames) == 12
    for i, frame in enumerate(frames):
        assert recording.times_ns[i] == frame.time_ns
        np.testing.assert_array_equal(
            recording.posterior_poses(i).as_matrix(), model.observe(frame.image, rng=rng).poses.as_matrix()
        )
        np.testing.assert_array_equal(
            recording.path.world_from_camera[i].as_matrix(), frame.world_from_camera.as_matrix()
        )
        if i > 0:
            np.testing.assert_array_equal(recording.motion(i).covariance, frame.odometry.covariance)
            np.testing.assert_array_equal(
                recording.motion(i).previous_from_current.as_matrix(), frame.odometry.previous_from_current.as_matrix()
            )


def test_the_path_is_the_same_before_and_after_recording(directory, tmp_path):
    before, after = camera_path(SETTINGS, tmp_path), camera_path(SETTINGS, directory)
    np.testing.assert_allclose(
        before.world_from_camera.as_matrix(), after.world_from_camera.as_matrix(), atol=1e-9
    )  # the file has quaternions
    np.testing.assert_array_equal(before.sees_cue, after.sees_cue)


def test_what_is_recorded_is_not_recorded_again(directory, checkpoint, monkeypatch):
    monkeypatch.setattr(recordings, "_record", lambda *_: pytest.fail("recorded again"))
    make_recording(SETTINGS, checkpoint, directory)


def test_an_interrupted_recording_leaves_nothing(checkpoint, tmp_path, monkeypatch):
    def interrupted(settings, checkpoint, folder):
        (folder / "samples.npy").write_bytes(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(recordings, "_record", interrupted)
    with pytest.raises(KeyboardInterrupt):
        make_recording(SETTINGS, checkpoint, tmp_path)
    assert list(tmp_path.iterdir()) == []


OTHER = {
    "scene": "staircase", "seed": 4, "cues": "none", "frames": 13, "width": 50, "height": 40,
    "network_sha256": "1" * 64, "num_samples": 31, "synthesis": 99, "package": "9.9",
}  # fmt: skip


@pytest.mark.parametrize("name", OTHER)
def test_a_recording_is_used_for_its_own_settings_only(name, directory, tmp_path):
    other = replace(SETTINGS, **{name: OTHER[name]})
    assert not (directory / other.name).exists()
    with pytest.raises(VaporTrackError, match="cannot be read"):
        load_recording(other, directory)
    # Even where a folder of that name holds another recording.
    source, target = directory / SETTINGS.name, tmp_path / other.name
    target.mkdir()
    for file in source.iterdir():
        (target / file.name).write_bytes(file.read_bytes())
    with pytest.raises(VaporTrackError, match=f"recorded with {name} .*; remove it to make it anew"):
        load_recording(other, tmp_path)


def test_every_setting_of_a_recording_is_checked():
    assert OTHER.keys() == {*json.loads(json.dumps(vars(SETTINGS)))}


def test_a_kidnap_jumps_in_what_is_seen_but_not_in_time_or_odometry(directory):
    first, second = (load_recording(replace(SETTINGS, seed=seed), directory) for seed in (5, 6))
    trial = Trial("ceiling", "kidnap", (Piece(5, 2, 6), Piece(6, 3, 4)))
    replay = assemble(trial, {5: first, 6: second}.__getitem__)
    assert len(replay.odometry) == len(replay.truth) == len(replay.times_ns) == 10
    assert set(np.diff(replay.times_ns)) == {100_000_000}
    for i in range(10):
        source, image = (first, 2 + i) if i < 6 else (second, 3 + i - 6)
        np.testing.assert_array_equal(replay.posterior_poses(i).as_matrix(), source.posterior_poses(image).as_matrix())
        np.testing.assert_array_equal(replay.truth[i].as_matrix(), source.path.world_from_camera[image].as_matrix())
        moving = first.motion(8) if i == 6 else source.motion(image)
        np.testing.assert_array_equal(
            replay.odometry[i].previous_from_current.as_matrix(), moving.previous_from_current.as_matrix()
        )
        np.testing.assert_array_equal(replay.odometry[i].covariance, moving.covariance)
    assert replay.cue_images == first.path.sees_cue[2:8].sum() + second.path.sees_cue[3:7].sum()
