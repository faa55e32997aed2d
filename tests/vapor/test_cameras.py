"""Images of other cameras than a network learned with: resampled exactly where intrinsics are known."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from filtering.se3 import Poses
from sequences.frame import Camera, Frame
from tests.helpers.observing import observe, uncalibrated
from tests.helpers.tiny_model import Metadata, Tensors, altered
from tests.helpers.tiny_training import TINY
from tests.helpers.views import taken_by
from vapor.cameras import AsTakenBy, fraction_seen, resampled
from vapor.checkpoints.file_format import load_checkpoint, save_checkpoint
from vapor.observation import VaporObservationModel
from vapor.regressors.backbones import Describer
from vapor.regressors.ood_model import OodModel
from vapor.tensor_files import CheckpointError
from vapor.training.train import train_on
from vapor.training_data.load import load_training_set

A = Camera(160, 120, 120.0, 120.0, 79.5, 59.5)
OTHERS = {
    "wider": replace(A, fx=84.0, fy=84.0),
    "larger": Camera(640, 480, 480.0, 480.0, 319.5, 239.5),
    "larger and wider": Camera(800, 600, 420.0, 420.0, 399.5, 299.5),
    "smaller": Camera(120, 90, 90.0, 90.0, 59.5, 44.5),
    "16:9": Camera(480, 270, 225.0, 225.0, 239.5, 134.5),
    "portrait": Camera(160, 240, 118.0, 118.0, 79.5, 119.5),
    "off centre, pixels not square": Camera(300, 200, 180.0, 140.0, 160.0, 90.0),
}


@pytest.mark.parametrize("camera", OTHERS.values(), ids=OTHERS)
def test_a_resampled_image_is_what_the_other_camera_takes(camera: Camera) -> None:
    assert fraction_seen(camera, of=A) == pytest.approx(1.0, abs=0.03)
    difference = np.abs(resampled(taken_by(camera), camera, A).astype(float) - taken_by(A))
    assert difference.mean() < 1.5
    # Half a pixel beside would be seen.
    shifted = resampled(taken_by(camera), replace(camera, cx=camera.cx + 0.5 * camera.fx / A.fx), A)
    assert np.abs(shifted.astype(float) - taken_by(A)).mean() > 1.5 * difference.mean()


def test_shrinking_averages_over_areas() -> None:
    stripes = np.zeros((480, 640, 3), np.uint8)
    stripes[:, ::2] = 200  # finer than the small camera can see
    small = resampled(stripes, Camera(640, 480, 500.0, 500.0, 319.5, 239.5), Camera(80, 60, 55.0, 55.0, 39.5, 29.5))
    assert small[:, 2:-2].min() > 85
    assert small[:, 2:-2].max() < 115


def test_what_a_narrow_lens_does_not_show_has_the_colour_of_its_border() -> None:
    narrow = replace(A, fx=1.4 * A.fx, fy=1.4 * A.fy)
    assert fraction_seen(narrow, of=A) == pytest.approx(1 / 1.96)
    assert fraction_seen(A, of=narrow) == 1.0
    assert fraction_seen(replace(A, cx=500.0), of=A) == 0.0
    image = np.full((120, 160, 3), 50, np.uint8)
    image[:, :20] = 200
    seen = resampled(image, narrow, A)
    assert (seen[:, :20] == 200).all()
    assert (seen[:, 60:] == 50).all()


def test_the_same_view_is_left_bit_by_bit() -> None:
    as_taken = AsTakenBy(A, (40, 30))
    for camera in (A, A.scaled(640, 480), replace(A, fx=120.3)):
        image = taken_by(camera)
        assert as_taken(image, camera) is image
    assert as_taken(image := taken_by(A), A.scaled(320, 240)) is image  # the camera at another size
    assert (as_taken.cameras, as_taken.notices) == ({}, [])
    assert as_taken(taken_by(OTHERS["16:9"]), OTHERS["16:9"]).shape == (30, 40, 3)


def test_the_same_field_of_view_with_pixels_of_another_shape_is_resampled() -> None:
    image = np.random.default_rng(0).integers(0, 255, (90, 160, 3), dtype=np.uint8)
    seen = AsTakenBy(A, (A.width, A.height))(image, A.scaled(160, 90))
    assert seen.shape[1] * A.height == seen.shape[0] * A.width


def test_what_a_person_should_know_is_said_once() -> None:
    as_taken = AsTakenBy(A, (40, 30))
    narrow = replace(A, fx=1.4 * A.fx, fy=1.4 * A.fy)
    for _ in range(3):
        as_taken(taken_by(narrow), narrow)
        as_taken(np.zeros((90, 160, 3), np.uint8), None)
    as_taken(taken_by(A), None)  # of the same aspect: nothing to say
    assert as_taken.notices == [
        "3 images of 160 x 90 pixels from a camera of unknown intrinsics: their middle is used, but the camera learned"
        " with is 160 x 120 pixels, 67° wide",
        "the camera (160 x 120 pixels, 51° wide) sees 51% of what the camera learned with saw (160 x 120 pixels, 67°"
        " wide): expect larger errors, and certainty later; only those of its images that look very unlike the"
        " training are taken for ones of another place",
    ]
    silent = AsTakenBy(None, (40, 30))
    image = taken_by(narrow)
    assert silent(image, narrow) is image
    assert silent.notices == []


@pytest.mark.parametrize(
    ("closer", "score", "foreign"),
    [(1.0, 1.1, True), (1.4, 1.7, False), (1.4, 1.8, True), (2.0, 2.0, False), (2.0, 2.2, True)],
)
def test_what_is_filled_in_alone_makes_no_image_foreign(closer: float, score: float, foreign: bool) -> None:
    checkpoint = replace(uncalibrated(), camera=A)
    network, size = checkpoint.build_network(), checkpoint.network
    describer = Describer(network)
    seen = torch.zeros(1, size.image_height, size.image_width, 3, dtype=torch.uint8)
    with torch.inference_mode():
        network(network.normalise(seen), torch.zeros(1, 5, network.noise_dim))
        count = describer.last(seen).shape[1]
    numbers, away = np.zeros(count, np.float32), 1e6  # of all that is learned, from any image
    axes, exemplars = np.eye(count, 1, dtype=np.float32), np.full((1, 1), away, np.float32)
    known = OodModel(numbers, numbers + 1, axes, numbers[:1] + 1, exemplars, away / score, away / score)
    model = VaporObservationModel(replace(checkpoint, ood_model=known), num_samples=5, device="cpu")
    other = replace(A, fx=closer * A.fx, fy=closer * A.fy)
    for camera, unlike in ((other, foreign), (A, True), (other, foreign)):  # whatever was seen before
        model.camera = camera
        posterior = model.observe(taken_by(camera), rng=np.random.default_rng(0))
        assert posterior.is_out_of_distribution == unlike
        expected = pytest.approx(score if unlike else 1.0, rel=1e-3)
        assert posterior.ood_score == expected
        assert model.ood_score(taken_by(camera), camera) == expected


# --- the model file --------------------------------------------------------------------------------


def test_a_model_file_keeps_its_camera(tmp_path: Path) -> None:
    path = tmp_path / "m.safetensors"
    save_checkpoint(path, replace(uncalibrated(), camera=A))
    assert load_checkpoint(path).camera == A
    assert load_checkpoint(path).seen_sha256() != uncalibrated().seen_sha256()
    assert load_checkpoint(path).network_sha256() == uncalibrated().network_sha256()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"fx": "long"}, "camera configuration has fx 'long', expected a number"),
        ({"width": 160.5}, "camera configuration has width 160.5, expected a whole number"),
        ({"fy": -1.0}, "camera with fy -1.0, expected between"),
        ({"k1": 0.1}, r"camera configuration lacks \[\] and has surplus \['k1'\]"),
    ],
)
def test_a_camera_in_a_model_file_that_is_none_is_refused(change: dict, said: str, tmp_path: Path) -> None:
    save_checkpoint(tmp_path / "m.safetensors", replace(uncalibrated(), camera=A))

    def damage(tensors: Tensors, metadata: Metadata) -> None:
        config = json.loads(metadata["config"])
        config["camera"] |= change
        metadata["config"] = json.dumps(config)

    with pytest.raises(CheckpointError, match=said):
        load_checkpoint(altered(tmp_path / "m.safetensors", tmp_path / "bad.safetensors", damage))


# --- in use and in training ------------------------------------------------------------------------


def test_a_model_sees_images_of_another_camera_as_its_own_would_take_them() -> None:
    mine = replace(uncalibrated(), camera=A)
    other = OTHERS["16:9"]
    model = VaporObservationModel(mine, num_samples=50, device="cpu")
    resampling = VaporObservationModel(mine, num_samples=50, device="cpu", camera=other)
    expected = observe(taken_by(A), model=model).samples.translation
    as_it_is = observe(taken_by(other), model=model).samples.translation
    found = observe(taken_by(other), model=resampling).samples.translation
    assert np.abs(found - expected).max() < 0.2 * np.abs(as_it_is - expected).max()
    assert resampling.notices == []
    assert "of unknown intrinsics" in model.notices[0]


def frames_of(camera: Camera | None, count: int, shown: Camera | None = None) -> list[Frame]:
    image = taken_by(shown or camera or A)
    return [Frame(i, image, None, Poses.exp(np.full(6, 0.1 * i)), camera) for i in range(count)]


def test_recordings_of_several_cameras_become_those_of_the_camera_of_most_images() -> None:
    other = OTHERS["16:9"]
    loaded = load_training_set({"a": frames_of(other, 2), "b": frames_of(A, 3), "c": frames_of(None, 1)}, (40, 30))
    assert loaded.camera == A
    assert loaded.notices == (
        "2 of 6 images are of other cameras than 160 x 120 pixels, 67° wide, and were resampled to it: 2 of 480 x 270"
        " pixels, 94° wide",
    )
    expected = cv2.resize(taken_by(A), (40, 30), interpolation=cv2.INTER_AREA)
    for image in loaded.images:
        assert np.abs(image.astype(float) - expected).mean() < 2.0
    held_out = load_training_set({"d": frames_of(other, 2)}, (40, 30), camera=A)
    assert np.abs(held_out.images[0].astype(float) - expected).mean() < 2.0
    assert held_out.camera == A


def test_recordings_of_one_camera_are_left_as_they_are_and_nothing_is_said() -> None:
    loaded = load_training_set({"a": frames_of(A, 2), "b": frames_of(A.scaled(80, 60), 1, A)}, (40, 30))
    assert (loaded.camera, loaded.notices) == (A, ())
    unknown = load_training_set({"a": frames_of(None, 2)}, (40, 30))
    assert (unknown.camera, unknown.notices) == (None, ())


def test_a_training_keeps_its_camera_in_the_model(tmp_path: Path) -> None:
    config = replace(TINY, epochs=1, calibrate=False, validation_fraction=0.0, resume=False)
    walk = [replace(frame, image=np.uint8(frame.image / (1 + i))) for i, frame in enumerate(frames_of(A, 8))]
    result = train_on({"a": walk, "b": frames_of(OTHERS["wider"], 2)}, tmp_path / "m.safetensors", config)
    assert load_checkpoint(tmp_path / "m.safetensors").camera == result.checkpoint.camera == A
    assert result.notices[0].startswith("2 of 10 images are of other cameras")
