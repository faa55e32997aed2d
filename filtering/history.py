"""Observations with times: one that comes late is fused at its own time, and the later ones are repeated after it.

The belief before each recent observation is kept. A step is a pure function, so the result is the one that the
observations give in the order of their times.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, replace

from filtering.belief import Belief
from filtering.config import LocalizerConfig
from filtering.errors import VaporTrackError
from filtering.estimate import Estimate
from filtering.motion import require_odometry
from filtering.observation import Observation
from filtering.step import step

_DURATION_AGREES, _DURATION_AGREES_S = 0.1, 1e-3  # of a late increment with the stamps: relative, or in seconds


@dataclass(frozen=True)
class Moment:
    """An observation and the belief before it.

    Attributes:
        begin_ns: Time of the observation before it, from which its odometry and elapsed time count; None for the first.
        before: The belief that it was fused into.
        observation: What was observed, with its time.
    """

    begin_ns: int | None
    before: Belief
    observation: Observation

    @property
    def time_ns(self) -> int:
        """Time of the observation, integer nanoseconds."""
        return _time_of(self.observation)


@dataclass(frozen=True)
class History:
    """The latest observations of a belief, in the order of their times.

    Attributes:
        timed: Whether the steps have times; None before the first one.
        latest_ns: Time of the belief; None where the steps have none.
        moments: Those that a late observation may precede: of the last `LocalizerConfig.late_window_s` seconds, and at
            least the latest.
    """

    timed: bool | None = None
    latest_ns: int | None = None
    moments: tuple[Moment, ...] = ()

    @staticmethod
    def beginning_at(time_ns: int | None) -> History:
        """The history of a belief that is stated, at a time or at an unknown one."""
        return History(None if time_ns is None else True, time_ns)

    def earliest_ns(self, late_window_s: float) -> int | None:
        """Earliest time that an observation may have; None for any."""
        if self.latest_ns is None:
            return None
        window_ns = self.latest_ns - round(late_window_s * 1e9)
        if not self.moments:
            return self.latest_ns
        first = self.moments[0]
        return max(window_ns, first.time_ns if first.begin_ns is None else first.begin_ns)


def fuse(
    history: History, belief: Belief, observation: Observation, config: LocalizerConfig
) -> tuple[History, Belief, Estimate]:
    """Fuse an observation at its own time; the belief and its estimate are those of the latest time.

    Views of a time that was observed before join that moment, whose odometry stays. The odometry of a late observation
    leads from the one before it in time. Without it, the known motion is split as one of constant twist.

    Raises:
        VaporTrackError: the time is earlier than the window, steps with and without times are mixed, a late increment
            does not last as long as the times say, or as `step` and `Observation`.
    """
    if observation.time_ns is None:
        if history.timed:
            raise VaporTrackError(f"a step without time_ns after one at {history.latest_ns} ns, {_ALL_OR_NONE}")
        return History(timed=False), *step(belief, observation, config)
    time_ns = observation.time_ns
    if history.timed is False:
        raise VaporTrackError(f"a step at time_ns {time_ns} after steps without a time, {_ALL_OR_NONE}")
    earliest_ns = history.earliest_ns(config.late_window_s)
    if earliest_ns is not None and time_ns < earliest_ns:
        raise VaporTrackError(_too_late(history, time_ns, earliest_ns, config))
    at = bisect_left(history.moments, time_ns, key=lambda moment: moment.time_ns)
    later = history.moments[at:]
    begin_ns, belief = (later[0].begin_ns, later[0].before) if later else (history.latest_ns, belief)
    moments, estimate = list(history.moments[:at]), None
    for each in _in_order(begin_ns, observation, [moment.observation for moment in later]):
        moments.append(Moment(begin_ns, belief, each))
        belief, estimate = step(belief, each, config)
        begin_ns = each.time_ns
    assert begin_ns is not None
    assert estimate is not None
    oldest_ns = begin_ns - round(config.late_window_s * 1e9)
    recent = tuple(moment for moment in moments if moment.time_ns >= oldest_ns)
    return History(timed=True, latest_ns=begin_ns, moments=recent), belief, estimate


_ALL_OR_NONE = "expected a time in all steps or in none, until `forget`"


def _too_late(history: History, time_ns: int, earliest_ns: int, config: LocalizerConfig) -> str:
    assert history.latest_ns is not None
    late_s = (history.latest_ns - time_ns) * 1e-9
    what = f"observation at {time_ns} ns is {late_s:.3f} s older than the latest, at {history.latest_ns} ns"
    if late_s <= config.late_window_s:
        return f"{what}, expected none before the first one, at {earliest_ns} ns"
    return f"{what}, expected at most {config.late_window_s:g} s (late_window_s)"


def _in_order(begin_ns: int | None, new: Observation, later: Sequence[Observation]) -> list[Observation]:
    """A new observation and those that are not earlier; the motion since `begin_ns` is that of the first of these."""
    if not later:
        return [new if begin_ns is None else _lasting(new, begin_ns)]
    first, *others = later
    if first.time_ns == new.time_ns:
        both = replace(first, views=(*first.views, *new.views), vertical=first.vertical or new.vertical)
        return [both, *others]
    assert begin_ns is not None
    new, known = _lasting(new, begin_ns), first.odometry
    if new.odometry is not None:
        _require_duration_of(new, begin_ns)
        part = new.odometry
    else:
        part = None if known is None else known.part(new.elapsed_s / first.elapsed_s)
    rest = None if known is None or part is None else known.after(part)
    return [replace(new, odometry=part), replace(_lasting(first, _time_of(new)), odometry=rest), *others]


def _lasting(observation: Observation, begin_ns: int) -> Observation:
    return replace(observation, elapsed_s=(_time_of(observation) - begin_ns) * 1e-9)


def _time_of(observation: Observation) -> int:
    assert observation.time_ns is not None
    return observation.time_ns


def _require_duration_of(late: Observation, begin_ns: int) -> None:
    assert late.odometry is not None
    require_odometry(late.odometry)
    duration_s, elapsed_s = late.odometry.duration_s, late.elapsed_s
    if abs(duration_s - elapsed_s) > max(_DURATION_AGREES * elapsed_s, _DURATION_AGREES_S):
        raise VaporTrackError(
            f"odometry of the late observation at {late.time_ns} ns took {duration_s:g} s, expected the motion since"
            f" the observation before it in time, at {begin_ns} ns: {elapsed_s:g} s; or None"
        )
