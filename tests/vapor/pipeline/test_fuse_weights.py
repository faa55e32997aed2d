"""Weights of hypotheses in `vapor-track fuse`: what they are worth, and files that state them."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from filtering.se3 import Poses
from tests.helpers.pose_files import file_of, hypotheses, moved, noisy, walk
from tests.helpers.simulation import ERRORS
from vapor.pipeline.fuse import EstimateConfig, EstimateModel, mixture_weights
from vapor.track import main

SMALL = ["--localizer.max-hypotheses", "60", "--no-recording"]
WEIGHTED = ["--columns", "name qw qx qy qz tx ty tz _ weight"]


WEIGHTS = st.lists(st.tuples(st.integers(0, 3), st.floats(1e-3, 1e4)), min_size=1, max_size=12)


@given(WEIGHTS, st.floats(1e-3, 1e3))
def test_weights_of_a_file_are_in_proportion_in_any_unit_and_files_count_alike(hypotheses, unit):
    file, weight = (np.array(each) for each in zip(*hypotheses, strict=True))
    found = mixture_weights(file, weight, 0.0)
    assert found.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(mixture_weights(file, unit * weight, 0.0), found, rtol=1e-9)
    for one in np.unique(file):
        own = file == one
        assert found[own].sum() == pytest.approx(1.0 / len(np.unique(file)))
        np.testing.assert_allclose(found[own] / found[own].sum(), weight[own] / weight[own].sum(), rtol=1e-9)


@given(WEIGHTS, st.floats(0.0, 1e3), st.floats(1.001, 100.0))
def test_the_more_weight_a_frame_has_the_less_is_left_for_none_of_its_hypotheses(hypotheses, outlier_weight, more):
    file, weight = (np.array(each) for each in zip(*hypotheses, strict=True))
    found, with_more = (mixture_weights(file, factor * weight, outlier_weight) for factor in (1.0, more))
    assert (with_more >= found * (1.0 - 1e-12)).all()
    assert (found > 0.0).all()
    assert found.sum() <= 1.0 + 1e-9


def test_known_weights():
    """30 and 10 inliers beside 10 votes for none: 3/5 and 1/5, and half of that beside another file."""
    np.testing.assert_allclose(mixture_weights(np.zeros(2, int), np.array([30.0, 10.0]), 10.0), [0.6, 0.2])
    both = mixture_weights(np.array([0, 2, 0]), np.array([30.0, 40.0, 10.0]), 10.0)
    np.testing.assert_allclose(both, [0.3, 0.4, 0.1])


def test_hypotheses_have_the_uncertainty_of_their_file_and_the_probability_of_their_weight():
    model = EstimateModel(2, EstimateConfig(std_m=(0.05, 0.1), outlier_weight=10.0), ERRORS)
    far = moved(Poses.identity(), 5.0)
    seen = hypotheses((0, 10.0, far), (0, 30.0, Poses.identity()), (1, 90.0, Poses.identity()))
    posterior = model.observe(seen, rng=np.random.default_rng(0))
    np.testing.assert_allclose(posterior.weights, [0.1, 0.3, 0.45])
    np.testing.assert_allclose(posterior.covariances[:, 0, 0], [0.05**2, 0.05**2, 0.1**2])


@pytest.mark.usefixtures("unchecked")
def test_the_hypothesis_with_more_inliers_is_the_single_image_and_the_filter_finds_the_right_one_all_the_same(
    tmp_path, truth
):
    """In the images 20 to 39 of a sequence a place elsewhere, another one each time, has more inliers."""
    poses = walk()
    right = noisy(poses, 0.02, 0.01, 1)
    rng = np.random.default_rng(0)
    wrong = {name: moved(pose, rng.uniform(1.0, 3.0)) for name, pose in right.items()}
    misled = {name for name in poses if 20 <= int(name[-16:-10]) < 40}
    lines = []
    for name in poses:
        for pose, inliers in ((right[name], 60 if name in misled else 200), (wrong[name], 90)):
            x, y, z, w = pose.inverse().as_quat_xyzw()
            values = " ".join(f"{value:.9f}" for value in (w, x, y, z, *pose.inverse().translation))
            lines.append(f"{name} {values} 525.0 {inliers}")
    rng.shuffle(lines)
    (tmp_path / "top2.txt").write_text("\n".join(lines))
    words = ["fuse", str(tmp_path / "top2.txt"), "--simulate-odometry", str(truth), "--direction", "world-to-camera"]
    output = tmp_path / "result"
    assert main([*words, "--output", str(output), *SMALL, *WEIGHTED, "--outlier-weight", "10"]) == 0
    report = json.loads((output / "report.json").read_text())
    assert report["single_image"]["worse_than"]["0.5m"] == pytest.approx(1 / 3)
    assert report["filter"]["worse_than"]["0.25m"] == 0.0


def test_weights_that_are_missing_are_said_with_the_file_and_the_line(tmp_path, truth, capsys):
    plain = file_of(tmp_path / "plain.txt", walk())
    output = tmp_path / "result"
    words = ["fuse", str(plain), "--simulate-odometry", str(truth), "--direction", "world-to-camera"]
    words += ["--output", str(output)]
    assert main([*words, "--outlier-weight", "10"]) == 1
    assert "plain.txt: no weights, expected a column of them (--columns)" in capsys.readouterr().err
    assert main([*words, *WEIGHTED]) == 1
    assert "plain.txt:1: 8 columns, expected the 10 of" in capsys.readouterr().err
    with pytest.raises(SystemExit) as stop:
        main([*words, "--columns", "name qw qx qy qz tx ty tz inliers"])
    assert stop.value.code == 2
    assert "'inliers' in" in capsys.readouterr().err
    assert not output.exists()
