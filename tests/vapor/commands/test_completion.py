import shutil
import subprocess
from pathlib import Path

import pytest

from vapor.commands.completion import completion_script
from vapor.track import COMMANDS, main

ASK = """
COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1))
registered=$(complete -p vapor-track)
function=${registered##*-F }; ${function%% *} vapor-track "${COMP_WORDS[COMP_CWORD]}"
printf '%s\\n' "${COMPREPLY[@]}"
"""


@pytest.fixture(scope="module")
def script(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The script for bash."""
    file = tmp_path_factory.mktemp("completion") / "vapor-track.bash"
    file.write_text(completion_script("bash"), encoding="utf-8")
    return file


def completed(script: Path, *words: str) -> list[str]:
    """What bash would offer for the last of the words."""
    command = ["bash", "-c", f"source {script}{ASK}", "bash", "vapor-track", *words]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.split("\n")[:-1]


def test_commands_are_completed(script):
    assert {*COMMANDS} <= {*completed(script, "")}
    assert sorted(completed(script, "ca")) == ["calibrate"]


def test_options_are_completed_and_their_descriptions_are_not_taken_for_some(script):
    offered = completed(script, "run", "")
    assert "--localizer.late-window-s" in offered
    assert [word for word in offered if not word.startswith("-")] == []


def test_choices_of_an_option_are_completed(script):
    assert sorted(completed(script, "run", "--engine", "")) == ["auto", "openvino", "torch"]


def test_files_are_completed_where_nothing_else_fits(script):
    shown = subprocess.run(
        ["bash", "-c", f"source {script}; complete -p vapor-track"], capture_output=True, text=True, check=True
    )
    assert shown.stdout.startswith("complete -o default ")


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_the_printed_script_is_one_of_the_shell(shell, capfd):
    if shutil.which(shell) is None:
        pytest.skip(f"{shell} is not installed")
    assert main(["completion", shell]) == 0
    printed = capfd.readouterr().out
    assert "--localizer.late-window-s" in printed
    subprocess.run([shell, "-n"], input=printed, text=True, check=True)
