"""Modes and places from above."""

from dataclasses import replace

import matplotlib
import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.path import Path

from filtering.errors import VaporTrackError
from filtering.estimate import Mode
from filtering.plots import level_axes
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from tests.helpers.simulation import RNG, lifted, new_localizer, seen_at

matplotlib.use("Agg")
Y_UP = Poses(np.diag([1.0, -1.0, -1.0]), np.zeros(3))  # a level camera in a world whose y is up
Z_UP = Poses(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]), np.zeros(3))
TILTED = np.array([[0.04, 0.015, 0.0], [0.015, 0.01, 0.0], [0.0, 0.0, 0.09]])


@pytest.fixture(autouse=True)
def closed():
    yield
    pyplot.close("all")


def estimate_of(pose, heights_m=(0.0, 3.0)):
    return new_localizer().update(seen_at(lifted(pose, heights_m), [0.9 / len(heights_m)] * len(heights_m)), None)


def outlines(axes):
    return [Path(line.get_xydata()) for line in axes.lines if len(line.get_xydata()) > 50]


@pytest.mark.parametrize("degrees_of_freedom", [np.inf, 5.0])
@pytest.mark.parametrize("plane", ["xy", "zx"])
def test_a_region_holds_its_share_of_the_true_positions(degrees_of_freedom, plane):
    pose = Poses.exp(np.array([1.0, 2.0, 3.0, 0.5, -0.4, 0.9]))
    covariance = np.diag([0.0] * 3 + [0.05**2] * 3)
    covariance[:3, :3] = TILTED
    mode = Mode(pose, covariance, 1.0, degrees_of_freedom=degrees_of_freedom)
    rng, count = RNG(0), 20_000
    error = rng.multivariate_normal(np.zeros(6), covariance, count)
    if np.isfinite(degrees_of_freedom):
        error /= np.sqrt(rng.chisquare(degrees_of_freedom, count) / degrees_of_freedom)[:, None]
    true = (pose.rotation @ error[:, :3, None])[..., 0] + pose.translation  # of positions; turning moves none
    estimate = replace(estimate_of(pose), modes=(mode,))
    (region,) = outlines(estimate.plot(plane=plane, probability=0.9))
    within = region.contains_points(true[:, ["xyz".index(axis) for axis in plane]])
    assert abs(within.mean() - 0.9) < 0.01


@pytest.mark.parametrize(("pose", "expected"), [(Z_UP, "xy"), (Y_UP, "xz")])
def test_the_horizontal_axes_are_drawn_in_metres_at_one_scale(pose, expected):
    axes = estimate_of(pose).plot()
    assert (axes.get_xlabel(), axes.get_ylabel()) == (f"{expected[0]} [m]", f"{expected[1]} [m]")
    assert axes.get_aspect() == 1.0


def test_without_cameras_x_and_y_are_horizontal():
    assert level_axes(Poses.identity(0)) == (0, 1)


def test_an_estimate_is_drawn_into_given_axes_with_its_weights_and_the_true_pose():
    _, (left, right) = pyplot.subplots(1, 2, sharex=True, sharey=True)
    left.set_title("mine")
    estimate = estimate_of(Z_UP)
    assert estimate.plot(left, plane="xz", truth=Z_UP) is left
    estimate.plot(right, truth=lifted(Z_UP, np.linspace(0, 1, 5)))
    left.figure.canvas.draw()
    assert left.get_title() == "mine"
    assert right.get_title() == f"ambiguous: best mode {100 * estimate.modes[0].weight:.0f} %"
    weights = [f"{100 * mode.weight:.0f} %" for mode in estimate.modes]
    assert sorted(each.get_text() for each in left.texts) == sorted(weights)
    assert [each.get_text() for each in right.texts] == [" + ".join(weights)]  # one above the other
    assert left.get_legend() is None
    names = [axes.get_legend_handles_labels()[1] for axes in (left, right)]
    assert names[0] == ["particles", "best mode, 90 % region", "other modes", "true pose"]
    assert names[1][-1] == "true path"


def test_everything_drawn_is_within_the_axes():
    axes = estimate_of(Z_UP, (0.0, 3.0, 6.0, 9.0)).plot(plane="xz")
    axes.figure.canvas.draw()
    for label in axes.texts:
        box = label.get_window_extent()
        assert axes.bbox.contains(box.x0, box.y0)
        assert axes.bbox.contains(box.x1, box.y1)


def test_a_posterior_is_drawn_with_its_places_and_samples():
    posterior = seen_at(lifted(Z_UP, (0.0, 3.0)), (0.6, 0.3))
    axes = posterior.plot(plane="xz", probability=0.5)
    assert axes.get_title() == "2 places"
    assert len(outlines(axes)) == 2
    assert axes.get_legend().get_texts()[1].get_text() == "best place, 50 % region"
    assert len(axes.collections[0].get_offsets()) == len(posterior.samples)
    far = replace(posterior, ood_score=2.0)
    assert far.plot().get_title() == "2 places, out of distribution"


def test_an_image_without_information_has_a_picture_too():
    axes = PosePosterior.uninformative().plot(truth=Z_UP)
    axes.figure.canvas.draw()
    assert axes.get_title() == "no place"


@pytest.mark.parametrize("plane", ["x", "xx", "xw", "xyz", ""])
def test_a_plane_that_is_none_is_named(plane):
    with pytest.raises(VaporTrackError, match="expected two of x, y and z"):
        estimate_of(Z_UP).plot(plane=plane)


def test_a_probability_that_is_none_is_named():
    with pytest.raises(VaporTrackError, match=r"region of probability 1\.5"):
        estimate_of(Z_UP).plot(probability=1.5)
