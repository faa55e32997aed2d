"""What is written image by image is gone after an error."""

from pathlib import Path

import pytest

from filtering.errors import VaporTrackError
from tests.helpers.simulated_run import simulated_steps
from vapor.reporting.run_outputs import RunOutputs


def outputs_into(directory: Path) -> RunOutputs:
    return RunOutputs(directory, recording=True, view=False)


def test_an_error_of_the_loop_leaves_nothing(tmp_path):
    def fail():
        with outputs_into(tmp_path) as outputs:
            outputs.add(*next(simulated_steps(1)))
            assert len(list(tmp_path.iterdir())) == 3  # hidden folders
            raise OSError("camera unplugged")

    with pytest.raises(OSError, match="camera unplugged"):
        fail()
    assert list(tmp_path.iterdir()) == []


def test_a_missing_folder_is_refused(tmp_path):
    with pytest.raises(VaporTrackError, match=r"expected the folder .*absent to exist"):
        outputs_into(tmp_path / "absent")
