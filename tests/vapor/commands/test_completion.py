"""`vapor-track completion`: what shells offer for a word, asked in the shells themselves."""

import shutil
import subprocess
from pathlib import Path

import pytest

from sequences.scenes import SCENES
from vapor.checkpoints.file_format import shipped_models
from vapor.commands.completion import completion_script
from vapor.track import COMMANDS, main
from vapor.training.presets import METHODS, PRESETS

ASK = {
    "bash": """
        source "$0"; COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); _vapor_track
        printf '%s\\n' "${COMPREPLY[@]}"; ((${#COMPREPLY[@]})) || echo FILES  # by `complete -o default`
    """,
    # Without a terminal the builtins of completion refuse: these print what the real ones would be given.
    "zsh": """
        compdef() { :; }
        compset() { words[CURRENT]=${words[CURRENT]#$2}; }
        compadd() { local -a fit; fit=(${(M)${(P)2}:#${(b)words[CURRENT]}*}); print -rl -- $fit; (($#fit)) }
        _files() { print FILES; }
        source "$0"; words=("$@"); CURRENT=$#; _vapor-track
    """,
}


@pytest.fixture(scope="module", params=sorted(ASK))
def shell(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path]:
    """A shell, and its script in a file."""
    if shutil.which(request.param) is None:
        pytest.skip(f"{request.param} is not installed")
    file = tmp_path_factory.mktemp("completion") / "vapor-track"
    file.write_text(completion_script(request.param), encoding="utf-8")
    return request.param, file


def completed(shell: tuple[str, Path], *words: str) -> list[str]:
    """What a shell would offer for the last of the words: FILES stands for these."""
    name, script = shell
    command = [name, "-c", ASK[name], str(script), "vapor-track", *words]
    out = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    return sorted(filter(None, out.splitlines()))


def test_commands_are_completed(shell):
    assert completed(shell, "") == sorted([*COMMANDS, "--help", "--version"])
    assert completed(shell, "ca") == ["calibrate"]


def test_options_are_completed(shell):
    offered = completed(shell, "run", "")
    assert {"--localizer.late-window-s", "--no-undistort", "--help"} <= {*offered}
    assert [word for word in offered if not word.startswith("-")] == []
    assert completed(shell, "run", "walk.mcap", "--start") == ["--start-s"]


@pytest.mark.parametrize(
    ("words", "names"),
    [
        (["run", "--engine"], ["auto", "openvino", "torch"]),
        (["train", "walk.mcap", "--preset"], PRESETS),
        (["train", "--method"], METHODS),
        (["run", "walk.mcap", "--model"], shipped_models()),
        (["live", "--model"], shipped_models()),
        (["posterior", "--model"], shipped_models()),
        (["evaluate", "--time-offset-s"], ["auto"]),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else "",
)
def test_names_that_an_option_takes_are_completed(shell, words, names):
    assert completed(shell, *words, "") == sorted(names)


def test_names_are_completed_after_an_equals_sign(shell):
    def after(*words: str) -> list[str]:
        split = [part for word in words for part in word.replace("=", " = ").split(" ")]
        if split[-2:] == ["=", ""]:
            split.pop()
        return completed(shell, *(split if shell[0] == "bash" else words))  # bash splits words there

    assert after("run", "--model=st") == ["staircase"]
    assert after("run", "walk.mcap", "--model=") == sorted(shipped_models())
    assert after("run", "walk.mcap", "--odometry=v") == ["visual"]
    assert after("run", "walk.mcap", "--output=") == ["FILES"]
    assert after("run", "--model=st", "--eng") == ["--engine"]


@pytest.mark.parametrize(
    ("command", "names"),
    [
        ("demo", shipped_models()),
        ("synthesize", SCENES),
        ("completion", ["bash", "zsh"]),
        ("export", shipped_models()),
        ("calibrate", shipped_models()),
    ],
)
def test_names_that_an_argument_takes_are_completed(shell, command, names):
    assert [word for word in completed(shell, command, "") if not word.startswith("-")] == sorted(names)


@pytest.mark.parametrize(
    "words",
    [["run", "walk"], ["run", "--model", "place.s"], ["run", "--output", ""], ["run", "--output", "--"], ["x", ""]],
)
def test_files_are_offered_where_nothing_else_fits(shell, words):
    assert completed(shell, *words) == ["FILES"]
    assert "complete -o default" in completion_script("bash")


def test_words_with_marks_of_the_shell_are_taken_as_they_are(shell, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert completed(shell, "run", "*.mcap", "--engine", "t") == ["torch"]
    assert completed(shell, "run", "--model", "$(touch made)", "--eng") == ["--engine"]
    assert list(tmp_path.iterdir()) == []


def test_the_printed_script_is_one_of_the_shell(shell, capfd):
    name, _ = shell
    assert main(["completion", name]) == 0
    printed = capfd.readouterr().out
    assert printed == completion_script(name)
    subprocess.run([name, "-n"], input=printed, text=True, check=True)
