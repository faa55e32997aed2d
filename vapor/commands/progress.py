"""Progress and the time left: a bar at a terminal, a line now and then in a log."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import monotonic

from rich.console import Console
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from vapor.commands.terminal import color_system, write_error

LOG_EVERY_S = 10.0
"""Of lines in a log: least time between two."""
_BAR, _BAR_FROM = 24, 80  # width of the bar, and of terminals that have one
_SAMPLE_S = 0.1  # least time between two points of a pace
_AGAIN = 0.25  # of the time to the first point


class Pace:
    """Estimates the time left by the later half of the time so far, as results of an earlier call are found at once.

    The time to the first item, in which much is loaded, does not count; there is no estimate until a quarter of it has
    passed again, as workers finish their first items at about the same time.
    """

    def __init__(self, clock: Callable[[], float] = monotonic) -> None:
        self._clock, self.begin_s = clock, clock()
        self._points: deque[tuple[float, int]] = deque()  # time and number done, from half of the time on and one more

    def reach(self, done: int) -> None:
        """So many are done now; fewer than before are those of another task."""
        now_s, points = self._clock(), self._points
        if points and done < points[-1][1]:
            points.clear()
            self.begin_s = now_s
        if not done:
            return
        if len(points) > 2 and now_s - points[-2][0] < _SAMPLE_S:
            points.pop()
        points.append((now_s, done))
        while len(points) > 2 and points[1][0] <= (self.begin_s + now_s) / 2.0:
            points.popleft()

    def left_s(self, total: int) -> float | None:
        """Seconds until all are done; None where unknown."""
        if not self._points:
            return None
        (from_s, before), (reached_s, done) = self._points[0], self._points[-1]
        if done <= before or reached_s - from_s < _AGAIN * (from_s - self.begin_s):
            return None
        expected_s = (total - done) * (reached_s - from_s) / (done - before)
        return max(expected_s - (self._clock() - reached_s), 0.0)

    @property
    def seconds(self) -> float:
        """Since the beginning."""
        return self._clock() - self.begin_s


class Progress:
    """Progress of stages, one after the other; call it with the number done and of all."""

    def __init__(self, name: str, unit: str, console: Console, clock: Callable[[], float] = monotonic) -> None:
        """Begin a task that counts units (a plural in s), on the console of standard error; the clock gives seconds."""
        self._name, self._unit, self._console, self._clock = name, unit, console, clock
        self.at_terminal = console.is_interactive and console.file.isatty()
        self._stage, self._figures, self._done, self._total = name, "", 0, None
        self._left: tuple[float, float] | None = None  # seconds that are known to be left, and since when
        self._pace, self._logged_s = Pace(clock), clock()

    def __call__(self, done: int, total: int | None) -> None:
        """So many of all are done."""
        self._reach(done, None if total is None else max(done, total))

    def at(
        self,
        stage: str,
        done: int,
        total: int | None,
        *,
        unit: str | None = None,
        figures: str = "",
        left_s: float | None = None,
    ) -> None:
        """So many units of a stage are done, of a total that may be unknown; further figures stand behind.

        The time left is by the pace so far, unless it is given, seconds.
        """
        stage = f"{self._name}, {stage}" if self._name else stage
        if stage != self._stage:
            self.end()
            self._stage, self._done, self._pace = stage, 0, Pace(self._clock)
            self._log(stage)
        self._unit, self._figures = self._unit if unit is None else unit, figures
        self._left = None if left_s is None else (left_s, self._clock())
        self._reach(done, total)

    def note(self, text: str) -> None:
        """Print a line beside it."""
        if self.at_terminal:
            self._console.print(text)
        else:
            self._log(text)

    def end(self) -> None:
        """The stage is done."""
        if self._done:
            self._log(self.line(ended=True))

    def line(self, *, ended: bool = False) -> str:
        """The progress in a line."""
        if not self._done:
            return self._stage
        known = self._total is not None and not ended
        unit = self._unit.removesuffix("s") if self._done == 1 and not known else self._unit
        parts = [f"{self._stage}: {self._done}{f' of {self._total}' if known else ''} {unit}".rstrip()]
        if ended:
            parts[0] += f" in {duration(self._pace.seconds)}"
        elif self._total:
            parts.append(f"{100 * self._done // self._total} %")
            left_s = self._left_s(self._total)
            parts += [] if left_s is None else [f"about {duration(left_s)} left"]
        return ", ".join([*parts, *([self._figures] if self._figures else [])])

    def __rich__(self) -> Text | Table:
        """The bar and the line of a terminal."""
        text = Text(self.line())
        if self._console.width < _BAR_FROM:
            return text
        shown = Table.grid(padding=(0, 1))
        total = None if self._total is None else max(self._total, 1)
        shown.add_row(ProgressBar(total, self._done, width=_BAR, pulse=total is None), text)
        return shown

    def _left_s(self, total: int) -> float | None:
        if self._left is None:
            return self._pace.left_s(total)
        left_s, since_s = self._left
        return max(left_s - (self._clock() - since_s), 0.0)

    def _reach(self, done: int, total: int | None) -> None:
        self._done, self._total = done, total
        self._pace.reach(done)
        if self._clock() - self._logged_s >= LOG_EVERY_S:
            self._log(self.line())

    def _log(self, text: str) -> None:
        if not self.at_terminal:
            self._logged_s = self._clock()
            write_error(text)


@contextmanager
def progress(name: str = "", unit: str = "images") -> Iterator[Progress]:
    """Show the progress of a task, which may be named by its stages only, in units (a plural in s) on standard error.

    At a terminal it is a line that changes, and goes after an error. In a log file it is a line every ten seconds and
    at the end.
    """
    console = Console(stderr=True, highlight=False, markup=False, color_system=color_system())
    shown = Progress(name, unit, console)
    if not shown.at_terminal:
        yield shown
        shown.end()
        return
    with Live(shown, console=console, refresh_per_second=8) as live:
        try:
            yield shown
            live.update(Text(shown.line(ended=True)))
        except BaseException:
            live.transient = True
            raise


def duration(seconds: float) -> str:
    """A time in seconds, minutes or hours."""
    if seconds < 99.5:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 99.5 * 60 else f"{seconds / 3600:.1f} h"
