"""The table of tracking methods, and the step loop that leads them from image to image."""

import numpy as np
import pytest

from filtering.config import LocalizerConfig
from filtering.estimate import Mode
from filtering.localizer import ParticleLocalizer
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from tests.helpers.simulation import lifted, motion, seen_at
from vapor.tracking.loop import MOST_MODES, History, Localizer, StepLoop, Tracker
from vapor.tracking.methods import BASELINES, METHODS, in_order, poses_at_end, start_baselines

ONWARD = motion(0.1, 0, 0, 0, 0, 0)
S = 1_000_000_000


class Noting:
    """A baseline that stays where it is, and notes what it was given."""

    def __init__(self):
        self.given = []

    def update(self, posterior, odometry, *, elapsed_s):
        self.given.append((posterior, odometry, elapsed_s))
        return Mode(Poses.identity(), np.eye(6), 1.0)


def loop_of(**baselines) -> StepLoop:
    return StepLoop(ParticleLocalizer(None, rng=np.random.default_rng(0)), baselines)


def test_every_method_has_a_label_a_file_and_a_color_of_its_own():
    for field in ("label", "file", "color"):
        assert len({getattr(method, field) for method in METHODS.values()}) == len(METHODS)
    assert BASELINES == ("kalman", "gaussian_sum")
    assert [name for name, method in METHODS.items() if method.can_converge] == [*BASELINES, "filter", "smoothed"]
    assert list(in_order({"filter": 2, "frames": 3, "kalman": 1})) == ["kalman", "filter"]


def test_baselines_are_started_with_a_source_of_draws_each_or_one_for_all():
    started = start_baselines(LocalizerConfig(), lambda: np.random.default_rng(0))
    assert list(started) == list(BASELINES)
    assert all(isinstance(tracker, Tracker) for tracker in started.values())
    assert list(start_baselines(LocalizerConfig(), lambda: np.random.default_rng(0), only=("kalman",))) == ["kalman"]
    assert isinstance(ParticleLocalizer(None, rng=np.random.default_rng(0)), Localizer)


def test_all_methods_are_given_the_same_and_told_how_long_it_was():
    one, other = Noting(), Noting()
    loop = loop_of(one=one, other=other)
    posteriors = [seen_at(Poses.exp(np.array([0.1 * i, 0, 0, 0, 0, 0]))) for i in range(3)]
    for time_ns, posterior, odometry in zip((5 * S, 6 * S, 4 * S), posteriors, (None, ONWARD, None), strict=True):
        step = loop.step(time_ns, posterior, odometry, observe_ms=0.0)
        assert step.posterior is posterior
        assert step.baselines.keys() == {"one", "other"}
        assert step.step_ms > 0
    assert [given[1:] for given in one.given] == [(None, 0.0), (ONWARD, 1.0), (None, 0.0)]
    assert all(mine[0] is theirs[0] for mine, theirs in zip(one.given, other.given, strict=True))


def test_where_an_image_is_uninformative_its_places_are_those_of_the_last_one_that_did():
    loop = loop_of()
    seen = loop.step(0, seen_at(lifted(Poses.identity(), [0.0, 3.0]), [0.6, 0.4]), None, observe_ms=0.0)
    assert [mode.weight for mode in seen.image_modes] == [0.6, 0.4]
    assert seen.evidence == seen.image_modes
    empty = loop.step(S, PosePosterior.uninformative(), ONWARD, observe_ms=0.0)
    assert (empty.image_modes, empty.evidence) == (seen.image_modes, ())
    unlike = loop.step(2 * S, seen_at(Poses.identity(), ood_score=3.0), ONWARD, observe_ms=0.0)
    assert len(unlike.image_modes) == 1
    assert unlike.evidence == ()


@pytest.mark.usefixtures("unchecked")
def test_a_history_has_what_methods_at_the_end_need():
    loop, history, config = loop_of(), History(), LocalizerConfig()
    many = seen_at(lifted(Poses.identity(), np.arange(20.0)), np.full(20, 0.05))
    for i in range(4):
        step = loop.step(i * S, many, ONWARD if i else None, observe_ms=0.0)
        history.add(step, ONWARD if i else None)
    assert [len(modes) for modes in history.evidence] == [MOST_MODES] * 4
    assert history.odometry == [None, ONWARD, ONWARD, ONWARD]
    assert len(history.normalized_distances) == len(history.converged) == len(history.filtered) == 4
    poses = poses_at_end(history, many.errors, config)
    assert list(poses) == ["smoothed"]
    assert poses["smoothed"].batch_shape == (4,)
