"""Progress: how long the rest takes, what a log gets, and what a terminal of any width shows."""

import io
import re

import pytest
from rich.console import Console

from vapor.commands import progress as progress_module
from vapor.commands.progress import LOG_EVERY_S, Pace, Progress, duration, progress
from vapor.commands.train import _show_progress
from vapor.evaluation.validation import Validation
from vapor.training.progress import Progress as Where


class Clock:
    """Seconds that pass when told to."""

    now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


def in_a_log(name="localizing", unit="images"):
    clock = Clock()
    return Progress(name, unit, Console(file=io.StringIO()), clock), clock


def test_the_time_left_follows_from_what_was_done_in_the_later_half_of_the_time():
    clock = Clock()
    pace = Pace(clock)
    assert pace.left_s(60) is None
    for done in range(1, 51):  # results of an earlier call, found at once
        clock.now_s += 0.01
        pace.reach(done)
    for done in range(51, 53):
        clock.now_s += 60.0
        pace.reach(done)
    assert pace.left_s(60) == pytest.approx(8 * 60.0, rel=0.02)
    clock.now_s += 30.0
    assert pace.left_s(60) == pytest.approx(8 * 60.0 - 30.0, rel=0.02)
    clock.now_s += 10_000.0
    assert pace.left_s(60) == 0.0


def test_a_count_that_begins_again_is_another_task_with_a_pace_of_its_own():
    clock = Clock()
    pace = Pace(clock)
    for done in range(1, 90):  # such as finding features in key images
        clock.now_s += 1.0
        pace.reach(done)
    clock.now_s += 600.0  # and something between
    for done in range(1, 51):  # such as localizing images
        clock.now_s += 0.1
        pace.reach(done)
    assert pace.left_s(200) == pytest.approx(15.0, rel=0.01)


def test_a_time_left_that_is_known_is_said_instead_of_the_pace():
    told, clock = in_a_log("", "steps")
    for done in range(1, 4):
        clock.now_s += 1.0
        told.at("training", done, 361, left_s=30.0 - done)
    assert ", about 27 s left" in told.line()
    clock.now_s += 7.0
    assert ", about 20 s left" in told.line()
    told.at("landmarks", 1, 10)
    assert "left" not in told.line()


def test_loading_before_the_first_image_does_not_count():
    clock = Clock()
    pace = Pace(clock)
    clock.now_s += 10.0
    for done in range(1, 1201):
        assert pace.left_s(3000) == (None if done < 128 else pytest.approx((3001 - done) * 0.02, rel=0.1))
        clock.now_s += 0.02
        pace.reach(done)
    assert pace.left_s(3000) == pytest.approx(1800 * 0.02, rel=0.05)
    assert len(pace._points) < 250


def test_a_log_gets_a_line_every_ten_seconds_and_one_at_the_end(capsys):
    told, clock = in_a_log()
    for done in range(1, 301):
        clock.now_s += 0.125
        told(done, 300)
    told.end()
    out, err = capsys.readouterr()
    assert out == ""
    lines = err.splitlines()
    assert len(lines) == 300 * 0.125 // LOG_EVERY_S + 1
    assert lines[0] == "localizing: 80 of 300 images, 26 %, about 28 s left"
    assert lines[-1] == "localizing: 300 images in 38 s"
    assert not re.search(r"[^\n -~]", err)


def test_a_log_is_told_which_stage_begins_and_what_came_of_each(capsys):
    told, clock = in_a_log("walk", "")
    told.at("reading", 1, None, unit="images")
    clock.now_s += 2.0
    told.at("reading", 40, None)
    told.at("odometry", 0, None)
    told.note("too far apart")
    told.end()
    assert capsys.readouterr().err.splitlines() == [
        "walk, reading",
        "walk, reading: 40 images in 2 s",
        "walk, odometry",
        "too far apart",
    ]


def test_more_than_expected_is_all_and_nothing_done_is_not_told(capsys):
    told, _ = in_a_log()
    told(0, 0)
    assert told.line() == "localizing"
    told.end()
    told(7, 5)
    assert told.line().startswith("localizing: 7 of 7 images, 100 %")
    assert capsys.readouterr().err == ""


def test_after_an_error_a_log_has_no_last_line(capsys):
    def broken():
        with progress("localizing") as told:
            told(3, 10)
            raise ValueError("broken")

    with pytest.raises(ValueError, match="broken"):
        broken()
    assert capsys.readouterr().err == ""


def test_a_log_of_a_training_has_its_notes_figures_and_time_left(capsys):
    told, clock = in_a_log("", "images")
    _show_progress(told, Where("reading", 30))
    _show_progress(told, Where("holding out", 5, notes=("nothing is held out",)))
    best = Validation(epoch=2, train_loss=0.7, log_density=1.5, sample_recall=0.25, mode_recall=0.5)
    for done in range(1, 13):
        clock.now_s += 1.0
        _show_progress(told, Where("training", done, 40, epoch=3, epochs=10, loss=0.5, validation=best))
    lines = capsys.readouterr().err.splitlines()
    assert lines[:-1] == ["reading", "reading: 30 images in 0 s", "holding out", "nothing is held out", *lines[4:-1]]
    assert re.fullmatch(
        r"training: \d+ of 40 steps, \d+ %, about \d+ s left, epoch 3/10, loss 0.500,"
        r" held out at epoch 2: 25 % of samples, 50 % of best modes, log density 1.50",
        lines[-1],
    )


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def shown_at(monkeypatch, width, **environment):
    """What a terminal gets of three of ten images, and a note."""
    terminal = Terminal()
    for name in ("NO_COLOR", "FORCE_COLOR", "TTY_INTERACTIVE", "TTY_COMPATIBLE", "COLORTERM"):
        monkeypatch.delenv(name, raising=False)
    for name, value in {"TERM": "xterm-256color", "COLUMNS": str(width), **environment}.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr("sys.stderr", terminal)
    with progress("localizing in a place of a long name") as told:
        told(3, 10)
        told.note("a note")
    return terminal.getvalue()


@pytest.mark.parametrize("width", [40, 80, 120])
def test_a_terminal_shows_a_line_that_fits_it(width, monkeypatch):
    text = shown_at(monkeypatch, width)
    assert "\x1b[?25l" in text
    plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text)
    assert max(len(line.rstrip()) for line in re.split(r"[\r\n]+", plain)) <= width
    assert "3 of 10 images" in " ".join(plain.split())
    assert ("━" in plain) == (width >= 80)
    assert "localizing in a place of a long name: 3 images in 0 s" in " ".join(plain.split())
    assert "…" not in plain


def test_a_terminal_without_colours_gets_none(monkeypatch):
    assert re.search(r"\x1b\[[0-9;]*m", shown_at(monkeypatch, 80))
    assert not re.search(r"\x1b\[[0-9;]*m", shown_at(monkeypatch, 80, NO_COLOR="1"))


def test_a_terminal_that_cannot_move_its_cursor_gets_the_lines_of_a_log(monkeypatch):
    text = shown_at(monkeypatch, 80, TERM="dumb")
    assert text == "a note\nlocalizing in a place of a long name: 3 images in 0 s\n"


@pytest.mark.parametrize(
    ("seconds", "said"), [(0.2, "0 s"), (99.0, "99 s"), (100.0, "2 min"), (5900.0, "98 min"), (9000.0, "2.5 h")]
)
def test_times_are_said_in_the_unit_that_suits_them(seconds, said):
    assert duration(seconds) == said


def test_where_standard_error_is_closed_nothing_is_told_and_standard_output_stays_clean(monkeypatch, capsys):
    monkeypatch.setattr("sys.stderr", None)
    with progress_module.progress("localizing") as told:
        told(3, 3)
    assert capsys.readouterr().out == ""
