"""Clocks behind stamps: what is a step of one, and what is a network's or a camera's doing."""

import itertools
from collections.abc import Iterable, Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sequences.reading.timeline import ClockOfStream, StampKind
from tests.helpers.checks import no_checks

BEGIN_S = 1_700_000_000.0
RATES = st.floats(1.0, 200.0)


def told(stamps_s: Iterable[float], arrivals_s: Iterable[float]) -> list[StampKind]:
    """What a clock says of stamps that arrive at some times, all of them seconds after the same moment."""
    clock = ClockOfStream()
    with no_checks():
        return [
            clock.take(round((BEGIN_S + stamp) * 1e9), round((BEGIN_S + arrival) * 1e9))
            for stamp, arrival in zip(stamps_s, arrivals_s, strict=True)
        ]


def in_fifo(stamps_s: Sequence[float], delays_s: Iterable[float]) -> list[float]:
    """When messages arrive that are delayed, but never overtake each other."""
    sent = (stamp + delay for stamp, delay in zip(stamps_s, delays_s, strict=True))
    return list(itertools.accumulate(sent, max))


def at_rate(rate: float, duration_s: float) -> list[float]:
    """Stamps of a stream; a slow one has at least twenty."""
    return [n / rate for n in range(max(20, int(duration_s * rate)))]


@given(RATES, st.integers(0, 2**32 - 1), st.floats(-1e6, 1e6))
def test_stamps_in_their_order_are_usual_whatever_the_clock_says(rate: float, seed: int, offset_s: float) -> None:
    times = at_rate(rate, 3.0)
    delays = np.random.default_rng(seed).exponential(0.05, len(times)).clip(0.0, 0.9)
    assert set(told([t + offset_s for t in times], in_fifo(times, delays))) == {"usual"}


@given(RATES, st.floats(0.5, 3.0), st.floats(0.1, 6.0), st.floats(0.0, 0.2))
def test_messages_that_were_held_up_and_come_all_at_once_are_usual(
    rate: float, held_s: float, since_s: float, delay_s: float
) -> None:
    times = at_rate(rate, 12.0)
    until_s = since_s + held_s
    arrivals = in_fifo(times, [until_s - t if since_s <= t < until_s else delay_s for t in times])
    assert set(told(times, arrivals)) == {"usual"}


@given(RATES, st.integers(1, 18), st.floats(1.1, 1e6), st.booleans())
def test_a_single_odd_stamp_is_odd_and_then_forgiven(rate: float, at: int, off_s: float, is_back: bool) -> None:
    arrivals = at_rate(rate, 0.0)
    off_s += 1.0 / rate
    times = [t + (-off_s if is_back else off_s) * (n == at) for n, t in enumerate(arrivals)]
    said = told(times, arrivals)
    assert said == ["odd" if n == at else "usual" for n in range(len(times))]


@given(RATES, st.integers(1, 17), st.floats(1.1, 1e6), st.booleans(), st.floats(0.0, 0.15))
def test_the_third_of_a_clock_that_was_set_says_so_and_those_after_it_are_usual(
    rate: float, at: int, by_s: float, is_back: bool, jitter_s: float
) -> None:
    sent = at_rate(rate, 0.0)
    by_s += 4.0 / rate + jitter_s
    arrivals = in_fifo(sent, [jitter_s * (n % 2) for n in range(len(sent))])
    times = [t + (-by_s if is_back else by_s) * (n >= at) for n, t in enumerate(sent)]
    expected = ["usual"] * at + ["odd", "odd", "stepped"] + ["usual"] * (len(times) - at - 3)
    assert told(times, arrivals) == expected


def test_odd_stamps_that_disagree_or_go_back_make_no_step() -> None:
    arrivals = at_rate(10.0, 2.0)
    for odd in ([100.0, 200.0, 300.0], [-100.0, -100.7, -101.4], [-100.0, -100.1, -100.1], [-50.0, 50.0, -50.0]):
        times = list(arrivals)
        times[5:8] = [arrivals[5 + n] + each for n, each in enumerate(odd)]
        assert told(times, arrivals) == ["odd" if 5 <= n < 8 else "usual" for n in range(20)]


def test_steps_of_less_than_a_second_are_usual() -> None:
    arrivals = at_rate(20.0, 4.0)
    for by_s in (-0.9, 0.9):
        assert set(told([t + by_s * (t >= 2.0) for t in arrivals], arrivals)) == {"usual"}


@pytest.mark.parametrize("parts_per_million", [-200, -20, 20, 200])
def test_clocks_that_drift_apart_for_hours_are_usual(parts_per_million: int) -> None:
    arrivals = np.arange(0.0, 6 * 3600.0, 1.0)
    times = arrivals * (1 + parts_per_million * 1e-6)
    assert abs(times[-1] - arrivals[-1]) > 0.4
    rng = np.random.default_rng(1)
    assert set(told(times, arrivals + rng.uniform(0.0, 0.2, len(times)))) == {"usual"}


@given(RATES, st.integers(1, 19), st.floats(0.0, 4 * 3600.0), st.floats(-50e-6, 50e-6))
def test_a_stream_that_pauses_has_no_step(rate: float, at: int, pause_s: float, drift: float) -> None:
    arrivals = [t + pause_s * (n >= at) for n, t in enumerate(at_rate(rate, 0.0))]
    assert set(told([t * (1 + drift) for t in arrivals], arrivals)) == {"usual"}


def test_a_clock_that_was_set_while_a_stream_paused_is_noticed() -> None:
    arrivals = [t + 600.0 * (t >= 1.0) for t in at_rate(10.0, 2.0)]
    for by_s in (-700.0, 5.0):
        said = told([t + by_s * (t >= 600.0) for t in arrivals], arrivals)
        assert said == ["usual"] * 10 + ["odd", "odd", "stepped"] + ["usual"] * 7


def test_how_far_a_slow_clock_was_ahead_long_ago_is_forgotten() -> None:
    arrivals = at_rate(1.0, 3 * 3600.0)
    slow = [t * (1 - 300e-6) for t in arrivals]
    assert slow[-1] - arrivals[-1] < -3.0
    said = told([t + 2.0 * (n >= 10000) for n, t in enumerate(slow)], arrivals)
    assert [n for n, each in enumerate(said) if each != "usual"] == [10000, 10001, 10002]
    assert said[10002] == "stepped"
