"""The check at the end of a training: filter beside single image on held-out passes, and what is kept."""

from dataclasses import replace

import numpy as np
import pytest

from filtering.measurement_noise import MeasurementNoise
from filtering.se3 import Poses
from tests.helpers.full import full, some
from tests.helpers.simulation import frames_of
from vapor.calibration import calibrate
from vapor.calibration.calibrate import CalibrationResult
from vapor.checkpoints.calibration import Calibration
from vapor.training import check as training_check
from vapor.training import progress as check_result
from vapor.training.check import check
from vapor.training_data.load import load_training_set

pytestmark = pytest.mark.usefixtures("unchecked")

STD = np.array([0.1, 0.1, 0.1, 0.03, 0.03, 0.03])
SIX = (0.1, 0.1, 0.1, 0.03, 0.03, 0.03)
HONEST = MeasurementNoise(
    noise_floor=SIX, typical_std=SIX, length_m=0.5, length_rad=0.5, correlated_fraction=0.5, log_clutter_density=-4.0
)


@pytest.fixture(scope="module")
def images():
    return load_training_set({str(k): frames_of(90, seed=k) for k in range(2)}, (36, 36))


def network_that_errs(std, correlated=0.0):
    """In place of a network: samples about true poses that are off, the same way all along by a share."""

    def predict(network, images, num_samples, seed):
        rng = np.random.default_rng(int(images.rows[0]))
        always = np.sqrt(correlated) * rng.standard_normal(6)
        for i in range(len(images)):
            off = std * (always + np.sqrt(1.0 - correlated) * rng.standard_normal(6))
            yield images.poses[i] @ Poses.exp(off) @ Poses.exp(1e-3 * rng.standard_normal((60, 6)))

    return predict


def checked(images, errors, predict, monkeypatch, judged=None, **result):
    monkeypatch.setattr(calibrate, "predict", predict)
    calibrated = CalibrationResult(Calibration(errors=errors), **result)
    judged = np.ones(len(images), bool) if judged is None else judged
    return check(None, images, judged, calibrated, None, images.poses, seed=0)


def test_where_errors_are_as_found_the_filter_is_better_and_nothing_is_changed(images, monkeypatch):
    steps = []
    monkeypatch.setattr(calibrate, "predict", network_that_errs(STD))
    result = CalibrationResult(Calibration(errors=HONEST))
    found, kept = check(
        None, images, np.ones(180, bool), result, None, images.poses, seed=0, advance=lambda *at: steps.append(at)
    )
    assert steps[-1] == (180, 180)
    assert (found.images, found.passes) == (180, 2)
    assert kept == result.calibration
    assert found.methods["filter"].median_m < found.methods["single_image"].median_m
    assert (found.worse, found.overconfident, found.inflation, found.assumed) == (False, False, 1.0, False)
    assert found.verdict.startswith("the filter is right in ")
    assert "Beware" not in found.verdict


@pytest.mark.parametrize(
    ("times", "share"), some(1, [(1.0, 1 / 16), (4.5, 1 / 4)])
)  # with the larger one hardly any is right
def test_errors_found_too_small_are_taken_larger_and_that_is_said(times, share, images, monkeypatch):
    small, judged = HONEST.inflated(share * times**2), np.arange(180) % 90 >= 45
    found, kept = checked(images, small, network_that_errs(times * STD, correlated=0.9), monkeypatch, judged)
    assert (found.methods["single_image"].right < 0.2) == (times > 1.0)
    assert found.inflation > 1.0 or found.assumed
    assert kept.errors.typical_std[0] > small.typical_std[0]
    assert not found.overconfident
    assert "as large as they were found" in found.verdict or "are assumed" in found.verdict


@full
def test_a_network_that_knows_nothing_is_told(images, monkeypatch):
    def anywhere(network, images, num_samples, seed):
        rng = np.random.default_rng(0)
        for _ in range(len(images)):
            yield Poses.exp(rng.uniform(-3, 3, (1, 6))) @ Poses.exp(0.01 * rng.standard_normal((10, 6)))

    found, kept = checked(images, HONEST, anywhere, monkeypatch, np.arange(180) < 60)
    assert found.methods["single_image"].right < 0.2
    assert found.worse or found.overconfident
    assert found.verdict.endswith("because the network hardly knows the place: record more of it, or train for longer")
    assert kept.errors == HONEST  # no others are any better, and none is chosen by luck
    assert found.inflation == 1.0
    assert not found.assumed


def test_causes_are_told_apart(images):
    figures = {name: check_result.Figures(1.0, 5.0, 0.5) for name in training_check.METHODS}
    bad = check_result.TrainingCheck(100, 1, figures | {"filter": check_result.Figures(2.0, 5.0, 0.3)}, 0.0, None, None)
    assert bad.worse
    few = CalibrationResult(Calibration(), effective_images=4.0)
    assert "worth only 4 independent ones" in check_result.verdict(bad, few)
    assert "longer than any held-out pass" in check_result.verdict(bad, replace(few, effective_images=40.0))
    sure = replace(bad, methods=figures, coverage={"50%": 0.1, "90%": 0.4, "95%": 0.5}, converged=0.5)
    assert not sure.worse
    assert "overconfident" in check_result.verdict(sure, few)


def test_a_pass_leads_on_over_images_left_out_and_ends_where_odometry_does(images, monkeypatch):
    judged = np.zeros(180, bool)
    judged[[*range(20, 40), *range(50, 70), *range(100, 130)]] = True
    found, _ = checked(images, HONEST, network_that_errs(STD), monkeypatch, judged)
    assert (found.images, found.passes) == (70, 2)
    judged[:] = False
    judged[75:120] = True  # fifteen images at the end of a recording, and thirty of the next
    found, _ = checked(images, HONEST, network_that_errs(STD), monkeypatch, judged)
    assert (found.images, found.passes) == (30, 1)
    bare = load_training_set({"a": frames_of(60, odometry=False)}, (36, 36))
    assert checked(bare, HONEST, network_that_errs(STD), monkeypatch)[0] is None
