import numpy as np
import pytest

from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from vapor.checkpoints.calibration import Calibration
from vapor.evaluation.posterior import posterior_metrics

CALIBRATION = Calibration(bandwidth_translation_m=0.05, bandwidth_rotation_rad=0.05)


def at(*places: tuple[float, float, int]) -> Poses:
    """So many poses each at x metres and a heading in degrees."""
    tangents = [np.array([[x, 0, 0, 0, 0, 0]] * count) for x, _, count in places]
    turns = np.concatenate([np.full(count, np.radians(deg)) for _, deg, count in places])
    turned = Poses.exp(np.column_stack([np.zeros((len(turns), 5)), turns]))
    return Poses(turned.rotation, np.concatenate(tangents)[:, :3])


def figures(*posteriors: Poses, **options):
    truth = Poses.identity(len(posteriors))
    return posterior_metrics(posteriors, truth, CALIBRATION, **options)


def test_the_paper_s_recall_asks_for_a_share_of_the_samples_within_both_limits():
    enough = at((0.05, 5.0, 10), (3.0, 0.0, 90))
    too_few = at((0.05, 5.0, 9), (3.0, 0.0, 91))
    turned_too_far = at((0.05, 12.0, 50), (3.0, 0.0, 50))
    recall = figures(enough, too_few, turned_too_far)["recall"]
    assert recall == pytest.approx({"0.1m/10deg": 1 / 3, "0.2m/15deg": 2 / 3, "0.3m/20deg": 2 / 3})
    assert figures(enough, too_few, turned_too_far, gamma=0.5)["recall"]["0.3m/20deg"] == pytest.approx(1 / 3)


def test_the_best_mode_and_the_best_sample_are_counted_beside_it():
    measured = figures(at((0.0, 0.0, 60), (4.0, 0.0, 40)), at((0.0, 0.0, 40), (4.0, 0.0, 60)), at((4.0, 0.0, 100)))
    assert measured["recall"]["0.1m/10deg"] == pytest.approx(2 / 3)
    assert measured["mode_recall"]["0.1m/10deg"] == pytest.approx(1 / 3)
    assert measured["oracle_recall"]["0.1m/10deg"] == pytest.approx(2 / 3)
    assert measured["modes"] == pytest.approx(5 / 3)
    assert measured["mode"]["translation_m"] == pytest.approx(4.0)


def test_means_are_arithmetic_in_position_and_chordal_in_rotation():
    measured = figures(at((0.0, 0.0, 50), (2.0, 40.0, 50)))
    assert measured["mean"] == pytest.approx({"translation_m": 1.0, "rotation_deg": 20.0})


def test_the_density_at_the_truth_is_that_of_the_kernels():
    measured = figures(at((0.0, 0.0, 25), (4.0, 0.0, 75)))
    log_kernel = -3 * np.log(2 * np.pi * 0.05**2)  # a Gaussian of six dimensions, nearly
    assert measured["negative_log_density"] == pytest.approx(-(log_kernel + np.log(0.25)), abs=0.01)


@pytest.mark.parametrize("gamma", [0.0, 1.5, float("nan")])
def test_a_share_that_is_none_is_refused(gamma):
    with pytest.raises(VaporTrackError, match="gamma is"):
        figures(at((0.0, 0.0, 10)), gamma=gamma)


def test_as_many_posteriors_as_true_poses_are_expected():
    posteriors = [at((0.0, 0.0, 10))] * 2
    for n in (1, 3, 0):
        with pytest.raises(VaporTrackError, match="expected one for each"):
            posterior_metrics(posteriors, Poses.identity(n), CALIBRATION)
