"""What commands are given, and what must stay as it is."""

from pathlib import Path

import pytest

from sequences.outputs import results_folder


@pytest.fixture
def earlier(tmp_path: Path) -> Path:
    """A directory that already holds results, which must stay as they are."""
    folder, names = tmp_path / "earlier", ("report.json", "trajectory.tum")
    with results_folder(folder, "run", writes=names) as new:
        for name in names:
            (new / name).write_text("an earlier result\n")
    return folder
