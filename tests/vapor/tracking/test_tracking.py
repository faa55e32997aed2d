"""The table of tracking methods, and the step loop that leads them from image to image."""

import numpy as np
import pytest

from filtering.config import LocalizerConfig
from filtering.estimate import Mode
from filtering.hindsight import FilterStep
from filtering.localizer import ParticleLocalizer
from filtering.observation import Observation
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from tests.helpers.simulation import lifted, motion, seen_at
from vapor.tracking.hindsight import LookBack
from vapor.tracking.loop import Localizer, StepLoop, Tracker, elapsed_s
from vapor.tracking.methods import BASELINES, METHODS, in_order, start_baselines

ONWARD = motion(0.1, 0, 0, 0, 0, 0)
S = 1_000_000_000


class Noting:
    """A baseline that stays where it is, and notes what it was given."""

    def __init__(self):
        self.given = []

    def advance(self, observation):
        self.given.append(observation)
        return Mode(Poses.identity(), np.eye(6), 1.0)


def loop_of(**baselines) -> StepLoop:
    return StepLoop(ParticleLocalizer(None, rng=np.random.default_rng(0)), baselines)


def test_every_method_has_a_label_a_file_and_a_color_of_its_own():
    for field in ("label", "file", "color"):
        assert len({getattr(method, field) for method in METHODS.values()}) == len(METHODS)
    assert BASELINES == ("kalman", "gaussian_sum")
    assert [name for name, method in METHODS.items() if method.can_converge] == [
        *BASELINES,
        "filter",
        "smoothed",
        "fixed_lag",
    ]
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
    observations = [
        Observation.of_posterior(posterior, odometry, elapsed_s(*stamps))
        for stamps, posterior, odometry in zip(
            ((None, 5 * S), (5 * S, 6 * S), (6 * S, 4 * S)), posteriors, (None, ONWARD, None), strict=True
        )
    ]
    for observation in observations:
        step = loop.step(observation, observe_ms=0.0)
        assert step.observation is observation
        assert step.baselines.keys() == {"one", "other"}
        assert step.step_ms > 0
    assert one.given == other.given == observations
    assert [given.elapsed_s for given in one.given] == [0.0, 1.0, 0.0]


def test_where_an_image_is_uninformative_its_places_are_those_of_the_last_one_that_did():
    loop = loop_of()
    alike = seen_at(lifted(Poses.identity(), [0.0, 3.0]), [0.6, 0.4])
    seen = loop.step(Observation.of_posterior(alike, None), observe_ms=0.0)
    assert [mode.weight for mode in seen.image_modes] == [0.6, 0.4]
    empty = loop.step(Observation.of_posterior(PosePosterior.uninformative(), ONWARD), observe_ms=0.0)
    assert empty.image_modes == seen.image_modes
    outside = seen_at(Poses.identity(), ood_score=3.0)
    unlike = loop.step(Observation.of_posterior(outside, ONWARD), observe_ms=0.0)
    assert len(unlike.image_modes) == 1


@pytest.mark.usefixtures("unchecked")
def test_a_look_back_needs_a_few_kilobytes_of_an_image_and_has_a_pose_for_each():
    loop, config, steps = loop_of(), LocalizerConfig(), []
    many = seen_at(lifted(Poses.identity(), np.arange(20.0)), np.full(20, 0.05))
    for i in range(4):
        observation = Observation.of_posterior(many, ONWARD if i else None)
        steps.append(FilterStep.of(observation, loop.step(observation, observe_ms=0.0).estimate))
    assert [len(step.posterior.weights) for step in steps] == [16] * 4
    back = LookBack.on(steps, np.arange(4) * 100_000_000, many.noise, config, lag_s=0.2)
    assert list(back.trajectories) == ["smoothed", "fixed_lag"]
    assert all(len(each.poses) == 4 for each in back.trajectories.values())
