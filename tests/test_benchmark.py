"""`vapor-track benchmark localization` from end to end, with a network that knows nothing."""

import json
from collections import Counter
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from filtering.config import LocalizerConfig
from filtering.estimate import Mode
from filtering.localizer import ParticleLocalizer
from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.odometry_fit.result import OdometryFit
from sequences.scenes import find_scene
from tests.checks import no_checks
from vapor.benchmark.localization.summary import failed, summarise
from vapor.benchmark.recordings import record
from vapor.benchmark.trials import kinds, setup
from vapor.benchmark.trials import run as trial_run
from vapor.benchmark.trials.trial import Segment, Trial
from vapor.checkpoints.calibration import Calibration
from vapor.checkpoints.file_format import load_checkpoint
from vapor.commands import console
from vapor.commands.benchmark.localization_tables import tables
from vapor.commands.console import show
from vapor.evaluation.comparison import Comparison
from vapor.evaluation.lengths import scaled_calibration, scaled_localizer, scaled_odometry
from vapor.track import main
from vapor.tracking.belief import Belief
from vapor.tracking.methods import METHODS

pytestmark = pytest.mark.usefixtures("unchecked")

OPTIONS = [
    "--runs", "1", "--frames", "50", "--width", "32", "--height", "24", "--num-samples", "40", "--workers", "1",
    "--first-seed", "700", "--localizer.max-hypotheses", "30",
]  # fmt: skip
KINDS = ["cue", "no-cue", "kidnap"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory, tiny_model):
    """Of a benchmark that is done: the tests go on from there, each on its own and in any order."""
    folder = tmp_path_factory.mktemp("benchmark")
    with no_checks():
        assert run(folder, tiny_model) == 0
    return folder


@pytest.fixture
def calls(monkeypatch):
    """How often something was recorded and localized; each can be made to be interrupted at a call."""
    counter: Counter[str] = Counter()
    interrupt_at: dict[str, int] = {}

    def counted(name, original):
        def call(*arguments):
            counter[name] += 1
            if counter[name] == interrupt_at.get(name):
                raise KeyboardInterrupt
            return original(*arguments)

        return call

    for module, name in ((record, "record_synthetic"), (trial_run, "localize")):
        monkeypatch.setattr(module, name, counted(name, getattr(module, name)))
    counter.interrupt_at = interrupt_at  # pyright: ignore[reportAttributeAccessIssue]
    return counter


def run(folder, tiny_model, *more: str) -> int:
    words = ["benchmark", "localization", "ceiling", "--models", str(tiny_model), "--output", str(folder)]
    return main([*words, *OPTIONS, *more])


def test_an_interrupted_benchmark_goes_on_and_a_finished_one_computes_nothing(tmp_path, tiny_model, calls, capsys):
    asked = ["--kinds", "cue", "no-cue"]
    calls.interrupt_at.update(record_synthetic=2)
    assert run(tmp_path, tiny_model, *asked) == 130
    assert calls == {"record_synthetic": 2}  # one of them done
    calls.interrupt_at.clear()
    calls.interrupt_at.update(localize=2)
    assert run(tmp_path, tiny_model, *asked) == 130
    needed = len(list((tmp_path / "recordings").iterdir()))
    assert calls == {"record_synthetic": 1 + needed, "localize": 2}
    assert not (tmp_path / "summary.json").exists()
    calls.interrupt_at.clear()
    capsys.readouterr()
    assert run(tmp_path, tiny_model, *asked) == 0
    assert calls == {"record_synthetic": 1 + needed, "localize": 2 + 2 - 1}
    printed, summary = capsys.readouterr().out, (tmp_path / "summary.json").read_bytes()
    assert run(tmp_path, tiny_model, *asked) == 0
    assert calls == {"record_synthetic": 1 + needed, "localize": 2 + 2 - 1}
    assert (capsys.readouterr().out, (tmp_path / "summary.json").read_bytes()) == (printed, summary)


def test_the_summary_has_every_run_and_the_tables_every_kind(folder, tiny_model, capsys):
    assert run(folder, tiny_model) == 0
    out = capsys.readouterr().out
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["settings"]["localizer"]["max_hypotheses"] == 30
    assert summary["summary"].keys() == {"ceiling"}
    assert summary["summary"]["ceiling"].keys() == set(KINDS)
    runs = summary["runs"]
    assert Counter((each["kind"], each["variant"]) for each in runs) == {(kind, "full"): 1 for kind in KINDS}
    for each in runs:
        assert each["images"] == 50
        assert (each["cue_images"] == 0) == (each["kind"] == "no-cue")
        assert (each["belief"]["filter"]["kidnap"] is None) == (each["kind"] != "kidnap")
        if failed(each):
            assert each["name"] in out
    for said in ("something unique in the first half: 1 runs", "nothing unique: 1 runs", "carried off: 1 runs"):
        assert f"ceiling, {said}" in out


@pytest.mark.parametrize(
    ("more", "again"),
    [
        (("--errors.tail", "30"), "localize"),
        (("--localizer.switch-ratio", "2"), "localize"),
        (("--num-samples", "41"), "record_synthetic"),
    ],
)
def test_other_settings_use_no_result_of_these(more, again, folder, tiny_model, calls, tmp_path):
    assert run(folder, tiny_model, "--kinds", "no-cue", *more) == 0
    assert calls[again] == 1
    assert calls["record_synthetic"] == (again == "record_synthetic")


def test_ablations_are_compared_in_a_table_of_their_own(folder, tiny_model, calls, capsys):
    assert run(folder, tiny_model, "--kinds", "no-cue", "--ablations", "full", "no-tails") == 0
    assert calls == {"localize": 1}  # the full one is there
    out = capsys.readouterr().out
    assert len([line for line in out.splitlines() if line.split()[:1] in (["full"], ["no-tails"])]) == 2
    summary = json.loads((folder / "summary.json").read_text())["summary"]["ceiling"]["no-cue"]
    assert summary.keys() == {"full", "no-tails"}


def test_errors_given_replace_those_of_the_model_and_are_reported(folder, tiny_model, monkeypatch, capsys):
    told = []
    update = ParticleLocalizer.update

    def watched(localizer, posterior, odometry, **timing):
        told.append(posterior.errors)
        return update(localizer, posterior, odometry, **timing)

    monkeypatch.setattr(ParticleLocalizer, "update", watched)
    monkeypatch.setattr(setup, "results_code", lambda: "of errors")
    floor = ["0.01", "0.02", "0.03", "0.04", "0.05", "0.06"]
    more = ["--kinds", "no-cue", "--errors.outlier-probability", "0.25", "--errors.floor", *floor]
    assert run(folder, tiny_model, *more) == 0
    own = load_checkpoint(tiny_model).calibration.errors
    assert set(told) == {replace(own, outlier_probability=0.25, floor=(0.01, 0.02, 0.03, 0.04, 0.05, 0.06))}
    settings = json.loads((folder / "summary.json").read_text())["settings"]
    assert settings["errors"] == {"outlier_probability": 0.25, "floor": [float(value) for value in floor]}
    assert run(folder, tiny_model, "--kinds", "no-cue", "--errors.outlier-probability", "2") == 1
    assert "outlier_probability is 2" in capsys.readouterr().err


def test_runs_at_several_rates_are_cut_from_one_recording(tiny_model, tmp_path, calls, capsys):
    assert run(tmp_path, tiny_model, "--kinds", "rate-3", "rate-10", "rate-30") == 0
    assert calls == {"record_synthetic": 1, "localize": 3}
    assert "ceiling, 3 images a second: 1 runs" in capsys.readouterr().out
    runs = json.loads((tmp_path / "summary.json").read_text())["runs"]
    assert {each["kind"]: each["images"] for each in runs} == {"rate-3": 15, "rate-10": 50, "rate-30": 150}


@pytest.mark.usefixtures("rough_light")
def test_walks_where_floors_look_alike_are_evaluated_but_for_the_floor_and_once_on_it(tiny_model, tmp_path, capsys):
    words = ["benchmark", "localization", "corridor", "--models", str(tiny_model), "--output", str(tmp_path)]
    assert main([*words, *OPTIONS, "--kinds", "walk", "--odometry-scale", "0.02"]) == 0
    out = capsys.readouterr().out
    assert "corridor, whole walks, something unique early: 1 runs" in out
    assert "once on its" in out
    (each,) = json.loads((tmp_path / "summary.json").read_text())["runs"]
    assert each["images"] == 50
    for name, method in each["methods"].items():
        assert method["floor"]["settled_images"] <= 50
        if name in each["belief"]:
            assert each["belief"][name]["on_floor"]["images"] == method["floor"]["settled_images"]
    (settings,) = (tmp_path / "recordings").glob("*/settings.json")
    assert json.loads(settings.read_text())["odometry_scale"] == 0.02
    with pytest.raises(SystemExit):
        main([*words, *OPTIONS, "--kinds", "walk", "--odometry-scale", "-2"])
    assert "odometry_scale is -2" in capsys.readouterr().err


def test_a_run_of_a_standing_camera_is_as_long_as_it_stands(tiny_model, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(kinds, "STAND_S", 3.0)
    monkeypatch.setattr(kinds, "STAND_AFTER", 10)
    assert run(tmp_path, tiny_model, "--kinds", "standing", "standing-cue", "--ablations", "full", "no-tails") == 0
    out = capsys.readouterr().out
    assert "ceiling, standing where nothing is unique: 1 runs" in out
    assert "ceiling, standing before something unique: 1 runs" in out
    runs = json.loads((tmp_path / "summary.json").read_text())["runs"]
    for each in runs:
        if each["kind"] == "standing":
            assert (each["images"], each["cue_images"]) == (40, 0)
        else:
            assert each["images"] >= 40
            assert each["cue_images"] >= 30


def test_a_run_at_another_scale_has_the_results_of_the_unscaled_one(folder, tiny_model, calls, capsys):
    scaled = ("scale-0.1", "scale-30")
    assert run(folder, tiny_model, "--kinds", "cue", *scaled) == 0
    assert calls == {"localize": 2}  # no recording is made
    assert "the filter by kind of run" in capsys.readouterr().out
    runs = {each["kind"]: each for each in json.loads((folder / "summary.json").read_text())["runs"]}
    assert load_checkpoint(tiny_model).calibration.odometry is None
    for kind in scaled:
        for name in METHODS:
            ours, theirs = runs[kind]["methods"][name], runs["cue"]["methods"][name]
            same = pytest.approx(theirs["median_translation_m"], rel=1e-4 if name == "smoothed" else 1e-6)
            assert ours["median_translation_m"] == same
            assert ours["recall"] == theirs["recall"]
        assert runs[kind]["belief"]["filter"]["status"] == runs["cue"]["belief"]["filter"]["status"]


def test_a_calibration_is_scaled_with_the_odometry_that_it_found():
    fit = OdometryFit(
        (1e-4,) * 6,
        (2e-4,) * 6,
        (0.01,) * 6,
        20.0,
        0.01,
        0.02,
        (1e-3,) * 6,
        (0.1,) * 6,
        (0.1,) * 6,
        0.1,
        500,
        2,
        50.0,
        9.0,
        0,
    )
    motion = Odometry(Poses.exp(np.array([0.3, -0.1, 0.2, 0.1, 0.2, -0.3])), np.eye(6), 0.5)
    calibration = Calibration(odometry=fit)
    scaled = scaled_calibration(calibration, 30.0)
    expected = scaled_odometry(fit.restated(motion), 30.0)
    found = scaled.odometry.restated(scaled_odometry(motion, 30.0))
    np.testing.assert_allclose(found.covariance, expected.covariance, atol=1e-15)
    assert scaled.odometry.slow_errors.drift == pytest.approx((0.3, 0.3, 0.3, 0.01, 0.01, 0.01))
    assert scaled.odometry.slow_errors.scale == fit.slow_errors.scale
    assert scaled.errors == calibration.errors.scaled(30.0)
    assert scaled_calibration(calibration, 1.0) == calibration


def test_settings_of_the_filter_that_are_lengths_are_scaled():
    assert scaled_localizer(LocalizerConfig(), 1.0) == LocalizerConfig()
    scaled = scaled_localizer(LocalizerConfig(converged_std_m=0.2), 30.0)
    assert scaled.converged_std_m == pytest.approx(6.0)
    assert scaled.gap.speed_m_per_s == pytest.approx(30.0 * LocalizerConfig().gap.speed_m_per_s)


def test_only_a_filter_that_is_told_of_a_kidnap_starts_anew_there(folder, tiny_model, monkeypatch):
    anew, update = [], ParticleLocalizer.update

    def watched(localizer, posterior, odometry, **timing):
        if type(localizer) is ParticleLocalizer:  # the Gaussian sum is told nothing
            anew.append(odometry is None)
        return update(localizer, posterior, odometry, **timing)

    monkeypatch.setattr(ParticleLocalizer, "update", watched)
    monkeypatch.setattr(setup, "results_code", lambda: "watched")
    assert run(folder, tiny_model, "--kinds", "kidnap", "--ablations", "full", "told-of-kidnap") == 0
    assert len(anew) == 100  # two runs of 50 images, of which the last third is elsewhere
    assert [i for i, told in enumerate(anew) if told] == [50 + 33]


def test_the_filter_that_was_changed_is_run_again(folder, tiny_model, calls, monkeypatch):
    monkeypatch.setattr(setup, "results_code", lambda: "another")
    assert run(folder, tiny_model, "--kinds", "cue") == 0
    assert calls == {"localize": 1}


def test_processes_give_the_results_of_one(folder, tiny_model, tmp_path):
    asked = ("--kinds", "cue", "no-cue")
    assert run(folder, tiny_model, *asked) == 0
    alone = json.loads((folder / "summary.json").read_text())["runs"]
    assert run(tmp_path, tiny_model, *asked, "--workers", "2") == 0
    together = json.loads((tmp_path / "summary.json").read_text())["runs"]
    assert len(together) == 2
    for ours, theirs in zip(alone, together, strict=True):
        assert ours | {"step_ms": 0} == theirs | {"step_ms": 0}


def test_a_recording_of_something_else_is_refused(folder, tiny_model, capsys):
    of_seed_700 = (folder / "recordings").glob("ceiling-none-700-*/settings.json")
    settings = next(file for file in of_seed_700 if json.loads(file.read_text())["num_samples"] == 40)
    before = settings.read_text()
    settings.write_text(before.replace('"seed": 700', '"seed": 701'))
    more = ("--kinds", "no-cue", "--localizer.switch-ratio", "3")
    try:
        assert run(folder, tiny_model, *more) == 1
    finally:
        settings.write_text(before)
    assert "recorded with seed 701, expected 700; remove it to make it anew" in capsys.readouterr().err


def consistency(images: int, wrong: float = 0.0) -> dict:
    if images == 0:
        return {"images": 0, "wrong": None, "coverage": None, "median_nees": None}
    return {
        "images": images,
        "wrong": wrong,
        "coverage": {"50%": 0.4, "90%": 0.8, "95%": 1 - wrong},
        "median_nees": 5.0,
    }


def result(
    kind: str, *, converged: float, wrong: float, success: bool = True, recovered: int | None = None, walk: int = 0
) -> dict:
    """Of a run of 100 images."""
    recall = {"0.1m/10deg": 0.2, "0.2m/15deg": 0.4, "0.3m/20deg": 0.6}
    metrics = {"median_translation_m": 0.1, "median_rotation_deg": 2.0, "ape_rmse_m": 0.3, "recall": recall}
    tracked = metrics | {
        "success": success,
        "converged_at_s": 3.0 if success else None,
        "after_convergence": {"images": 70, "recall": dict.fromkeys(recall, 0.9)} if success else None,
    }
    belief = {
        "status": {"converged": converged, "ambiguous": 1 - converged, "lost": 0.0},
        "said_converged": consistency(round(100 * converged), wrong),
        "after_convergence": consistency(70 if success else 0),
        "truth_among_modes": 0.9,
        "longest_wrong_s": 10 * converged * wrong,
        "false_recoveries": 1,
        "kidnap": {"right_before": True, "images": recovered} if kind == "kidnap" else None,
    }
    methods = dict.fromkeys(("single_image", "dead_reckoning"), metrics)
    methods |= dict.fromkeys(("kalman", "gaussian_sum", "filter", "smoothed"), tracked)
    return {
        "name": f"ceiling-{kind}-{converged}", "scene": "ceiling", "kind": kind, "walk": walk, "variant": "full",
        "images": 100, "cue_images": 3, "methods": methods,
        "belief": dict.fromkeys(("filter", "kalman", "gaussian_sum"), belief),
        "image_truth_among_modes": 0.8, "particles": 100, "step_ms": 4.0,
    }  # fmt: skip


def test_fractions_of_images_are_weighed_by_how_many_images_there_were():
    both = [
        result("cue", converged=0.9, wrong=0.0),
        result("cue", converged=0.1, wrong=1.0, success=False),
        result("cue", converged=0.0, wrong=0.0),
    ]
    total = summarise(both)["ceiling"]["cue"]["full"]
    said = total["belief"]["filter"]["said_converged"]
    assert (said["images"], said["wrong"]) == (100, pytest.approx(0.1))
    assert said["coverage"]["95%"] == pytest.approx(0.9)
    assert total["belief"]["filter"]["status"]["converged"] == pytest.approx(1 / 3)
    assert total["belief"]["filter"]["runs_wrongly_converged"] == 1
    assert total["belief"]["filter"]["false_recoveries"] == 3
    assert total["methods"]["filter"]["successes"] == 2
    assert total["methods"]["filter"]["recall_after_convergence"]["0.1m/10deg"] == pytest.approx(0.9)
    assert "successes" not in total["methods"]["single_image"]
    assert total["failed"] == ["ceiling-cue-0.1"]


def test_a_wrong_place_counts_in_any_image_and_in_a_twentieth_of_them():
    runs = [result("no-cue", converged=share, wrong=0.5) for share in (0.02, 0.08, 0.1, 0.3)]
    total = summarise(runs)["ceiling"]["no-cue"]["full"]
    assert total["belief"]["filter"]["runs_wrongly_converged"] == 4
    assert total["belief"]["filter"]["runs_wrongly_converged_often"] == 2
    assert total["belief"]["filter"]["longest_wrong_s"] == pytest.approx(1.5)
    assert total["belief"]["filter"]["rightly_converged"] == pytest.approx(0.0625)
    assert total["failed"] == ["ceiling-no-cue-0.1", "ceiling-no-cue-0.3"]


def test_recovery_counts_up_to_the_fiftieth_image():
    runs = [
        result("kidnap", converged=share, wrong=0.1, recovered=images)
        for share, images in ((0.1, 1), (0.2, 50), (0.3, 51), (0.4, None))
    ]
    kidnap = summarise(runs)["ceiling"]["kidnap"]["full"]["belief"]["filter"]["kidnap"]
    intervals = kidnap.pop("intervals")
    assert kidnap == {"right_before": 4, "recovered_in_time": 2, "recovered": 3, "median_images": 50.0}
    assert intervals == {"recovered_in_time": None}  # of one walk
    assert [each["name"] for each in runs if failed(each)] == ["ceiling-kidnap-0.3", "ceiling-kidnap-0.4"]


def test_intervals_of_alike_runs_have_no_width_and_those_of_others_hold_the_figure():
    runs = [
        result("cue", converged=0.5 + 0.01 * walk, wrong=0.02 * walk, success=walk < 8, walk=walk)
        for walk in range(10)
        for _ in range(3)
    ]
    total = summarise(runs)["ceiling"]["cue"]["full"]
    method, said = total["methods"]["filter"], total["belief"]["filter"]["said_converged"]
    assert (total["runs"], total["walks"]) == (30, 10)
    assert method["intervals"]["median_translation_m"] == (0.1, 0.1)
    for interval, figure in (
        (method["intervals"]["successes"], method["successes"]),
        (said["intervals"]["wrong"], said["wrong"]),
        (said["intervals"]["coverage"]["95%"], said["coverage"]["95%"]),
        (total["belief"]["filter"]["intervals"]["rightly_converged"], total["belief"]["filter"]["rightly_converged"]),
    ):
        assert interval[0] < figure < interval[1]


def on_floor(each: dict, right: float) -> dict:
    """A result of where floors look alike: as many images once on it are right as are said."""
    floor = {"but_for_it": right, "settled_images": 90, "settled_right": right}
    methods = {name: method | {"floor": floor} for name, method in each["methods"].items()}
    belief = {name: found | {"on_floor": consistency(90, 1.0 - right)} for name, found in each["belief"].items()}
    return each | {"methods": methods, "belief": belief}


def test_floors_are_summed_up_over_the_images_on_them_with_intervals():
    runs = [
        on_floor(result("walk", converged=0.5 + 0.01 * walk, wrong=0.0, walk=walk), 0.5 + 0.04 * walk)
        for walk in range(10)
    ]
    never = on_floor(result("walk", converged=0.9, wrong=0.0, walk=10), 0.1)
    nowhere = {"but_for_it": 0.1, "settled_images": 0, "settled_right": None}
    never["methods"] = {name: method | {"floor": nowhere} for name, method in never["methods"].items()}
    never["belief"] = {name: found | {"on_floor": consistency(0)} for name, found in never["belief"].items()}
    total = summarise([*runs, never])["ceiling"]["walk"]["full"]
    floor, belief = total["methods"]["smoothed"]["floor"], total["belief"]["filter"]["on_floor"]
    assert (floor["settled_images"], belief["images"]) == (900, 900)
    assert floor["settled_right"] == pytest.approx(0.68)
    assert belief["wrong"] == pytest.approx(0.32)
    assert floor["but_for_it"] == pytest.approx((6.8 + 0.1) / 11)
    for name in ("but_for_it", "settled_right"):
        low, high = floor["intervals"][name]
        assert low < floor[name] < high
    elsewhere = summarise([result("walk", converged=0.5, wrong=0.0)])["ceiling"]["walk"]["full"]
    assert "floor" not in elsewhere["methods"]["filter"]
    assert "on_floor" not in elsewhere["belief"]["filter"]


@pytest.mark.parametrize("scale", [1.0, 30.0])
def test_floors_are_evaluated_in_the_lengths_of_the_scene(scale, monkeypatch):
    """At another scale the poses are scaled back before whole floors are counted."""
    height = find_scene("corridor").floor_height_m
    assert height == 3.2
    truth = Poses(np.tile(np.eye(3), (4, 1, 1)), np.array([[x, 0.0, 0.0] for x in range(4)]))
    off = Poses(truth.rotation, truth.translation + np.array([[0.0, 0.0, height * up] for up in (1.05, 1, 0, 0)]))
    modes = tuple((Mode(off[i], 0.01 * np.eye(6), 1.0),) for i in range(4))
    beliefs = dict.fromkeys(("kalman", "gaussian_sum", "filter"), Belief(modes, ["ambiguous"] * 4))
    compared = Comparison(10**8 * np.arange(4), truth, dict.fromkeys(METHODS, off), beliefs, modes, 1, 1.0)
    monkeypatch.setattr(trial_run, "follow_trial", lambda trial, setup, replay: None)
    monkeypatch.setattr(trial_run, "compare", lambda followed: compared.scaled(scale))
    given = SimpleNamespace(ablation="full", cue_images=0)
    for scene in ("corridor", "ceiling"):
        trial = Trial(scene, "walk", (Segment(0, 0, 4),), scale=scale)
        found = trial_run.localize(trial, given, given)  # pyright: ignore[reportArgumentType]
        told, belief = found["methods"]["smoothed"], found["belief"]["filter"]
        if scene == "corridor":
            assert told["floor"] == {"but_for_it": 1.0, "settled_images": 2, "settled_right": 1.0}
            assert belief["on_floor"]["images"] == 2
        else:
            assert "floor" not in told
            assert "on_floor" not in belief


@pytest.mark.parametrize("width", [90, 100])
def test_the_tables_fit_a_terminal(width, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", str(width))
    monkeypatch.setattr(console, "_MIN_WIDTH", width)
    rates = [
        result(
            kind, converged=0.5 + 0.04 * walk, wrong=0.01 * walk, success=walk < 9, recovered=40 + 2 * walk, walk=walk
        )
        for kind in ("rate-3", "rate-10", "rate-30", "kidnap", "standing", "standing-30")
        for walk in range(10)
    ]
    rates = [on_floor(each, 0.9 + 0.01 * each["walk"]) for each in rates]
    for table in tables(summarise(rates)):
        show(table)
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= width
    for kind in ("rate-3", "rate-10", "rate-30"):
        row = next(line for line in lines if line.split()[:1] == [kind])
        assert row.split()[1] == "9/10"
    assert not [line for line in lines if "…" in line]
