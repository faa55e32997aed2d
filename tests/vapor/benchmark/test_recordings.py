"""Recordings of a benchmark: the user's own path through a file, stored exactly, once, and for nothing else."""

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
        np.testing.assert_array_equal(recording.observed(i).samples.as_matrix(), posterior.samples.as_matrix())
        assert recording.observed(i).ood_score == posterior.ood_score
        np.testing.assert_array_equal(
            recording.path.world_from_camera[i].as_matrix(), frame.world_from_camera.as_matrix()
        )
        if i > 0:
            np.testing.assert_array_equal(recording.motion(i).covariance, frame.odometry.covariance)
            np.testing.assert_array_equal(
                recording.motion(i).previous_from_current.as_matrix(), frame.odometry.previous_from_current.as_matrix()
            )


def test_an_interrupted_recording_leaves_nothing(checkpoint, tmp_path, monkeypatch):
    def interrupted(settings, checkpoint, folder, engine):
        (folder / "samples.f32").write_bytes(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(record, "record_synthetic", interrupted)
    with pytest.raises(KeyboardInterrupt):
        make_recording(SETTINGS, checkpoint, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_recording_is_named_by_all_its_settings(directory):
    other = {
        "scene": "staircase", "seed": 4, "cues": "none", "frames": 13, "width": 50, "height": 40,
        "network_sha256": "1" * 64, "num_samples": 31, "rate_hz": 30.0, "stand": (3, 1.0), "part": (2, 4),
        "change": "black", "odometry_scale": 0.02, "camera": (16, 12, 9.0, 9.0, 7.5, 5.5), "synthesis": 99,
        "package": "9.9", "precision": "bfloat16",
    }  # fmt: skip
    assert other.keys() == vars(SETTINGS).keys()
    others = [replace(SETTINGS, **{name: value}) for name, value in other.items()]
    assert len({SETTINGS.name, *(each.name for each in others)}) == 1 + len(other)
    with pytest.raises(VaporTrackError, match="expected a recording; remove it to make it again"):
        load_recording(others[0], directory)


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
        np.testing.assert_array_equal(
            replay.observed(i).samples.as_matrix(), source.observed(image).samples.as_matrix()
        )
        np.testing.assert_array_equal(replay.truth[i].as_matrix(), source.path.world_from_camera[image].as_matrix())
        moving = first.motion(8) if i == 6 else source.motion(image)
        np.testing.assert_array_equal(
            replay.odometry[i].previous_from_current.as_matrix(), moving.previous_from_current.as_matrix()
        )
        np.testing.assert_array_equal(replay.odometry[i].covariance, moving.covariance)
    assert replay.cue_images == first.path.sees_cue[2:8].sum() + second.path.sees_cue[3:7].sum()
    scores = [replay.observed(i).ood_score for i in range(10)]
    np.testing.assert_array_equal(scores, [*first.ood_score[2:8], *second.ood_score[3:7]])


def test_of_a_faster_recording_every_third_image_is_seen_and_the_motions_between_add_up(checkpoint, tmp_path):
    fast = replace(SETTINGS, frames=13, rate_hz=30.0)
    make_recording(fast, checkpoint, tmp_path)
    recording = load_recording(fast, tmp_path)
    assert np.diff(recording.times_ns) == pytest.approx([1e9 / 30] * 12, abs=2)
    replay = assemble(Trial("ceiling", "rate-10", (Excerpt(5, 0, 13),), 3), lambda segment: recording)
    assert len(replay.odometry) == len(replay.truth) == len(replay.times_ns) == 5
    assert replay.times_ns[0] == recording.times_ns[0]
    np.testing.assert_allclose(np.diff(replay.times_ns), 1e8, atol=10)
    np.testing.assert_array_equal(replay.truth.as_matrix(), recording.path.world_from_camera[::3].as_matrix())
    assert replay.cue_images == recording.path.sees_cue[::3].sum()
    for i in range(5):
        np.testing.assert_array_equal(
            replay.observed(i).samples.as_matrix(), recording.observed(3 * i).samples.as_matrix()
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
    before = camera_path(standing)
    np.testing.assert_allclose(
        before.world_from_camera.as_matrix(), recording.path.world_from_camera.as_matrix(), atol=1e-9
    )


def test_samples_take_room_as_they_are_written(checkpoint, tmp_path, monkeypatch):
    """A file with holes kills the process that fills one of them where the disk is full."""
    sizes = []
    observe = VaporObservationModel.observe

    def watched(model, image, *, rng):
        sizes.append(next(tmp_path.rglob("samples.f32")).stat().st_size)
        return observe(model, image, rng=rng)

    monkeypatch.setattr(VaporObservationModel, "observe", watched)
    make_recording(SETTINGS, checkpoint, tmp_path)
    assert sizes[0] < sizes[-1] < next(tmp_path.rglob("samples.f32")).stat().st_size


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
