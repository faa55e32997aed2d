"""What the command prints and how it ends, whatever its output is and whatever signal comes."""

import contextlib
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
from rich.cells import cell_len

from filtering.errors import MAX_MESSAGE, VaporTrackError, shortened
from tests.helpers.checkout import CHECKOUT
from tests.helpers.command_line import main
from tests.helpers.full import some
from tests.helpers.simulated_run import simulated_record
from vapor.commands import console
from vapor.commands.terminal import Signals, write_error
from vapor.reporting.outcome import Outcome, format_batch
from vapor.reporting.report import build_report, format_table

COMMAND = [sys.executable, "-c", "from vapor.track import main; raise SystemExit(main())"]
SLEEPING = """
import sys, time, vapor.commands
from types import ModuleType
def work(_):
    try:
        print("working", flush=True)
        while True:
            time.sleep(0.01)
    finally:
        print("undone", flush=True)
sys.modules["vapor.commands.evaluate"] = command = ModuleType("evaluate")
command.main = work
sys.argv[1:] = ["evaluate"]
from vapor.track import main
raise SystemExit(main())
"""


def started(words, **options):
    """A process that takes signals as one at a terminal does, also where tests run in the background or by nohup."""

    def foreground():
        for number in (signal.SIGINT, signal.SIGHUP):
            signal.signal(number, signal.SIG_DFL)

    environment = {**os.environ, "PYTHONPATH": str(CHECKOUT)}
    environment.update(options.pop("env", {}))
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "encoding": "latin-1"}
    return subprocess.Popen(words, env=environment, preexec_fn=foreground, **{**pipes, **options})


# --- signals -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_signal_undoes_what_the_command_began_and_ends_it_with_a_line_and_128_plus_its_number(name):
    number = getattr(signal, name)
    process = started([sys.executable, "-c", SLEEPING])
    assert process.stdout.readline() == "working\n"
    process.send_signal(number)
    process.send_signal(number)  # what a terminal that closes does
    out, err = process.communicate(timeout=20)
    # The second may come when Python has ended: a shell says 128 + n.
    assert process.returncode in (128 + number, -number)
    assert out == "undone\n"
    by = "" if name == "SIGINT" else f" by {name}"
    assert err == f"vapor-track evaluate: interrupted{by}\n"


SIGNALLED = """
import os, sys
class Signalled:
    def find_spec(self, name, *_):
        if name == "vapor.commands.terminal":
            os.kill(os.getpid(), int(sys.argv.pop()))
sys.meta_path.insert(0, Signalled())
from vapor.track import main
raise SystemExit(main())
"""


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_signal_before_the_handlers_are_there_ends_the_command_at_once_without_a_traceback(name):
    number = getattr(signal, name)
    process = started([sys.executable, "-c", SIGNALLED, "evaluate", "nowhere", str(int(number))])
    out, err = process.communicate(timeout=20)
    assert (process.returncode, out, err) == (-number, "", "")


def test_nothing_is_imported_before_the_command_takes_the_signals():
    imported = "import sys; before = {*sys.modules}; import vapor.track; print(*sorted({*sys.modules} - before))"
    out, err = started([sys.executable, "-c", imported]).communicate(timeout=20)
    assert (out.split(), err) == (["__future__", "vapor", "vapor.track"], "")


def test_a_signal_while_the_command_is_imported_leaves_no_traceback():
    process = started([*COMMAND, "run", "absent.mcap", "--model", "staircase", "--output", "nowhere"])
    # From then on the handlers are there: the imports of the command itself begin.
    mapped = Path(f"/proc/{process.pid}/status")
    until = time.monotonic() + 20
    while not int(mapped.read_text().split("SigCgt:")[1].split()[0], 16) & 1 << signal.SIGTERM - 1:
        assert time.monotonic() < until
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=20)
    assert (process.returncode, err) == (130, "vapor-track run: interrupted\n")


def test_a_signal_that_is_ignored_as_by_nohup_stays_so():
    process = started(["nohup", sys.executable, "-c", SLEEPING])
    assert process.stdout.readline() == "working\n"
    process.send_signal(signal.SIGHUP)
    time.sleep(0.2)
    assert process.poll() is None
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=20)
    assert process.returncode == 128 + signal.SIGTERM


def test_a_signal_that_came_while_a_destructor_ran_ends_the_command_all_the_same():
    lost = """
class Lost:
    def __del__(self):
        import os, signal
        os.kill(os.getpid(), signal.SIGTERM)
        for _ in range(1000):
            pass
"""
    swallowed = lost + SLEEPING.replace('print("working", flush=True)', 'it = Lost(); del it; print("on", flush=True)')
    out, err = started([sys.executable, "-c", swallowed]).communicate(timeout=20)
    assert err == "vapor-track evaluate: interrupted by SIGTERM\n"
    assert out.endswith("undone\n")


def test_signals_within_a_python_program_stay_its_own(capsys):
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)]
    assert main(["--help"]) == 0
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)] == before
    assert Signals("x").report() == 130
    assert capsys.readouterr().err == "x: interrupted\n"


WORKERS = """
import time
from vapor.parallel import in_parallel
try:
    list(in_parallel(time.sleep, [(30,)] * 4, 2))
except KeyboardInterrupt:
    raise SystemExit(130) from None
"""


@pytest.mark.parametrize("delay", [0.0, 0.3])
def test_ctrl_c_at_a_terminal_is_answered_by_one_process_also_while_workers_start(delay):
    process = started([sys.executable, "-c", WORKERS], start_new_session=True)
    until = time.monotonic() + 20
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    while len(children.read_text().split()) < 3:  # two trackers of resources, and the first worker
        assert time.monotonic() < until
        time.sleep(0.01)
    time.sleep(delay)
    workers = children.read_text().split()
    os.killpg(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=20)
    assert (process.returncode, err) == (130, "")
    time.sleep(0.2)
    assert not [pid for pid in workers if Path(f"/proc/{pid}/exe").exists()]


# --- outputs -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "unbuffered"), [(["--help"], ""), (["evaluate", "--help"], ""), (["evaluate", "{run}"], "1")]
)
def test_a_full_device_is_told_in_one_line(words, unbuffered, tmp_path):
    for name in ("trajectory.tum", "ground_truth.tum"):
        (tmp_path / name).write_text("".join(f"{i}.0 {i} 0 0 0 0 0 1\n" for i in range(5)))
    words = [word.format(run=tmp_path) for word in words]
    with Path("/dev/full").open("w") as full:
        process = started([*COMMAND, *words], stdout=full, env={"PYTHONUNBUFFERED": unbuffered})
        _, err = process.communicate(timeout=60)
    prefix = "vapor-track" if words == ["--help"] else "vapor-track evaluate"
    assert (process.returncode, err) == (1, f"{prefix}: standard output: No space left on device\n")


def test_an_error_keeps_its_status_where_it_cannot_be_told():
    with Path("/dev/full").open("w") as full:
        process = started([*COMMAND, "nonsense"], stderr=full)
        process.communicate(timeout=20)
    assert process.returncode == 2


@pytest.mark.parametrize("encoding", some(1, ["ascii", "latin-1"]))
def test_help_tables_and_errors_are_printed_on_terminals_of_any_encoding(encoding, tmp_path):
    process = started([*COMMAND, "train", "--help"], env={"PYTHONIOENCODING": encoding})
    out, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (0, "")
    assert "?" in out
    (tmp_path / "trajectory.tum").write_text("".join(f"{i}.0 {i} 0 0 0 0 0 1\n" for i in range(5)))
    words = ["evaluate", ".", "--ground-truth", "trajectory.tum"]
    process = started([*COMMAND, *words], env={"PYTHONIOENCODING": encoding}, cwd=tmp_path)
    out, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    assert "particle filter" in out
    process = started([*COMMAND, "αβγ"], env={"PYTHONIOENCODING": encoding})
    _, err = process.communicate(timeout=20)
    assert process.returncode == 2
    assert "unknown command '???'" in err


# --- messages and tables -------------------------------------------------------------------------------


LONG_MESSAGE = 300  # beyond it long words lose some


def test_messages_are_shortened_where_their_words_are_longest_and_else_stay_whole(capsys):
    path, token = "/data/walk.mcap", "x" * 100_000
    found = shortened(f"{path}: topic is {token!r}, expected the name of a topic")
    assert len(found) == LONG_MESSAGE
    assert found.startswith(f"{path}: topic is 'xxx")
    assert found.endswith("xxx', expected the name of a topic")
    assert len(shortened("word " * 1000)) == MAX_MESSAGE
    assert len(shortened(" ".join([token] * 20))) == MAX_MESSAGE
    fits = ("reason " * MAX_MESSAGE)[:MAX_MESSAGE]
    assert shortened(fits) == fits
    write_error(f"two\nlines {token}")
    err = capsys.readouterr().err
    assert (err.count("\n"), len(err)) == (1, LONG_MESSAGE + 1)


def test_commands_stay_whole_while_the_words_around_them_are_shortened():
    path, command = "/data/" + "x" * 200, "vapor-track map /data/" + "x" * 200 + " --output place/"
    said = str(VaporTrackError(f"{path}: no poses (`{command}` makes them); {'y' * 100}"))
    assert f"(`{command}` makes them)" in said
    assert not said.startswith("/data")
    assert "y" * 100 not in said


LONG = "9" * 3000


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([LONG], "unknown command '999"),
        (["evaluate", LONG], "File name too long"),
        (["evaluate", "a", f"--{LONG}"], "unknown option --999"),
        (["synthesize", "ceiling", "s.mcap", "--seed", f"{LONG}x"], "--seed is '999"),
    ],
)
def test_no_message_is_longer_than_1000_characters(words, said, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    with contextlib.suppress(SystemExit):
        assert main(words) in (1, 2)
    err = capsys.readouterr().err
    assert said in err
    assert err.count("\n") == 1
    assert len(err) <= MAX_MESSAGE + 1


def test_notices_and_reasons_that_quote_a_file_are_one_short_line_each(capsys):
    console.show_notices([f"topic /{LONG}\nis not read", "a word"])
    console.show_skipped({f"odometry from {LONG}": 3})
    lines = capsys.readouterr().out.splitlines()
    assert [line[:12] for line in lines] == ["  topic /999", "  a word", "  skipped 3:"]
    assert max(map(len, lines)) == LONG_MESSAGE


def test_wrong_arguments_are_told_in_a_line_without_the_help_of_what_is_there(capsys):
    with pytest.raises(SystemExit) as end:
        main(["synthesize", "ceiling", "s.mcap", "--sead", "1"])
    assert end.value.code == 2
    err = capsys.readouterr().err
    assert err.startswith("vapor-track synthesize: unknown option --sead, did you mean --seed?")
    assert not set("│╭─") & set(err)


def shown(table, width, capsys, monkeypatch, **environment):
    for name in ("NO_COLOR", "FORCE_COLOR"):
        monkeypatch.delenv(name, raising=False)
    for name, value in {"COLUMNS": str(width), **environment}.items():
        monkeypatch.setenv(name, value)
    console.show(table)
    return capsys.readouterr().out


@pytest.fixture(scope="module")
def report():
    found = build_report(simulated_record(30))
    for method in ("single_image", "dead_reckoning", "filter"):
        found[method] |= {"median_translation_m": 12.345, "median_rotation_deg": 123.4}
    return found


OUTCOME = Outcome(
    "walk-in-a-building",
    "walk.mcap",
    images=10_000,
    duration_s=1234.5,
    status={"converged": 0.987},
    final_status="converged",
    images_with_true_pose=10_000,
    median_translation_m=12.34,
    median_rotation_deg=123.4,
    success=True,
)


@pytest.mark.parametrize("width", [30, 40, 80])
def test_tables_have_every_word_and_fit_80_columns(width, report, capsys, monkeypatch):
    for table in (
        format_table(report, title="a-walk-of-a-long-name.mcap"),
        format_table(report, large_errors=True),
        format_batch([OUTCOME]),
    ):
        out = shown(table, width, capsys, monkeypatch)
        if width == 80:
            assert max(map(cell_len, out.splitlines())) <= width
        assert not {"…", "\x1b"} & set(out)
        words = re.split(r"[\s│┃]+", out)
        for column in table.columns[1:]:
            assert set(" ".join(map(str, column.cells)).split()) <= set(words)


def test_names_of_files_are_never_cut_within_a_word(report, capsys, monkeypatch):
    name = "drive-20261130/recorded_in_the_long_corridor/second-floor_back.mcap"
    out = shown(format_table(report, title=f"/data/results/{name}"), 80, capsys, monkeypatch)
    assert out.splitlines()[0] == f"/data/results/{name}"
    out = shown(format_batch([OUTCOME, replace(OUTCOME, name=name)]), 80, capsys, monkeypatch)
    assert max(map(cell_len, out.splitlines())) <= 80
    cells = names_in(out)
    assert "".join(cells) == OUTCOME.name + name
    assert all(cell[-1] in "-/_" or cell in (OUTCOME.name, "back.mcap") for cell in cells)


def test_names_of_recordings_have_room_in_their_column(capsys, monkeypatch):
    long = replace(OUTCOME, name="rgbd_dataset_freiburg1_xyz@0:60", final_status="ambiguous")
    out = shown(format_batch([OUTCOME, long]), 80, capsys, monkeypatch)
    assert names_in(out) == [OUTCOME.name, "rgbd_dataset_", "freiburg1_xyz@0:60"]


def names_in(table: str) -> list[str]:
    cells = [line.split("│")[1].strip() for line in table.splitlines() if line.startswith("│")]
    return [cell for cell in cells if cell]


@pytest.mark.parametrize(
    ("environment", "coloured"),
    [
        ({"FORCE_COLOR": "1"}, True),
        ({"FORCE_COLOR": "1", "NO_COLOR": "1"}, False),
        ({"FORCE_COLOR": "1", "TERM": "dumb"}, False),
        ({}, False),
    ],
)
def test_colours_and_bold_are_off_where_they_are_not_wanted_or_there_is_no_terminal(
    environment, coloured, report, capsys, monkeypatch
):
    environment = {"TERM": "xterm-256color", **environment}
    assert ("\x1b" in shown(format_table(report), 80, capsys, monkeypatch, **environment)) == coloured


def test_lines_are_wrapped_between_words_at_a_terminal_only_and_paths_stay_whole(capsys, monkeypatch):
    path = "/data/" + "x" * 60
    text = f"pictures   one.png, two.png, three.png, {path}"
    assert shown(text, 40, capsys, monkeypatch) == f"{text}\n"
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)
    assert shown(text, 40, capsys, monkeypatch).splitlines() == [
        "pictures   one.png, two.png, three.png,",
        f"           {path}",
    ]


@pytest.mark.parametrize("width", [40, 80])
@pytest.mark.parametrize("words", [[], ["evaluate"], ["run"], ["vapor-benchmark"]])
def test_help_fits_80_columns_and_40(words, width, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", str(width))
    with contextlib.suppress(SystemExit):
        main([*words, "--help"])
    out = capsys.readouterr().out
    assert len(out) > 200
    assert max(map(cell_len, out.splitlines())) <= width
