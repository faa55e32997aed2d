"""The success of short sequences, each from a flat prior."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from filtering.config import LocalizerConfig
from filtering.motion import Odometry
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from tests.helpers.modelled_walk import ERRORS, walk
from vapor.benchmark.evaluation import evaluate_sequences, starts_of_sequences, succeeds
from vapor.tracking.follow import Segment, follow

pytestmark = pytest.mark.usefixtures("unchecked")

STILL = Odometry(Poses.identity(), 1e-6 * np.eye(6), 0.1)


def segment_of(made) -> Segment:
    times_ns = 100_000_000 * np.arange(len(made.posteriors))
    return Segment(times_ns, tuple(made.odometry), made.truth, made.posteriors.__getitem__)


def followed(segment: Segment, noise=ERRORS):
    return follow(segment, noise, LocalizerConfig(), rng=np.random.default_rng(0), baselines=())


def test_one_of_the_last_ten_images_off_is_a_failure_and_of_those_before_none_counts():
    truth = Poses(np.tile(np.eye(3), (15, 1, 1)), np.zeros((15, 3)))

    def off(image: int, metres: float) -> Poses:
        position = np.zeros((15, 3))
        position[image] = metres * np.array([0.6, 0.0, 0.8])
        return Poses(truth.rotation, position)

    assert succeeds(truth, truth) == {"1m": True, "0.5m": True}
    assert succeeds(off(4, 9.0), truth) == {"1m": True, "0.5m": True}
    assert succeeds(off(5, 9.0), truth) == {"1m": False, "0.5m": False}
    assert succeeds(off(14, 0.75), truth) == {"1m": True, "0.5m": False}
    assert succeeds(off(14, 0.5), truth)["0.5m"] is False  # closer, as F3Loc has it
    turned = truth @ Poses.exp(np.array([0.0, 0.0, 0.0, 0.0, 3.0, 0.0]))
    assert succeeds(turned, truth) == {"1m": True, "0.5m": True}


def naive_starts(length: int, usable: list[bool], breaks: list[bool], empty: list[bool]) -> list[int]:
    starts, start = [], 0
    while start + length <= len(usable):
        if all(usable[start : start + length]) and not any(breaks[start + 1 : start + length]) and not empty[start]:
            starts.append(start)
            start += length
        else:
            start += 1
    return starts


@settings(deadline=None, max_examples=200)
@given(
    st.integers(1, 6),
    st.lists(st.tuples(*[st.sampled_from([True] * 8 + [False])] * 3), min_size=1, max_size=40),
)
def test_sequences_are_the_earliest_without_gaps_that_begin_with_a_place(length, images):
    usable, moved, seen = (list(each) for each in zip(*images, strict=True))
    segment = Segment(
        np.arange(len(images)) * 10**8,
        tuple(STILL if each else None for each in moved),
        Poses.identity(len(images)),
        lambda image: (
            PosePosterior.from_estimates(Poses.identity(1), 0.1, 0.1, ERRORS)
            if seen[image]
            else PosePosterior.uninformative(ERRORS)
        ),
    )
    found = list(starts_of_sequences(segment, length, np.array(usable)))
    assert found == naive_starts(length, usable, [not each for each in moved], [not each for each in seen])


def test_a_sequence_knows_nothing_of_what_was_seen_before_it():
    """The first fifteen images show where the camera is; of the next each fits a place ten metres above as well."""
    made = walk(30, rng=np.random.default_rng(1), lifts=lambda i: (0.0,) if i < 15 else (10.0, 0.0))
    segment = segment_of(made)
    whole = followed(segment)
    assert succeeds(whole.poses["filter"], made.truth) == {"1m": True, "0.5m": True}
    figures = evaluate_sequences(whole, seed=(0,))
    assert figures["15"]["sequences"] == 2
    assert figures["15"]["success"]["single_image"] == {"1m": 0.5, "0.5m": 0.5}
    assert figures["15"]["success"]["filter"]["1m"] == 0.5
    assert set(figures["15"]["success"]) == {"single_image", "kalman", "gaussian_sum", "filter"}
    assert figures["100"] == {"sequences": 0, "success": None}
    # The other way round: what comes first says as little of what comes later.
    later = np.arange(30) >= 15
    assert evaluate_sequences(whole, seed=(0,), images=~later)["15"]["success"]["filter"]["1m"] == 1.0
    assert evaluate_sequences(whole, seed=(0,), images=later)["15"]["success"]["filter"]["1m"] == 0.0


def test_what_is_unique_early_in_a_sequence_helps_its_end_and_no_single_image():
    made = walk(15, rng=np.random.default_rng(2), lifts=lambda i: (0.0,) if i < 3 else (10.0, 0.0))
    success = evaluate_sequences(followed(segment_of(made)), seed=(0,))["15"]["success"]
    assert success["filter"]["1m"] == success["gaussian_sum"]["1m"] == 1.0
    assert success["single_image"]["1m"] == 0.0


def test_limits_grow_with_the_unit():
    def lifts(i):
        return (0.0,) if i < 3 or 15 <= i < 18 else (10.0, 0.0)

    found = []
    for unit in (1.0, 30.0):
        made = walk(45, rng=np.random.default_rng(3), lifts=lifts, unit=unit)
        noise = ERRORS.scaled(unit)
        found.append(evaluate_sequences(followed(segment_of(made), noise), seed=(0,), unit_m=unit))
    assert found[0] == found[1]
    assert 0.0 < found[0]["15"]["success"]["filter"]["1m"] < 1.0  # the third one has nothing unique


def test_each_image_is_asked_for_once_however_many_sequences_it_is_in():
    made, asked = walk(210, rng=np.random.default_rng(4)), []
    segment = segment_of(made)

    def noted(image: int) -> PosePosterior:
        asked.append(image)
        return made.posteriors[image]

    whole = replace(followed(segment), segment=replace(segment, posterior=noted))
    figures = evaluate_sequences(whole, seed=(0,), baselines=())
    assert (figures["15"]["sequences"], figures["100"]["sequences"]) == (14, 2)
    assert sorted(asked) == list(range(210))
