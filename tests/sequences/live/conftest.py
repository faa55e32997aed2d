"""Messages of walks."""

from pathlib import Path

import pytest

from sequences.recordings.source import RawMessage
from tests.helpers.fake_transport import messages_of
from tests.helpers.sequence_files import Walk


@pytest.fixture(scope="module")
def raws(walk_file: Path) -> list[RawMessage]:
    return messages_of(walk_file)


@pytest.fixture(scope="module")
def long_walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return Walk(30).write(tmp_path_factory.mktemp("walk") / "long.mcap")


@pytest.fixture(scope="module")
def long_raws(long_walk: Path) -> list[RawMessage]:
    return messages_of(long_walk)
