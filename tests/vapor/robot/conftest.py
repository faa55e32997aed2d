"""A walk for live localization."""

from pathlib import Path

import pytest

from tests.helpers.sequence_files import Walk


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return Walk(12).write(tmp_path_factory.mktemp("walk") / "walk.mcap")
