"""Settings and input of the filter that are out of range."""

import numpy as np
import pytest

from filtering.config import GapConfig, LocalizerConfig
from filtering.errors import VaporTrackError
from filtering.localizer import ParticleLocalizer
from filtering.motion import Odometry
from filtering.se3 import Poses
from tests.helpers.simulation import image_of, new_localizer, seen_at

# --- settings -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "change"),
    [
        (LocalizerConfig, {"max_hypotheses": 0}),
        (LocalizerConfig, {"kidnap_per_view": -1.0}),
        (LocalizerConfig, {"merge_divergence": float("nan")}),
        (LocalizerConfig, {"least_weight": 0.5}),
        (LocalizerConfig, {"converged_std_m": float("inf")}),
        (LocalizerConfig, {"converged_weight": 1.5}),
        (LocalizerConfig, {"agreement_s": 0.0}),
        (LocalizerConfig, {"switch_ratio": 0.5}),
        (GapConfig, {"speed_m_per_s": -1.0}),
        (GapConfig, {"turn_rad_per_s": float("nan")}),
    ],
)
def test_settings_out_of_range_are_refused(kind, change):
    ((name, value),) = change.items()
    with pytest.raises(VaporTrackError, match=rf"^{name} is {value}, expected between "):
        kind(**change)


def test_a_filter_fed_with_posteriors_needs_no_model_and_says_so_when_shown_an_image():
    with pytest.raises(VaporTrackError, match="no observation model"):
        new_localizer().step(image_of(0), None)


# --- what a review found --------------------------------------------------------------------------


@pytest.mark.parametrize("elapsed_s", [-1.0, np.inf, np.nan])
def test_an_elapsed_time_that_is_none_is_refused_with_odometry_too(elapsed_s):
    localizer = ParticleLocalizer(None, rng=np.random.default_rng(0))
    with pytest.raises(VaporTrackError, match="since the previous step"):
        localizer.update(seen_at(Poses.identity(1)), None, elapsed_s=elapsed_s)


def test_a_gap_however_long_leaves_a_belief():
    localizer = ParticleLocalizer(None, rng=np.random.default_rng(0))
    localizer.update(seen_at(Poses.identity(1)), None)
    estimate = localizer.update(seen_at(Poses.identity(1)), None, elapsed_s=1e100)
    assert np.isfinite(estimate.modes[0].covariance).all()


def test_a_variance_beyond_all_bounds_is_refused():
    localizer = ParticleLocalizer(None, rng=np.random.default_rng(0))
    localizer.update(seen_at(Poses.identity(1)), None)
    with pytest.raises(VaporTrackError, match="give no odometry"):
        localizer.update(seen_at(Poses.identity(1)), Odometry(Poses.identity(), 1e100 * np.eye(6), 0.1))
