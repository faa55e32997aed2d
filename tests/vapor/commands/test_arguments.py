"""Arguments: wrong ones are refused with status 2, and every command explains its own."""

import re
import subprocess
import sys

import pytest

from tests.helpers.command_line import EVERY_COMMAND, main
from vapor.benchmark import PROGRAM
from vapor.benchmark.__main__ import COMMANDS as BENCHMARKS
from vapor.track import COMMANDS


def status_of(words: list[str]) -> object:
    """Status of the process that these words would end, however that comes about."""
    try:
        return main(words)
    except SystemExit as end:
        return end.code


RUN = ["run", "a.mcap", "--model", "m", "--output", "o"]
TRAIN = ["train", "a.mcap", "--output", "m.safetensors"]
STAIRCASE = ["synthesize", "staircase", "s.mcap"]
CEILING = ["vapor-benchmark", "localization", "ceiling", "--output", "o"]
STEP = ["vapor-benchmark", "step"]

WRONG = {
    "no command": ([], ""),
    "unknown command": (["localise"], "unknown command 'localise', expected one of demo, run, live"),
    "unknown option": (
        [*RUN, "--nonsense", "1"],
        "run: unknown option --nonsense, expected one that `vapor-track run --help` lists\n",
    ),
    "misspelt option": ([*RUN, "--localizer.max-hypthoses", "9"], "did you mean --localizer.max-hypotheses?\n"),
    "misspelt option that is needed": (
        ["run", "a.mcap", "--modle", "m", "--output", "o"],
        "vapor-track run: unknown option --modle, did you mean --model?\n",
    ),
    "misspelt option of a benchmark": (
        [*STEP, "--repetition=9"],
        "vapor-benchmark step: unknown option --repetition, did you mean --repetitions?\n",
    ),
    "misspelt version": (["--versoin"], "'--versoin', did you mean --version?"),
    "mistyped command": (["rum"], "unknown command 'rum', did you mean run? Expected one of demo, run"),
    "missing model": (["run", "a.mcap", "--output", "o"], "or model file\n"),
    "missing model and output": (["run", "a.mcap"], "run: missing --model {ceiling,staircase}|PATH: Name of a model"),
    "missing output of a conversion": (["convert", "a"], "convert: missing OUT.mcap: MCAP file to write, new or"),
    "missing sequence": (["run", "--model", "m", "--output", "o"], "run: missing SEQUENCE ...: MCAP files, rosbag2"),
    "no data beside a model": (["calibrate", "staircase", "--output", "m"], "calibrate: missing DATA ...: MCAP files"),
    "an empty word": (["run", "", "--model", "m", "--output", "o"], "run: an argument is '', expected a path or a na"),
    "no odometry to fuse": (["fuse", "a.txt", "--output", "o"], "fuse: no odometry, expected either --odometry FILE"),
    "one moment": (["map", "a", "--output", "o", "--between", "0"], "map: --between is '0', expected 2 words\n"),
    "an export that is none": (["export", "m", "m.pt"], "export: OUT.onnx is 'm.pt', expected a name that ends in .o"),
    "one frame": (["convert", "d", "o.mcap", "--frames", "3"], "convert: --frames is '3', expected START:STOP with"),
    "no frames to convert": (["convert", "d", "o.mcap", "--frames"], "--frames has no value, expected START:STOP\n"),
    "no scene where none is needed": (["vapor-benchmark", "faults"], "vapor-benchmark faults: missing --output PATH"),
    "nothing": (["run"], "run: missing SEQUENCE ...: MCAP files, rosbag2"),
    "nothing but a command": (["train"], "train: missing DATA ...: MCAP files"),
    "missing all but the sequence": (["run", "--overwrite", "a.mcap"], "run: missing --model {"),
    "a word that looks like an option": (["run", "--", "--odd"], "run: missing --model {"),
    "value of a switch": ([*RUN, "--overwrite", "yes"], "run: unexpected 'yes', as --overwrite takes no value\n"),
    "value of a switch, after =": ([*RUN, "--no-undistort=a"], "unexpected 'a', as --no-undistort takes no value\n"),
    "a value too many": ([*RUN, "--start-s", "1", "2"], "run: unexpected '2' after 1, expected `vapor-track run SEQ"),
    "an argument too many": (
        ["convert", "a", "b.mcap", "c"],
        "convert: unexpected 'c' after b.mcap, expected `vapor-track convert DATASET OUT.mcap [OPTIONS]`\n",
    ),
    "a short option": (["run", "a", "-m", "m"], "run: unknown option -m, expected one that `vapor-track run --help`"),
    "no name of a model": (
        ["run", "a", "--model=", "--output", "o"],
        "run: --model is '', expected one of ceiling, staircase or a path\n",
    ),
    "a URL to read": (
        ["run", "s3://walks/a.mcap", *RUN[2:]],
        "run: s3://walks/a.mcap: expected a path; copy or mount",
    ),
    "a URL to write": ([*RUN[:-2], "--output=oss://b/x"], "oss://b/x: expected a path"),
    "a URL to train on": (["train", "gs://walks/a@0:9", *TRAIN[2:]], "gs://walks/a@0:9: expected a path"),
    "value that is no number": ([*RUN, "--seed", "one"], "run: --seed is 'one', expected a whole number\n"),
    "value that is no number, after =": ([*RUN, "--start_s=a"], "run: --start-s is 'a', expected a number\n"),
    "neither number nor word": (
        ["evaluate", "o", "--time-offset-s", "some"],
        "evaluate: --time-offset-s is 'some', expected a number or auto\n",
    ),
    "too few numbers": ([*RUN, "--base-from-camera", "1", "2"], "--base-from-camera is '1 2', expected 7 numbers\n"),
    "no value": ([*RUN, "--threads"], "run: --threads has no value, expected a whole number\n"),
    "empty output": (["run", "a.mcap", "--model", "m", "--output="], "run: --output is '', expected a path\n"),
    "unknown engine": ([*RUN, "--engine", "fast"], "--engine is 'fast', expected one of auto, torch, openvino\n"),
    "unknown scene of the demo": (["demo", "attic"], "scene is 'attic', expected one of staircase, ceiling\n"),
    "no samples": ([*RUN, "--num-samples", "0"], "num_samples is 0"),
    "negative seed": ([*RUN, "--seed", "-1"], "seed is -1"),
    "setting out of range": ([*RUN, "--localizer.modes.max-modes", "0"], "max_modes is 0, expected between 1"),
    "setting of NaN": ([*RUN, "--duration-s", "nan"], "duration_s is nan"),
    "no odometry topic": ([*RUN, "--odometry-topic", ""], "odometry_topic is '', expected the name of a topic"),
    "extrinsics without a rotation": ([*RUN, "--base-from-camera", *"1230000"], "--base-from-camera: "),
    "unknown scene": (["synthesize", "attic", "s.mcap"], "attic"),
    "building without a number": (["synthesize", "building", "s.mcap"], "such as building-7"),
    "benchmark of an unknown scene": (
        ["vapor-benchmark", "localization", "building-x", "--output", "o"],
        "unknown scene 'building-x', expected one of staircase, ceiling, corridor, building-N",
    ),
    "unknown cues": (["synthesize", "ceiling", "s.mcap", "--cues", "some"], "some"),
    "no such rate": ([*STAIRCASE, "--rate", "0"], "0 images a second"),
    "no frames": ([*STAIRCASE, "--frames", "0"], "0 frames"),
    "engine twice": ([*STEP, "--engines", "torch", "torch"], "engines are torch, torch, expected each at most"),
    "random weights on a walk": ([*STEP, "--sequence", "a.mcap", "--preset", "demo"], "expected one of them"),
    "unknown preset": ([*TRAIN, "--preset", "fast"], "expected one of auto"),
    "preset without name": ([*TRAIN, "--preset"], "preset"),
    "no training data": (["train", "--output", "m.safetensors"], "train: missing DATA ...: MCAP files"),
    "no model to write": (["train", "a.mcap"], "--output"),
    "no epochs": ([*TRAIN, "--epochs", "0"], "epochs is 0"),
    "both odometries": (["convert", "d", "o.mcap", "--odometry", "a.tum", "--odometry-noise"], "exclude each other"),
    "noise of no odometry": (["convert", "d", "o.mcap", "--noise.scale", "0.1"], "expected --odometry-noise with them"),
    "nothing to map": (["map", "--output", "o"], "map: missing INPUT ...: "),
    "a moment that is none": (
        ["map", "a.mp4", "--output", "o", "--distance-m", "1", "--between", "0", "x"],
        "--between",
    ),
    "malformed frames": (["convert", "d", "o.mcap", "--frames", "1-9"], "expected START:STOP"),
    "no directory": (["evaluate"], "Folder that `vapor-track run` wrote"),
    "no workers": ([*CEILING, "--workers", "0"], "workers is 0"),
    "no runs": ([*CEILING, "--runs", "-1"], "runs is -1"),
    "no frames of a benchmark": ([*CEILING, "--frames", "49"], "frames is 49, expected at least 50"),
    "no scene": (["vapor-benchmark", "localization", "--output", "o"], "expected each at most once, and one"),
    "unknown ablation": ([*CEILING, "--ablations", "best"], "unknown ablation 'best', expected one of full,"),
    "no kinds": ([*CEILING, "--kinds"], "kinds are none"),
    "more models than scenes": ([*CEILING, "--models", "a", "b"], "2 models for 1 scenes, expected one for each"),
    "no repetitions": ([*STEP, "--repetitions", "0"], "repetitions is 0"),
    "a filter of no hypotheses": ([*STEP, "--hypotheses", "10", "0"], "hypotheses are (10, 0)"),
    "a network of no preset": ([*STEP, "--preset", "fast"], "unknown preset 'fast', expected one of auto"),
    "unknown benchmark": (["vapor-benchmark", "everything"], "'everything', expected one of step, localization"),
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
    assert f"`{program} --version`" in out.replace("\n  ", " ")
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
