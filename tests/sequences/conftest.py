"""Sequences to read, and to damage."""

from pathlib import Path

import pytest

from tests.helpers.sequence_files import Walk


@pytest.fixture(scope="module")
def walk_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return Walk().write(tmp_path_factory.mktemp("walk") / "walk.mcap", metadata={"odometry": "simulated: exact"})
