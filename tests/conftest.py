"""Shapes and types in annotations are executed while the tests run."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from jaxtyping import install_import_hook

from tests.checks import no_checks

install_import_hook(["filtering", "sequences", "vapor"], "beartype.beartype").__enter__()


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Recorded data beside the checkout; tests that need it skip, saying so, where it is absent."""
    path = Path(__file__).resolve().parents[2] / "shared" / "data"
    if not path.is_dir():
        pytest.skip("recorded data is absent: ../shared/data beside the checkout")
    return path


@pytest.fixture(scope="session")
def tiny_model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model file of a network with random weights, for the walk of `sequence_files`."""
    from tests.tiny_model import write_tiny_model  # after the hook

    return write_tiny_model(tmp_path_factory.mktemp("model") / "tiny.safetensors")


@pytest.fixture(scope="session")
def walk_of_25(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sequence of 25 images with odometry, extrinsics and true poses."""
    from tests.sequence_files import Walk

    return Walk(25).write(tmp_path_factory.mktemp("walk") / "walk.mcap", {"odometry": "exact, for tests"})


@pytest.fixture
def unchecked() -> Iterator[None]:
    """Checks no shapes during a test that takes thousands of steps; others check those of the same calls."""
    with no_checks():
        yield


@pytest.fixture
def plain_results(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs draw no pictures and publish few particles, where a test looks at neither."""
    monkeypatch.setattr("vapor.run.write_pictures", lambda *_, **__: [])
    monkeypatch.setattr("vapor.run._PUBLISHED_PARTICLES", 20)
