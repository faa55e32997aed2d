"""Arguments: wrong ones are refused with status 2, and every command explains its own."""

import re
import subprocess
import sys

import pytest

from tests.helpers.command_line import EVERY_COMMAND, main
from vapor.benchmark import PROGRAM
from vapor.benchmark.__main__ import COMMANDS as BENCHMARKS
from vapor.track import COMMANDS
from vapor.training.presets import PRESETS


def status_of(words: list[str]) -> object:
    """Status of the process that these words would end, however that comes about."""
    try:
        return main(words)
    except SystemExit as end:
        return end.code


WRONG = {
    "no command": ([], ""),
    "unknown command": (["localise"], "unknown command 'localise', expected one of run, live"),
    "unknown option": (["run", "a.mcap", "--model", "m", "--output", "o", "--nonsense", "1"], "nonsense"),
    "misspelt option": (
        ["run", "a.mcap", "--model", "m", "--output", "o", "--localizer.max-hypthoses", "9"],
        "hypthoses",
    ),
    "missing model": (["run", "a.mcap", "--output", "o"], "--model"),
    "missing sequence": (["run", "--model", "m", "--output", "o"], "MCAP file or rosbag2"),
    "value that is no number": (["run", "a.mcap", "--model", "m", "--output", "o", "--seed", "one"], "one"),
    "no hypotheses": (
        ["run", "a.mcap", "--model", "m", "--output", "o", "--localizer.max-hypotheses", "0"],
        "max_hypotheses is 0",
    ),
    "no samples": (["run", "a.mcap", "--model", "m", "--output", "o", "--num-samples", "0"], "num_samples is 0"),
    "negative seed": (["run", "a.mcap", "--model", "m", "--output", "o", "--seed", "-1"], "seed is -1"),
    "no threads": (["run", "a.mcap", "--model", "m", "--output", "o", "--threads", "0"], "threads is 0"),
    "setting out of range": (
        ["run", "a.mcap", "--model", "m", "--output", "o", "--localizer.modes.max-modes", "0"],
        "max_modes is 0, expected between 1",
    ),
    "setting of NaN": (["run", "a.mcap", "--model", "m", "--output", "o", "--duration-s", "nan"], "duration_s is nan"),
    "no odometry topic": (
        ["run", "a.mcap", "--model", "m", "--output", "o", "--odometry-topic", ""],
        "odometry_topic is '', expected the name of a topic",
    ),
    "no image topic": (["run", "a.mcap", "--model", "m", "--output", "o", "--image-topic", ""], "image_topic is ''"),
    "extrinsics without a rotation": (
        ["run", "a.mcap", "--model", "m", "--output", "o", "--base-from-camera", *"1230000"],
        "--base-from-camera: ",
    ),
    "unknown scene": (["synthesize", "attic", "s.mcap"], "attic"),
    "building without a number": (["synthesize", "building", "s.mcap"], "such as building-7"),
    "benchmark of an unknown scene": (
        ["vapor-benchmark", "localization", "building-x", "--output", "o"],
        "unknown scene 'building-x', expected one of staircase, ceiling, corridor, building-N",
    ),
    "benchmark of a table": (
        ["vapor-benchmark", "localization", "round-table", "--output", "o"],
        "unknown scene 'round-table'",
    ),
    "unknown cues": (["synthesize", "ceiling", "s.mcap", "--cues", "some"], "some"),
    "no such rate": (["synthesize", "staircase", "s.mcap", "--rate", "0"], "0 images a second"),
    "no frames": (["synthesize", "staircase", "s.mcap", "--frames", "0"], "0 frames"),
    "negative seed of a scene": (["synthesize", "staircase", "s.mcap", "--seed", "-1"], "seed -1"),
    "engine twice": (
        ["vapor-benchmark", "step", "--engines", "torch", "torch"],
        "engines are torch, torch, expected each once",
    ),
    "random weights on a walk": (
        ["vapor-benchmark", "step", "--sequence", "a.mcap", "--preset", "demo"],
        "expected one of them",
    ),
    "demo of no frames": (["demo", "--frames", "0"], "0 frames"),
    "unknown preset": (["train", "a.mcap", "--output", "m.safetensors", "--preset", "fast"], "expected one of auto"),
    "preset without name": (["train", "a.mcap", "--output", "m.safetensors", "--preset"], "preset"),
    "no training data": (["train", "--output", "m.safetensors"], "no training data"),
    "no model to write": (["train", "a.mcap"], "--output"),
    "no epochs": (["train", "a.mcap", "--output", "m.safetensors", "--epochs", "0"], "epochs is 0"),
    "both odometries": (["convert", "d", "o.mcap", "--odometry", "a.tum", "--odometry-noise"], "exclude each other"),
    "noise of no odometry": (["convert", "d", "o.mcap", "--noise.scale", "0.1"], "expected --odometry-noise with them"),
    "malformed frames": (["convert", "d", "o.mcap", "--frames", "1-9"], "expected START:STOP"),
    "no directory": (["evaluate"], "What `vapor-track run` wrote"),
    "no workers": (["vapor-benchmark", "localization", "ceiling", "--output", "o", "--workers", "0"], "workers is 0"),
    "no runs": (["vapor-benchmark", "localization", "ceiling", "--output", "o", "--runs", "-1"], "runs is -1"),
    "no frames of a benchmark": (
        ["vapor-benchmark", "localization", "ceiling", "--output", "o", "--frames", "49"],
        "frames is 49, expected at least 50",
    ),
    "no scene": (["vapor-benchmark", "localization", "--output", "o"], "expected each at most once, and one"),
    "a scene twice": (
        ["vapor-benchmark", "localization", *["ceiling"] * 2, "--output", "o"],
        "scenes are ceiling, ceiling",
    ),
    "unknown ablation": (
        ["vapor-benchmark", "localization", "ceiling", "--output", "o", "--ablations", "best"],
        "unknown ablation 'best', expected one of full,",
    ),
    "no kinds": (["vapor-benchmark", "localization", "ceiling", "--output", "o", "--kinds"], "kinds are none"),
    "more models than scenes": (
        ["vapor-benchmark", "localization", "ceiling", "--output", "o", "--models", "a", "b"],
        "2 models for 1 scenes, expected one for each",
    ),
    "no repetitions": (["vapor-benchmark", "step", "--repetitions", "0"], "repetitions is 0"),
    "a filter of no hypotheses": (["vapor-benchmark", "step", "--hypotheses", "10", "0"], "hypotheses are (10, 0)"),
    "a network of no preset": (
        ["vapor-benchmark", "step", "--preset", "fast"],
        "unknown preset 'fast', expected one of auto",
    ),
    "unknown benchmark": (
        ["vapor-benchmark", "everything"],
        "'everything', expected one of step, localization",
    ),
    "no benchmark": (["vapor-benchmark"], ""),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_arguments_end_with_2_and_say_what_is_wrong(case, tmp_path, monkeypatch, capsys):
    words, said = WRONG[case]
    monkeypatch.chdir(tmp_path)
    assert status_of(words) == 2
    out, err = capsys.readouterr()
    assert said in err
    assert "Traceback" not in out + err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("program", "words", "commands"), [("vapor-track", [], COMMANDS), (PROGRAM, [PROGRAM], BENCHMARKS)]
)
def test_the_overview_lists_every_command(program, words, commands, capsys):
    assert main([*words, "--help"]) == 0
    out = capsys.readouterr().out
    assert f"usage: {program} COMMAND" in out
    assert re.findall(r"^  ([a-z-]+)  ", out, re.MULTILINE) == [*commands]
    assert main([*words, "--version"]) == 0
    assert capsys.readouterr().out.startswith(f"{program} 0.")


@pytest.mark.parametrize("words", EVERY_COMMAND, ids=" ".join)
def test_every_command_explains_its_options(words, capsys):
    assert status_of([*words, "--help"]) == 0
    out, err = capsys.readouterr()
    assert f"usage: {' '.join(words if words[0] == PROGRAM else ['vapor-track', *words])}" in out
    assert err == ""


@pytest.mark.parametrize("code", ["import vapor.track as t; t.main(['--help'])", "import vapor; dir(vapor), vapor.run"])
def test_a_user_of_the_library_never_loads_what_measures_it(code):
    loaded = f"{code}; import sys; print('loaded', *(m for m in sys.modules if m.startswith('vapor.benchmark')))"
    done = subprocess.run([sys.executable, "-c", loaded], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "loaded"


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("run", "SEQUENCE"),
        ("convert", "DATASET OUT.mcap"),
        ("synthesize", "OUT.mcap"),
        ("evaluate", "DIRECTORY"),
        ("train", "DATA ..."),
    ],
)
def test_the_usage_names_what_to_give(command, said, capsys):
    assert status_of([command, "--help"]) == 0
    usage, _, _ = capsys.readouterr().out.partition("\n\n")
    assert f" {said}" in " ".join(usage.split())


def test_the_help_of_train_lists_the_presets(capsys):
    assert status_of(["train", "--help"]) == 0
    out = "".join(capsys.readouterr().out.replace("│", "").split())
    assert f"--preset{{{','.join(PRESETS)}}}" in out
