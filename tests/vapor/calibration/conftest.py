"""What fits do not search for, where a test does not look at it."""

import numpy as np
import pytest


@pytest.fixture
def widest_places(monkeypatch: pytest.MonkeyPatch) -> None:
    """Places reach as far as they ever do: each reach that a fit tries takes as long as all the rest of it."""
    monkeypatch.setattr("vapor.calibration.image_errors._RADII", np.array([0.32]))
