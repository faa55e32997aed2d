"""Every status of the filter has a colour on the page and in Rerun, and a level in diagnostics."""

from pathlib import Path

import pytest

import vapor.reporting.html
from filtering.estimate import STATUSES
from vapor.reporting import rerun_layout
from vapor.robot import publisher

PAGE = (Path(vapor.reporting.html.__file__).parent / "page.css").read_text(encoding="utf-8")


@pytest.mark.parametrize("status", STATUSES)
def test_every_status_has_its_colours_and_its_level(status: str) -> None:
    assert PAGE.count(f"--{status}:") == 2  # light and dark
    assert status in rerun_layout._STATUS
    assert status in publisher._LEVELS
