"""What recordings show: by which of them, on which storeys, how often and looking which way."""

import numpy as np
import pytest

from filtering.se3 import Poses
from filtering.storeys import find_storeys
from tests.helpers.corridors import corridor, recorded, stairwell
from vapor.inspection.coverage import Coverage, in_axes
from vapor.training.holding_out import shown_by


def test_a_storey_that_one_walk_alone_shows_is_said_with_its_images_and_height():
    coverage = Coverage(stairwell(top=(4,)))
    (segment,) = coverage.alone()
    assert str(segment) == "walk4: images 300 to 399 (height 9.0 m)"
    assert [storey.names for storey in coverage.storeys()][-1] == ("walk4",)
    assert len(coverage.storeys()) == 4
    np.testing.assert_array_equal(coverage.others == 0, coverage.images.poses.translation[:, 2] > 8.9)


def test_a_top_storey_where_all_walks_end_is_held_out_in_one_of_them():
    floors = [(0, 10, 3.0 * storey) for storey in range(3)] + [(0, 3, 9.0)]
    walks = [
        Poses.concatenate([corridor(begin, end, y_m=0.1 * i, z_m=z_m) for begin, end, z_m in floors]) for i in range(5)
    ]
    coverage = Coverage(recorded(*walks))
    assert coverage.alone() == []
    top = coverage.storeys()[-1]
    assert (len(top.names), top.trained, top.images) == (5, 4, 150)
    assert (coverage.split.held_out_mask & (coverage.storey == 3)).sum() == 30


def test_another_pass_of_the_same_walk_counts_and_a_straight_one_does_not():
    once = recorded(corridor(0, 20))
    assert not shown_by(once, 1.0).any()
    twice = recorded(Poses.concatenate([corridor(0, 20), corridor(20, 0, y_m=0.2)]))
    assert shown_by(twice, 1.0).mean() > 0.8
    passes = Coverage(twice).passes
    assert passes[len(passes) // 4].passes == 2
    backwards = recorded(Poses.concatenate([corridor(0, 20), corridor(20, 0, y_m=0.2, ahead=False)]))
    assert not shown_by(backwards, 1.0).any()


def test_cells_count_the_walks_through_them_and_which_way_they_looked():
    coverage = Coverage(recorded(*(corridor(0, 10, y_m=0.02 * i) for i in range(3)), corridor(10, 5, ahead=False)))
    middle = [cell for cell in coverage.passes if coverage.cell_m * cell.column < 4.0]
    far = [cell for cell in coverage.passes if 6.0 < coverage.cell_m * cell.column < 9.0]
    assert {cell.passes for cell in middle} == {3}
    assert {cell.passes for cell in far} == {4}
    assert all(dict(cell.looked) == {0: 3, 4: 1} for cell in far)


@pytest.mark.parametrize("up", ["+z", "+y"])
def test_up_is_where_cameras_are_upright(up):
    rotation = np.eye(3) if up == "+z" else np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    poses = corridor(0, 10)
    coverage = Coverage(recorded(Poses(rotation @ poses.rotation, poses.translation @ rotation.T)))
    assert [in_axes(axis) for axis in coverage.axes] == ["+x", "+y" if up == "+z" else "-z", up]
    assert {coverage.direction(sector) for sector in coverage.sectors.tolist()} == {"+x"}


def test_storeys_are_found_where_places_lie_above_each_other():
    x = np.linspace(0.0, 10.0, 101)
    cells = np.concatenate([np.floor(x), np.floor(x)]).astype(np.int64)
    storey, count = find_storeys(np.concatenate([0 * x, 0 * x + 3.0]), cells)
    assert count == 2
    np.testing.assert_array_equal(storey, np.repeat([0, 1], 101))
    assert find_storeys(0.5 * np.concatenate([x, x]), cells)[1] == 1  # a ramp
    assert find_storeys(np.concatenate([0 * x, 0 * x + 0.8]), cells)[1] == 1  # a camera held higher
