"""`vapor-track benchmark textbook`: the textbook filters, and the command from end to end."""

import importlib.util
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from filtering.config import LocalizerConfig
from filtering.density import KernelDensity
from filtering.error_model import ErrorModel
from filtering.errors import VaporTrackError
from filtering.motion import Odometry
from filtering.se3 import Poses
from tests.helpers.checks import no_checks
from vapor.benchmark.textbook import methods, run
from vapor.benchmark.textbook.benchmark import TextbookBenchmark, TextbookConfig
from vapor.benchmark.textbook.building_blocks import TextbookSettings, heaviest_place, log_likelihood
from vapor.benchmark.textbook.methods import Image, Method, start
from vapor.benchmark.trials.replay import load_replay
from vapor.benchmark.trials.run import localize
from vapor.commands.benchmark import textbook
from vapor.track import main

CONFIG = TextbookConfig(
    runs=1, frames=50, width=32, height=24, num_samples=40, first_seed=700, particles=(30,), equal_runs=1,
    localizer=LocalizerConfig(max_hypotheses=20),
)  # fmt: skip
OPTIONS = [
    "--runs", "1", "--frames", "50", "--width", "32", "--height", "24", "--num-samples", "40", "--first-seed", "700",
    "--particles", "30", "--equal-runs", "1", "--localizer.max-hypotheses", "20",
    "--preset", "tables", "--repetitions", "1",
]  # fmt: skip

FILTERS = [
    "filterpy",
    pytest.param(
        "particles",
        marks=pytest.mark.skipif(importlib.util.find_spec("particles") is None, reason="cannot be a dependency"),
    ),
]


@pytest.fixture
def done(folder, monkeypatch):
    """The folder of a benchmark that is done, where nothing may be filtered again, and networks take no time."""
    summary = json.loads((folder / "summary.json").read_text())
    monkeypatch.setattr(textbook, "_networks", lambda _: summary["networks"])
    monkeypatch.setattr(run, "compare_methods", None)
    return folder


def command(folder: Path, model: Path) -> int:
    return main(["benchmark", "textbook", "ceiling", "--models", str(model), "--output", str(folder), *OPTIONS])


@pytest.fixture(scope="module")
def folder(tmp_path_factory, tiny_model):
    folder = tmp_path_factory.mktemp("textbook")
    with no_checks():
        assert command(folder, tiny_model) == 0
    return folder


def test_every_filter_is_in_the_summary_and_the_table_with_as_many_particles(done, tiny_model, capsys):
    assert command(done, tiny_model) == 0
    printed = capsys.readouterr().out
    summary = json.loads((done / "summary.json").read_text())
    found = summary["summary"]["ceiling"]["cue"]
    expected = {f"{name}-{count}": count for name in ("filter", *methods.installed()) for count in (30,)}
    assert found.keys() == {"filter", *expected}
    for key, count in expected.items():
        assert found[key]["particles"] == count
    assert found["filter"]["over_ours"] == 1.0
    for said in ("ceiling, something unique in the first half: 1 runs", "filterpy", "eager PyTorch", "whole step"):
        assert said in printed
    assert len(summary["networks"]["ceiling"]) == 3


def test_ours_is_given_what_the_benchmark_of_localization_gives_it(folder, tiny_model):
    summary = json.loads((folder / "summary.json").read_text())
    benchmark = TextbookBenchmark({"ceiling": str(tiny_model)}, folder, CONFIG, {})
    (trial,) = benchmark.choose(lambda done, total: None)
    setup = benchmark._setups["ceiling"]
    with no_checks():
        expected = localize(trial, setup, load_replay(trial, setup, folder))["methods"]["filter"]
    assert summary["runs"][0]["methods"]["filter"]["trajectory"] == expected


def test_without_the_library_its_filter_is_left_out_and_one_is_told_how_to_install_it(
    done, tiny_model, monkeypatch, tmp_path, capsys
):
    shutil.copytree(done, tmp_path, dirs_exist_ok=True)
    shutil.rmtree(tmp_path / "textbook")
    asked = []
    monkeypatch.setattr(methods, "find_spec", lambda name: None if name == "particles" else name)
    monkeypatch.setattr(run, "compare_methods", lambda _, __, chosen, *___: asked.extend(chosen) or {})
    assert command(tmp_path, tiny_model) == 0
    assert {method.name for method in asked} == {"filter", "filterpy"}
    assert "left out: particles, which is not installed: pip install" in capsys.readouterr().out


@pytest.mark.parametrize("name", FILTERS)
def test_a_textbook_filter_follows_a_camera_and_finds_it_again_where_it_was_carried_off(name):
    before = np.random.get_state()[1].tolist()  # noqa: NPY002
    step = Odometry(Poses.exp(np.array([0.05, 0, 0, 0, 0, 0.01])), np.diag([1e-4] * 3 + [1e-5] * 3), 0.1)
    ends = []
    for _ in range(2):
        update = start(Method(name, 300), LocalizerConfig(), ErrorModel(), TextbookSettings(), np.random.default_rng(1))
        images, truth = np.random.default_rng(2), Poses.identity()
        for carried_m in (0.0, 3.0):
            truth = replace(truth, translation=truth.translation + carried_m)
            for _ in range(30):
                truth = truth @ step.previous_from_current
                samples = truth @ Poses.exp(0.05 * images.standard_normal((100, 6)))
                said = update(Image(samples, 0.0, step))
            apart_m, apart_rad = said.best.distance(truth)
            assert said.converged
            assert apart_m < 0.1
            assert apart_rad < 0.1
        ends.append(said.best)
    assert np.array_equal(ends[0].translation, ends[1].translation)
    assert np.random.get_state()[1].tolist() == before  # noqa: NPY002


def test_the_likelihood_is_that_of_the_exact_kernel_density():
    rng = np.random.default_rng(0)
    samples, poses = (Poses.exp(scale * rng.standard_normal((n, 6))) for scale, n in ((0.3, 50), (0.5, 400)))
    settings = TextbookSettings(kernel_m=0.2, kernel_rad=0.3, power=1.0, outlier_probability=1e-9)
    exact = KernelDensity(samples, 0.2, 0.3).log_density(poses)
    found = log_likelihood(samples, poses, settings, -6.0)
    dense = exact > -15.0
    assert dense.sum() > 100
    assert np.abs(found - exact)[dense].max() < 1e-3
    assert (found >= np.log(1e-9) - 6.0).all()


def test_of_two_places_the_best_pose_lies_in_the_heavier_one():
    rng = np.random.default_rng(0)
    light, heavy = Poses.exp(np.array([0.0, 0, 0, 0, 0, 0])), Poses.exp(np.array([2.0, 0, 0, 0, 0, 1.0]))
    poses = Poses.concatenate([place @ Poses.exp(0.03 * rng.standard_normal((100, 6))) for place in (light, heavy)])
    best, weight = heaviest_place(poses, np.repeat([0.4, 0.6], 100) / 100)
    assert best.distance(heavy)[0] < 0.02
    assert weight == pytest.approx(0.6)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"kinds": ("scale-30",)}, "scale-30"),
        ({"methods": ("amcl",)}, "amcl"),
        ({"particles": (0,)}, "particles"),
        ({"particles": (10, 10)}, "at most once"),
        ({"methods": ()}, "none"),
        ({"runs": 0}, "runs"),
    ],
)
def test_bad_settings_are_refused(wrong, said):
    with pytest.raises(VaporTrackError, match=said):
        replace(CONFIG, **wrong)
