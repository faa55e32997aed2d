"""Shapes and types in annotations are executed while the tests run."""

import gc
from collections.abc import Iterator
from dataclasses import replace
from functools import cache, wraps
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import settings

from tests.helpers import checks
from tests.helpers.checkout import SHARED_DATA
from tests.helpers.checks import no_checks
from tests.helpers.full import FULL

if TYPE_CHECKING:
    from sequences.rendering.render import LitScene
    from sequences.scenes.scene import Scene

checks.install(["filtering", "sequences", "vapor"])
# How long an example takes says how busy the machine is; and whoever runs the tests runs the same ones.
settings.register_profile("unhurried", deadline=None, derandomize=True, max_examples=100 if FULL else 30)
settings.load_profile("unhurried")


def pytest_collection_finish() -> None:
    """What thousands of collected tests are made of stays: looking through it for garbage takes 5 % of the suite."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(100_000, 50, 100)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Recorded data beside the checkout; tests that need it skip, saying so, where it is absent."""
    path = SHARED_DATA
    if not path.is_dir():
        pytest.skip("recorded data is absent: ../shared/data beside the checkout")
    return path


@pytest.fixture(scope="session")
def tiny_model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model file of a network with random weights, for the walk of `sequence_files`."""
    from tests.helpers.tiny_model import write_tiny_model  # after the hook

    return write_tiny_model(tmp_path_factory.mktemp("model") / "tiny.safetensors")


@pytest.fixture(scope="session")
def walk_of_25(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sequence of 25 images with odometry, extrinsics and true poses."""
    from tests.helpers.sequence_files import Walk

    return Walk(25).write(tmp_path_factory.mktemp("walk") / "walk.mcap", {"odometry": "exact, for tests"})


@pytest.fixture
def unchecked() -> Iterator[None]:
    """Checks no shapes during a test that takes thousands of steps; others check those of the same calls."""
    with no_checks():
        yield


@pytest.fixture
def no_odometry_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Inspections fit no errors of odometry, where a test does not look at them: it takes a second."""
    from sequences.errors import SequenceError  # after the hook

    def refuse(segments: object) -> None:
        raise SequenceError("not in this test")

    monkeypatch.setattr("vapor.inspection.odometry.fit_odometry", refuse)


@pytest.fixture
def no_views(no_camera: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Images are not compared with poses, where a test does not look at that: it takes some milliseconds an image."""
    monkeypatch.setattr("vapor.training_data.views.Views.take", lambda views, frame: None)


@pytest.fixture
def no_camera(monkeypatch: pytest.MonkeyPatch) -> None:
    """Inspections estimate no camera, where a test does not look at it: it takes seconds."""
    monkeypatch.setattr("vapor.inspection.camera.CameraViews.take", lambda views, frame, row: None)


@pytest.fixture
def plain_results(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs publish few particles, where a test does not look at them."""
    monkeypatch.setattr("filtering.estimate.SHOWN_PARTICLES", 20)


@cache
def _roughly_lit(scene: "Scene") -> "Scene":
    from sequences.rendering.light import Sampling  # after the hook

    return replace(scene, sampling=Sampling(grid_m=0.5, shadow_rays=1, bounce_rays=4, reach_m=5.0))


@pytest.fixture
def rough_light(monkeypatch: pytest.MonkeyPatch) -> None:
    """Scenes other than buildings are lit roughly, where a test does not look at light: it takes seconds a scene."""
    _light_roughly(monkeypatch)


@pytest.fixture(scope="module")
def rough_light_in_module() -> Iterator[None]:
    """The same for all tests of a module, and for what they share."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        _light_roughly(monkeypatch)
        yield


def _light_roughly(monkeypatch: pytest.MonkeyPatch) -> None:
    from sequences.scenes.scene import Scene  # after the hook

    build = Scene.build

    @wraps(build)
    def build_roughly(scene: Scene, split: str, seed: int) -> "LitScene":
        return build(scene if scene.changes else _roughly_lit(scene), split, seed)

    monkeypatch.setattr(Scene, "build", build_roughly)


@pytest.fixture
def knowing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every network takes images for where they are, to some centimetres and degrees, in a calibration."""
    import numpy as np

    from filtering.se3 import Poses

    rng = np.random.default_rng(0)

    def predict_all(network, parts, seed, advance):
        truth = [[images.poses[i] for i in range(len(images))] for images in parts]
        return [[pose @ Poses.exp(0.05 * rng.standard_normal((100, 6))) for pose in poses] for poses in truth]

    monkeypatch.setattr("vapor.calibration.calibrate.predict_all", predict_all)
