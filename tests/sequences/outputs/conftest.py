"""What a file system may lack."""

import errno
from pathlib import Path

import pytest

from sequences.outputs import replacing


@pytest.fixture
def one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Folders cannot be exchanged, as where they are mounted."""

    def fails(one: Path, other: Path) -> None:
        raise OSError(errno.EBUSY, "Device or resource busy")

    monkeypatch.setattr(replacing, "exchange", fails)
