import runpy
import sys
from pathlib import Path

import pytest

from tests.helpers.checkout import CHECKOUT
from tests.helpers.sequence_files import Walk
from vapor.checkpoints.file_format import load_checkpoint

EXAMPLES = CHECKOUT / "examples"


@pytest.fixture
def example(monkeypatch, capsys, tmp_path):
    """Runs an example by its name in an empty folder, as from the command line; gives what it prints."""

    def run(name: str, *words: str | Path) -> list[str]:
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, "argv", [name, *map(str, words)])
        runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
        return capsys.readouterr().out.splitlines()

    return run


def test_every_example_has_a_test_here():
    tests = Path(__file__).read_text(encoding="utf-8")
    for file in EXAMPLES.glob("*.py"):
        assert f'example("{file.stem}"' in tests


def test_a_bag_is_localized(example, walk_of_25, tiny_model, tmp_path):
    lines = example("localize_bag", walk_of_25, "--model", tiny_model)
    assert len([line for line in lines if line.startswith("image ")]) == 5
    assert (tmp_path / "result" / "trajectory.tum").is_file()


def test_a_posterior_of_ones_own_is_ambiguous_until_a_door_of_another_colour(example):
    lines = example("own_posterior")
    assert [line.split()[2] for line in lines] == ["ambiguous"] * 4 + ["converged"] * 2
    assert "the best at 35.9" in lines[-1] or "the best at 36.0" in lines[-1]


def test_a_model_is_trained_and_calibrated(example, tmp_path):
    walks = [Walk(count).write(tmp_path / f"walk{i}.mcap") for i, count in enumerate((8, 8, 21))]
    lines = example("train_and_calibrate", *walks[:2], "--held-out", walks[2], "--epochs", "1")
    assert lines[0].startswith("an ordinary image is ")
    load_checkpoint(tmp_path / "place.safetensors")


def test_estimates_of_two_rooms_are_fused_to_one_trajectory(example):
    error_m = {line.split()[0]: float(line.split()[-2]) for line in example("fuse_estimates")}
    assert error_m["filter"] < 0.1
    assert error_m["smoothed"] < 0.1


def test_steps_are_plotted(example, walk_of_25, tiny_model, tmp_path):
    (line,) = example("step_by_step", walk_of_25, "--model", tiny_model, "--output", "belief.png")
    assert line.startswith("belief.png: ")
    assert (tmp_path / "belief.png").read_bytes().startswith(b"\x89PNG")


def test_a_loop_of_ones_own_sends_transforms_while_it_is_sure(example, walk_of_25, tiny_model):
    (line,) = example("own_loop", walk_of_25, "--model", tiny_model)
    assert " transforms sent, last status " in line
    assert line.endswith("left out {}")
