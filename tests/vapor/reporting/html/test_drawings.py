"""Drawings of a run: the plan shows the path where it was, the diagram the numbers of the report."""

import re
from dataclasses import replace

import numpy as np
import pytest

from filtering.storeys import Storeys
from tests.helpers.pages import ReadPage
from tests.helpers.simulated_run import FLOOR_M, simulated_record
from vapor.evaluation.reliability import Reliability
from vapor.reporting.html.drawings import ThinnedPath, plan, reliability
from vapor.reporting.outline import Outline

CORNERS = np.array([[x, y, 1.6] for x in (-4.0, 4.0) for y in (-2.0, 2.0)], np.float32)
OUTLINE = Outline(np.repeat(CORNERS, 100, axis=0), "landmarks")


@pytest.fixture(scope="module")
def record():
    return simulated_record(150)


def plans_of(record) -> list[dict[str, np.ndarray]]:
    """Points of the lines of each plan by their class."""
    found = []
    for svg in re.findall(r"<svg.*?</svg>", plan(record, OUTLINE).html):
        lines = re.findall(r'<path class="(\w+)" d="([^"]*)"', svg)
        numbers = {name: re.findall(r"[ML](-?\d+) (-?\d+)", d) for name, d in lines}
        found.append({name: np.array(points, float) for name, points in numbers.items()})
    return found


def test_a_plan_has_the_path_among_the_landmarks_in_proportion_and_north_up(record):
    (drawn,) = plans_of(record)
    corners = np.unique(drawn["points"], axis=0)
    scale = np.ptp(corners[:, 0]) / 8.0
    assert np.ptp(corners[:, 1]) == pytest.approx(4.0 * scale, abs=2.0)
    middle = corners.mean(axis=0)
    expected = middle + scale * record.truth.poses.translation[:, :2] * [1.0, -1.0]
    np.testing.assert_allclose(drawn["truth"], expected, atol=1.5)
    assert len(drawn["path"]) == 150
    sure = np.array([status == "converged" for status in record.status])
    assert len(drawn["doubted"]) == (~sure).sum() > 0


def test_the_scale_has_ends_so_that_it_is_not_taken_for_the_truth(record):
    (bar,) = re.findall(r'<path class="bar" d="([^"]*)"', plan(record, OUTLINE).html)
    assert re.fullmatch(r"M\d+ \d+v20m0 -10h\d+m0 -10v20", bar)


def test_each_storey_that_the_path_is_on_has_a_plan(record):
    heights = tuple(1.6 + FLOOR_M * np.arange(-2, 5))
    floored = replace(record, storeys=Storeys(heights))
    drawn = plans_of(floored)
    on = floored.storeys.of(record.methods["filter"].poses)
    assert len(drawn) == len(np.unique(on)) < len(heights)
    assert sum(len(each["path"]) for each in drawn) == 150
    assert ["points" in each for each in drawn] == [number == 2 for number in np.unique(on)]
    words = ReadPage.of(plan(floored, OUTLINE).html).words
    assert f"storey {on.max()}, {heights[on.max()]:.1f} m" in words


def test_up_of_a_map_may_be_any_axis(record):
    turned = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # z up becomes y down, as cameras have it

    def other_way(trajectory):
        return replace(trajectory, poses=replace(trajectory.poses, translation=trajectory.poses.translation @ turned.T))

    methods = {name: other_way(each) for name, each in record.methods.items()}
    storeys = Storeys((0.0, 100.0), up=(0.0, -1.0, 0.0))
    other = replace(record, methods=methods, truth=other_way(record.truth), storeys=storeys)
    outline = replace(OUTLINE, points=OUTLINE.points @ turned.T.astype(np.float32))
    pages = [plan(*each).html for each in ((record, OUTLINE), (other, outline))]
    lines = [re.findall(r'<path class="truth" d="([^"]*)"', page) for page in pages]
    assert lines[0] == lines[1]


def test_a_long_path_is_thinned_but_for_its_jumps():
    path = np.zeros((9000, 3))
    path[:, 0] = np.linspace(0.0, 90.0, 9000)
    path[5001:, 1] = 8.0
    thin = ThinnedPath.of(path)
    assert len(thin.kept) < 1510
    assert thin.kept[thin.broken].tolist() == [5001]
    assert 5000 in thin.kept
    assert len(ThinnedPath.of(path[:1]).kept) == 1


def test_the_diagram_and_its_table_have_the_numbers_of_the_report():
    stated = np.array([0.31, 0.33, 0.95, 0.97])
    block = reliability(Reliability.of(stated, np.array([True, False, True, True])).as_json())
    page = ReadPage.of(block.html)
    assert page.cells[4:] == ["0.3 to 0.4", "2", "0.32", "0.50", "0.9 to 1.0", "2", "0.96", "1.00"]
    dots = [tuple(map(int, each)) for each in re.findall(r'class="dot" d="M(\d+) (\d+)h0"', block.html)]
    (left, right), (low, high) = ([dot[i] for dot in dots] for i in (0, 1))
    assert (right - left) / (0.96 - 0.32) == pytest.approx((low - high) / 0.5, rel=0.02)
