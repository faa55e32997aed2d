"""What is written image by image: whole at the end, and gone after an error."""

from dataclasses import replace
from pathlib import Path

import pytest

from filtering.errors import VaporTrackError
from tests.helpers.simulated_run import simulated_steps
from vapor.reporting.run_outputs import RunOutputs


@pytest.fixture(scope="module")
def steps():
    return [
        (frame, replace(step, baselines={"kalman": step.image_modes, "gaussian_sum": step.image_modes}))
        for frame, step in simulated_steps(12)
    ]


def outputs_into(directory: Path) -> RunOutputs:
    return RunOutputs(directory, recording=True, view=False)


def test_an_error_of_the_loop_leaves_nothing(tmp_path, steps):
    def fail():
        with outputs_into(tmp_path) as outputs:
            outputs.add(*steps[0])
            assert len(list(tmp_path.iterdir())) == 2  # hidden folders
            raise OSError("camera unplugged")

    with pytest.raises(OSError, match="camera unplugged"):
        fail()
    assert list(tmp_path.iterdir()) == []


def test_a_missing_folder_is_refused(tmp_path):
    with pytest.raises(VaporTrackError, match=r"expected the folder .*absent to exist"):
        outputs_into(tmp_path / "absent")
