"""Small model files and training states: written, and read."""

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from filtering.measurement_noise import MeasurementNoise
from filtering.se3 import Poses
from tests.fuzz.damage import in_order
from tests.fuzz.reading import NUM_IMAGES, Content, Reading, require
from tests.helpers.exported import with_arrays, write_export
from tests.helpers.sequence_files import CAMERA, Walk
from vapor.checkpoints.calibration import Calibration
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.checkpoints.file_format import load_checkpoint, save_checkpoint
from vapor.checkpoints.stored_tensors import LandmarksConfig, landmark_arrays
from vapor.engines.onnx_file import describe_onnx
from vapor.evaluation.validation import Validation
from vapor.landmarks.features import SIFT_SIZE, SIZE, Features, restored, stored
from vapor.landmarks.landmark_map import LandmarkMap, ViewCamera
from vapor.landmarks.localize import LandmarkLocalizer
from vapor.landmarks.verify import Landmarks
from vapor.regressors.base import PoseRegressor
from vapor.regressors.network_config import NetworkConfig, make_regressor
from vapor.regressors.ood_model import OodModel, description_size
from vapor.regressors.retrieval import RetrievalRegressor
from vapor.regressors.scene_box import SceneBox
from vapor.training.processes import make_learner
from vapor.training.state import TrainingState, load_state, save_state

_NETWORK = NetworkConfig(
    "resnet18-quarter", image_width=32, image_height=32, shortest_edge=36, feature_dim=16, latent_dim=4
)


def _numbers(like: Tensor, rng: np.random.Generator) -> Tensor:
    """Few different numbers: a damaged model in the corpus must be small when compressed."""
    numbers = rng.uniform(0.01, 0.1, 7).astype(np.float32)
    return torch.from_numpy(np.resize(numbers, tuple(like.shape)))


def _regressor(network: NetworkConfig, box: SceneBox, rng: np.random.Generator) -> PoseRegressor:
    regressor = make_regressor(network, box)
    with torch.no_grad():
        for weights in regressor.parameters():
            weights.copy_(_numbers(weights, rng))
    return regressor


def _landmarks() -> Landmarks:
    """A wall of 5 x 6 points, 2 m ahead of three key images that show all of them."""
    columns, rows = np.meshgrid(np.linspace(-0.6, 0.6, 6), np.linspace(-0.5, 0.5, 5))
    points = np.stack([columns, rows, 2.0 + 0.3 * columns * rows], axis=-1).reshape(-1, 3).astype(np.float32)
    looks = np.zeros((len(points), SIZE), np.float32)
    looks[np.arange(len(points)), np.arange(len(points))] = 1.0
    words = np.zeros((2, SIZE), np.float32)
    words[[0, 1], [0, 1]] = 0.5
    return Landmarks(
        LandmarkMap(
            CAMERA,
            ViewCamera(CAMERA, 0.1, 0.0),
            2.0,
            points,
            stored(looks),
            np.tile(np.eye(3, dtype=np.float32), (3, 1, 1)),
            np.array([[-0.1, 0.0, 0.0], [0.0, 0.0, 0.0], [0.1, 0.0, 0.0]], np.float32),
            (np.arange(4) * len(points)).astype(np.int32),
            np.tile(np.arange(len(points), dtype=np.int32), 3),
            np.zeros(SIFT_SIZE, np.float32),
            np.eye(SIFT_SIZE, SIZE, dtype=np.float32),
            words,
            np.eye(2 * SIZE, 4, dtype=np.float32),
            np.full((3, 4), 0.5, np.float32),
        )
    )


def _localize(landmarks: Landmarks) -> None:
    """Localize an image by landmarks; poses must be finite."""
    m = landmarks.map
    number = min(len(m.points), 200)
    looks = np.zeros((number, SIFT_SIZE), np.float32)
    looks[:, : m.descriptors.shape[1]] = restored(m.descriptors[:number])
    ahead = m.points[:number].astype(np.float64) + np.array([0.02, 0.01, 0.0])
    with np.errstate(all="ignore"):  # where the image shows points is the test's own business
        pixels = m.camera.focal * ahead[:, :2] / ahead[:, 2:] + m.camera.centre
    pixels = np.clip(np.nan_to_num(pixels), -1e6, 1e6)
    localizer = LandmarkLocalizer(m)
    for each in localizer.localize(localizer.described(Features(pixels, looks))):
        require(each.world_from_camera.is_finite(), "pose by landmarks", each.world_from_camera)
        require(bool(np.isfinite(each.covariance).all()), "covariance by landmarks", each.covariance)


def _checkpoint(*, retrieval: bool) -> Checkpoint:
    poses = Poses.stack([pose for _, pose in Walk(NUM_IMAGES).truth])
    box = SceneBox.around(poses)
    network = replace(_NETWORK, head="retrieval", hidden_width=8, components=2) if retrieval else _NETWORK
    rng = np.random.default_rng(0)
    regressor, memory = _regressor(network, box, rng), None
    size = description_size(network.backbone)
    numbers = [rng.uniform(0.5, 1.0, shape).astype(np.float32) for shape in ((size,), (size,), (size, 4), (4,), (5, 4))]
    if retrieval:
        assert isinstance(regressor, RetrievalRegressor)
        features = _numbers(torch.empty(len(poses), len(regressor.centre)), rng)
        translation, rotation = (torch.from_numpy(each).float() for each in (poses.translation, poses.rotation))
        regressor.eval().remember(features, translation, rotation)
        memory = regressor.memory
        assert memory is not None
        memory = replace(memory, keys=_numbers(memory.keys, rng), views=_numbers(memory.views, rng))
    described = {"ood_model": OodModel(*numbers, 0.5, 1.0), "camera": CAMERA, "memory": memory}
    return Checkpoint(network, box, Calibration(), poses, regressor.state_dict(), **described)


def make_model(folder: Path, *, retrieval: bool, landmarks: bool = False) -> Path:
    checkpoint = _checkpoint(retrieval=retrieval)
    if landmarks:
        calibration = Calibration(errors=replace(MeasurementNoise(), verified=MeasurementNoise()))
        checkpoint = replace(checkpoint, calibration=calibration, landmarks=_landmarks())
    save_checkpoint(folder / "model.safetensors", checkpoint, store_float16=True)
    return _in_order(folder / "model.safetensors")


def _in_order(file: Path) -> Path:
    file.write_bytes(in_order(file.read_bytes()))
    return file


def load_model(path: Path) -> Reading:
    loaded = load_checkpoint(path)
    content = Content()
    content.add(loaded.network, loaded.box, loaded.calibration, loaded.camera, loaded.training)
    count = _add_arrays(content, dict(loaded.state_dict), loaded.prior_poses, loaded.ood_model, loaded.memory)
    if loaded.landmarks is not None:
        content.add(asdict(LandmarksConfig.of(loaded.landmarks)))
        count += _add_arrays(content, dict(landmark_arrays(loaded.landmarks)))
        _localize(loaded.landmarks)
    return Reading(content.digest, count)


def _add_arrays(content: Content, *owners: Any) -> int:
    """Add arrays, which must be finite, and count them. Rotations are stored to 1e-3, so none is a `Poses`."""
    parts = [each if isinstance(each, dict) else vars(each) for each in owners if each is not None]
    arrays = [(name, np.asarray(values)) for part in parts for name, values in sorted(part.items())]
    for name, array in arrays:
        require(bool(np.isfinite(array).all()), "tensor", name)
        content.add(name, array)
    return len(arrays)


def make_exported(folder: Path) -> Path:
    """An export whose graph is a dummy: torch's graphs depend on its version."""
    file = write_export(folder / "model.onnx", _checkpoint(retrieval=True).description)
    file.write_bytes(with_arrays(file.read_bytes(), in_order))
    return file


def read_exported(path: Path) -> Reading:
    """A model's description, without the digest of all bytes, which also covers bytes that do not matter."""
    described = describe_onnx(path)
    content = Content()
    content.add(described.network, described.box, described.calibration, described.camera, described.training)
    count = _add_arrays(content, described.prior_poses, described.ood_model, described.memory_poses)
    return Reading(content.digest, count)


_TRAINING = {"seed": 0}

_BOX = SceneBox.around(Poses.stack([pose for _, pose in Walk(NUM_IMAGES).truth]))


def _training(rng: np.random.Generator) -> TrainingState:
    network, average = _regressor(_NETWORK, _BOX, rng), make_regressor(_NETWORK, _BOX)
    return TrainingState(network, average, make_learner(network), torch.optim.AdamW(network.parameters()))


def make_training_state(folder: Path) -> Path:
    rng = np.random.default_rng(0)
    state = _training(rng)
    state.average.load_state_dict(state.network.state_dict())
    for weights in state.network.parameters():
        moments = {"exp_avg": _numbers(weights, rng), "exp_avg_sq": _numbers(weights, rng)}
        state.optimizer.state[weights] = {"step": torch.tensor(3.0), **moments}
    state.epochs, state.epoch, state.seconds = 3, 1, 2.5
    state.history, state.best = [Validation(1, -0.5, 0.25, 0.5, -3.0)], dict(state.average.state_dict())
    save_state(folder / "model.training.safetensors", state, _TRAINING)
    return _in_order(folder / "model.training.safetensors")


def load_training(path: Path) -> Reading:
    state = _training(np.random.default_rng(1))
    load_state(path, state, _TRAINING)
    max(state.history, key=lambda figures: figures.log_density, default=None)  # as a training that goes on does
    state.average.load_state_dict(state.best or state.average.state_dict())
    content = Content()
    content.add(state.epochs, state.epoch, state.seconds, state.history)
    moments = [values for each in state.optimizer.state.values() for values in each.values()]
    tensors = [*state.network.state_dict().values(), *state.average.state_dict().values(), *moments]
    for values in tensors:
        content.add(values.numpy())
    return Reading(content.digest, len(tensors))
