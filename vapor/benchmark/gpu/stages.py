"""Stages of a measurement that share a time: one that fails or does not fit is reported, and the others go on."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from time import monotonic
from typing import Literal

Outcome = Literal["under way", "done", "out of time", "failed"]


@dataclass(frozen=True)
class Finding:
    """One figure.

    Attributes:
        what: What is measured.
        value: The figure; of a time, the median.
        unit: Its unit.
        p95: Of a time, the 95th percentile.
        most: The greatest value that passes; None where nothing is asked of the figure.
        note: How it was measured.
    """

    what: str
    value: float
    unit: str
    p95: float | None = None
    most: float | None = None
    note: str = ""

    @property
    def passes(self) -> bool | None:
        """Whether the value is as asked, which NaN never is; None where nothing is asked."""
        return None if self.most is None else self.value <= self.most


class OutOfTime(Exception):
    """The time of a stage is over, or too short for what comes next, which the message then says."""


class Deadline:
    """The time at which a stage has to end, by a clock in seconds."""

    def __init__(self, seconds: float, clock: Callable[[], float] = monotonic) -> None:
        self._clock, self._end_s = clock, clock() + seconds

    @property
    def left_s(self) -> float:
        """Seconds left; negative once it is over."""
        return self._end_s - self._clock()

    def check(self, *_: object) -> None:
        """Raise `OutOfTime` once it is over; takes anything, so that it can be a callback of progress."""
        if self.left_s <= 0.0:
            raise OutOfTime

    def before(self, reserved_s: float) -> Deadline:
        """One that leaves so many seconds of this one."""
        return Deadline(self.left_s - reserved_s, self._clock)


Work = Callable[[Deadline], Iterator[Finding]]


@dataclass(frozen=True)
class Stage:
    """A part of the measurement; `share` is its part of the time, which later stages keep for themselves."""

    name: str
    share: float
    work: Work


@dataclass
class Result:
    """What a stage found, how it ended and why, and how long it took."""

    stage: str
    outcome: Outcome = "under way"
    reason: str = ""
    seconds: float = 0.0
    findings: list[Finding] = field(default_factory=list)


def carry_out(
    stages: Sequence[Stage], whole: Deadline, report: Callable[[Sequence[Result]], None] = lambda _: None
) -> list[Result]:
    """Carry out stages one after the other; what one leaves of its time is for the later ones.

    Args:
        stages: With their shares of the time.
        whole: The end of all of them.
        report: Called with all results so far after every figure, and when a stage begins and ends.
    """
    results: list[Result] = []
    total, seconds = sum(stage.share for stage in stages), whole.left_s
    for number, stage in enumerate(stages):
        later = sum(each.share for each in stages[number + 1 :])
        deadline = whole.before(seconds * later / total)
        begin_s = deadline.left_s
        results.append(result := Result(stage.name))
        report(results)
        try:
            deadline.check()
            for finding in stage.work(deadline):
                result.findings.append(finding)
                report(results)
            result.outcome = "done"
        except OutOfTime as error:
            over = f"its {max(begin_s, 0.0):.0f} s were over after {len(result.findings)} figures"
            result.outcome, result.reason = "out of time", str(error) or over
        except Exception as error:  # whatever fails costs its stage, and not the figures of the others
            result.outcome = "failed"
            result.reason = f"{type(error).__name__}: {(str(error).strip() or 'no message').splitlines()[0]}"
        result.seconds = begin_s - deadline.left_s
        report(results)
    return results
