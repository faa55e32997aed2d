"""What estimates are made of, and compared with."""

from pathlib import Path

import pytest


@pytest.fixture
def truth(tmp_path: Path) -> Path:
    """True poses of the walk that estimators are given, by name."""
    from tests.helpers.pose_files import walk, write_named  # after the hook

    return write_named(tmp_path / "truth.txt", walk(), world_to_camera=True)
