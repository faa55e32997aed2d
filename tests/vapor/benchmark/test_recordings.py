"""Recordings of a benchmark: the user's own path through a file, stored exactly, once, and for nothing else."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from filtering.errors import VaporTrackError
from sequences.reader import SequenceReader
from sequences.synthesize import synthesize, write_synthetic
from vapor.benchmark.recordings import record
from vapor.benchmark.recordings.record import camera_path, make_recording
from vapor.benchmark.recordings.storage import RecordingSettings, load_recording
from vapor.benchmark.trials.choose import Excerpt, Trial
from vapor.benchmark.trials.replay import assemble
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.checkpoints.file_format import load_checkpoint
from vapor.observation import VaporObservationModel

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
        posterior = model.observe(frame.image, rng=rng)
        np.testing.assert_array_equal(recording.posterior_poses(i).as_matrix(), posterior.samples.as_matrix())
        assert recording.ood_score[i] == posterior.ood_score
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


def test_an_interrupted_recording_leaves_nothing(checkpoint, tmp_path, monkeypatch):
    def interrupted(settings, checkpoint, folder, engine):
        (folder / "samples.npy").write_bytes(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(record, "record_synthetic", interrupted)
    with pytest.raises(KeyboardInterrupt):
        make_recording(SETTINGS, checkpoint, tmp_path)
    assert list(tmp_path.iterdir()) == []


OTHER = {
    "scene": "staircase", "seed": 4, "cues": "none", "frames": 13, "width": 50, "height": 40,
    "network_sha256": "1" * 64, "num_samples": 31, "rate_hz": 30.0, "stand": (3, 1.0), "part": (2, 4),
    "change": "black", "odometry_scale": 0.02, "camera": (16, 12, 9.0, 9.0, 7.5, 5.5), "synthesis": 99,
    "package": "9.9", "precision": "bfloat16",
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
    with pytest.raises(VaporTrackError, match=f"recorded with {name} .*; remove it to make it again"):
        load_recording(other, tmp_path)


def test_every_setting_of_a_recording_is_checked():
    assert OTHER.keys() == {*json.loads(json.dumps(vars(SETTINGS)))}


def test_a_kidnap_jumps_in_what_is_seen_but_not_in_time_or_odometry(directory):
    first, second = (
        replace(load_recording(replace(SETTINGS, seed=seed), directory), ood_score=seed + np.linspace(0.0, 0.9, 12))
        for seed in (5, 6)
    )
    trial = Trial("ceiling", "kidnap", (Excerpt(5, 2, 6), Excerpt(6, 3, 4)))
    replay = assemble(trial, lambda segment: {5: first, 6: second}[segment.seed])
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
    np.testing.assert_array_equal(replay.ood_score, [*first.ood_score[2:8], *second.ood_score[3:7]])


def test_of_a_faster_recording_every_third_image_is_seen_and_the_motions_between_add_up(checkpoint, tmp_path):
    fast = replace(SETTINGS, frames=13, rate_hz=30.0)
    make_recording(fast, checkpoint, tmp_path)
    recording = load_recording(fast, tmp_path)
    assert np.diff(recording.times_ns) == pytest.approx([1e9 / 30] * 12, abs=2)
    replay = assemble(Trial("ceiling", "rate-10", (Excerpt(5, 0, 13),), 3), lambda segment: recording)
    assert len(replay.odometry) == len(replay.truth) == len(replay.times_ns) == len(replay.ood_score) == 5
    assert replay.times_ns[0] == recording.times_ns[0]
    np.testing.assert_allclose(np.diff(replay.times_ns), 1e8, atol=10)
    np.testing.assert_array_equal(replay.truth.as_matrix(), recording.path.world_from_camera[::3].as_matrix())
    assert replay.cue_images == recording.path.sees_cue[::3].sum()
    for i in range(5):
        np.testing.assert_array_equal(
            replay.posterior_poses(i).as_matrix(), recording.posterior_poses(3 * i).as_matrix()
        )
    for i in range(1, 5):
        together = recording.motion(3 * i - 2).then(recording.motion(3 * i - 1)).then(recording.motion(3 * i))
        np.testing.assert_array_equal(
            replay.odometry[i].previous_from_current.as_matrix(), together.previous_from_current.as_matrix()
        )
        np.testing.assert_array_equal(replay.odometry[i].covariance, together.covariance)
        assert replay.odometry[i].duration_s == pytest.approx(0.1, abs=1e-6)


def test_a_recording_of_a_stand_goes_on_where_the_camera_rests(checkpoint, tmp_path):
    standing = replace(SETTINGS, frames=6, stand=(5, 1.0))
    make_recording(standing, checkpoint, tmp_path)
    recording = load_recording(standing, tmp_path)
    assert len(recording.times_ns) == len(recording.samples) == 15
    assert len(recording.path.sees_cue) == 15
    moved_m, _ = recording.path.world_from_camera[5:].distance(recording.path.world_from_camera[14])
    assert moved_m.max() < 1e-6
    assert recording.path.world_from_camera[:5].distance(recording.path.world_from_camera[14])[0].min() > 0.0
    before = camera_path(standing, tmp_path / "nowhere")
    np.testing.assert_allclose(
        before.world_from_camera.as_matrix(), recording.path.world_from_camera.as_matrix(), atol=1e-9
    )


def test_samples_take_room_as_they_are_written(checkpoint, tmp_path, monkeypatch):
    """A file with holes kills the process that fills one of them where the disk is full."""
    sizes = []
    observe = VaporObservationModel.observe

    def watched(model, image, *, rng):
        sizes.append(next(tmp_path.rglob("samples.npy")).stat().st_size)
        return observe(model, image, rng=rng)

    monkeypatch.setattr(VaporObservationModel, "observe", watched)
    make_recording(SETTINGS, checkpoint, tmp_path)
    assert sizes[0] < sizes[-1] < next(tmp_path.rglob("samples.npy")).stat().st_size


def test_a_part_of_a_recording_is_of_the_same_walk(directory, checkpoint, tmp_path):
    part = replace(SETTINGS, part=(3, 5))
    make_recording(part, checkpoint, tmp_path)
    recording, whole = load_recording(part, tmp_path), load_recording(SETTINGS, directory)
    assert len(recording.times_ns) == len(recording.samples) == 5
    np.testing.assert_array_equal(recording.times_ns, whole.times_ns[3:8])
    np.testing.assert_array_equal(recording.path.sees_cue, whole.path.sees_cue[3:8])
    for image in range(1, 5):
        np.testing.assert_array_equal(recording.odometry[image].as_matrix(), whole.odometry[3 + image].as_matrix())
        np.testing.assert_array_equal(
            recording.path.world_from_camera[image].as_matrix(), whole.path.world_from_camera[3 + image].as_matrix()
        )


def test_images_are_changed_before_the_network_sees_them(checkpoint, tmp_path, monkeypatch):
    images = []
    observe = VaporObservationModel.observe
    monkeypatch.setattr(
        VaporObservationModel,
        "observe",
        lambda model, image, *, rng: images.append(image) or observe(model, image, rng=rng),
    )
    for change in (None, "upside down", "black"):
        make_recording(replace(SETTINGS, frames=2, change=change), checkpoint, tmp_path)
    np.testing.assert_array_equal(images[2:4], np.array(images[:2])[:, ::-1, ::-1])
    assert np.std(images[0]) > 1.0
    assert np.max(images[4:]) == 0
