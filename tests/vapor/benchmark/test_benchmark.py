"""`vapor-benchmark localization` from end to end, with a network that knows nothing."""

import json
from collections import Counter

import pytest

from filtering.localizer import ParticleLocalizer
from sequences.scenes.scene import Scene
from tests.helpers.checks import no_checks
from tests.helpers.full import full
from tests.helpers.measured import tables_on_the_page
from tests.helpers.pages import ReadPage
from vapor.benchmark.__main__ import main
from vapor.benchmark.localization import failed
from vapor.benchmark.recordings import record
from vapor.benchmark.trials import choose, replay, setup

pytestmark = pytest.mark.usefixtures("unchecked", "rough_light_in_module")

OPTIONS = [
    "--runs", "1", "--frames", "50", "--width", "32", "--height", "24", "--num-samples", "20", "--workers", "1",
    "--first-seed", "700", "--localizer.max-hypotheses", "8", "--engine", "torch",
]  # fmt: skip

KINDS = ["cue", "no-cue", "kidnap"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory, tiny_model, rough_light_in_module):
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

    for module, name in ((record, "record_synthetic"), (replay, "localize")):
        monkeypatch.setattr(module, name, counted(name, getattr(module, name)))
    counter.interrupt_at = interrupt_at  # pyright: ignore[reportAttributeAccessIssue]
    return counter


def run(folder, tiny_model, *more: str) -> int:
    words = ["localization", "ceiling", "--models", str(tiny_model), "--output", str(folder)]
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
    assert summary["settings"]["replay"]["localizer"]["max_hypotheses"] == 8
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
    for name in ("walks", "standing"):
        assert tables_on_the_page(name, folder / "summary.json")
    page = ReadPage.of((folder / "report.html").read_text())
    for kind, ablations in summary["summary"]["ceiling"].items():
        sure = ablations["full"]["belief"]["filter"]["converged_images"]["images"]
        said = f"of the {sure} images that it called converged" if sure else "never sure"
        assert f"Ceiling, {choose.KINDS[kind].meaning}: the filter " in page.words
        assert said in page.words


@pytest.mark.parametrize(
    ("more", "again"),
    [
        (("--localizer.switch-ratio", "2"), "localize"),
        (("--num-samples", "21"), "record_synthetic"),
    ],
)
def test_other_settings_use_no_result_of_these(more, again, folder, tiny_model, calls):
    assert run(folder, tiny_model, "--kinds", "no-cue", *more) == 0
    assert calls[again] == 1
    assert calls["record_synthetic"] == (again == "record_synthetic")


def test_a_filter_that_was_changed_is_run_again(folder, tiny_model, calls, monkeypatch):
    monkeypatch.setattr(setup, "results_code", lambda: "another")
    assert run(folder, tiny_model, "--kinds", "cue") == 0
    assert calls == {"localize": 1}


def test_ablations_are_compared_in_a_table_of_their_own(folder, tiny_model, calls, capsys):
    assert run(folder, tiny_model, "--kinds", "no-cue", "--ablations", "full", "no-tails") == 0
    assert calls == {"localize": 1}  # the full one is there
    out = capsys.readouterr().out
    assert len([line for line in out.splitlines() if line.split()[:1] in (["full"], ["no-tails"])]) == 2
    summary = json.loads((folder / "summary.json").read_text())["summary"]["ceiling"]["no-cue"]
    assert summary.keys() == {"full", "no-tails"}


@full
def test_runs_at_several_rates_are_cut_from_one_recording(tiny_model, tmp_path, calls, capsys):
    assert run(tmp_path, tiny_model, "--kinds", "rate-3", "rate-10", "rate-30") == 0
    assert calls == {"record_synthetic": 1, "localize": 3}
    assert "ceiling, 3 images a second: 1 runs" in capsys.readouterr().out
    runs = json.loads((tmp_path / "summary.json").read_text())["runs"]
    assert {each["kind"]: each["images"] for each in runs} == {"rate-3": 15, "rate-10": 50, "rate-30": 150}
    for name in ("rates", "bfloat16"):
        assert tables_on_the_page(name, tmp_path / "summary.json")


def test_walks_where_storeys_look_alike_are_evaluated_but_for_the_storey_and_once_on_it(tiny_model, tmp_path, capsys):
    words = ["localization", "corridor", "--models", str(tiny_model), "--output", str(tmp_path)]
    assert main([*words, *OPTIONS, "--kinds", "walk", "--odometry-scale", "0.02"]) == 0
    out = capsys.readouterr().out
    assert "corridor, whole walks, something unique early: 1 runs" in out
    assert "once on its" in out
    (each,) = json.loads((tmp_path / "summary.json").read_text())["runs"]
    assert each["images"] == 50
    for name, method in each["methods"].items():
        assert method["storey"]["settled_images"] <= 50
        if name in each["belief"]:
            assert each["belief"][name]["on_storey"]["images"] == method["storey"]["settled_images"]
    for name in ("corridor", "sequences"):
        assert tables_on_the_page(name, tmp_path / "summary.json")
    (settings,) = (tmp_path / "recordings").glob("*/settings.json")
    assert json.loads(settings.read_text())["odometry_scale"] == 0.02
    with pytest.raises(SystemExit):
        main([*words, *OPTIONS, "--kinds", "walk", "--odometry-scale", "-2"])
    assert "odometry_scale is -2" in capsys.readouterr().err


@full
def test_a_run_of_a_standing_camera_is_as_long_as_it_stands(tiny_model, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(choose, "STAND_S", 1.0)
    monkeypatch.setattr(choose, "STAND_AFTER", 10)
    assert run(tmp_path, tiny_model, "--kinds", "standing", "standing-cue", "--ablations", "full", "no-tails") == 0
    out = capsys.readouterr().out
    assert "ceiling, standing where nothing is unique: 1 runs" in out
    assert "ceiling, standing before something unique: 1 runs" in out
    runs = json.loads((tmp_path / "summary.json").read_text())["runs"]
    for each in runs:
        if each["kind"] == "standing":
            assert (each["images"], each["cue_images"]) == (20, 0)
        else:
            assert each["images"] >= 20
            assert each["cue_images"] >= 10


def test_only_the_filter_with_a_known_kidnap_restarts_there(folder, tiny_model, monkeypatch):
    restarts, advance = [], ParticleLocalizer.advance

    def watched(localizer, observation):
        if localizer.config.resampling == "optimal":  # the Gaussian sum never restarts
            restarts.append(observation.odometry is None)
        return advance(localizer, observation)

    monkeypatch.setattr(ParticleLocalizer, "advance", watched)
    monkeypatch.setattr(setup, "results_code", lambda: "watched")
    assert run(folder, tiny_model, "--kinds", "kidnap", "--ablations", "full", "known-kidnap") == 0
    assert len(restarts) == 100  # two runs of 50 images, of which the last third is elsewhere
    assert [i for i, restarted in enumerate(restarts) if restarted] == [50 + 33]


@full
def test_processes_give_the_results_of_one(tiny_model, tmp_path, monkeypatch):
    monkeypatch.setattr(Scene, "build", Scene.build.__wrapped__)  # other processes know no rough light
    asked = ("--kinds", "cue", "no-cue")
    assert run(tmp_path / "alone", tiny_model, *asked) == 0
    alone = json.loads((tmp_path / "alone" / "summary.json").read_text())["runs"]
    assert run(tmp_path / "together", tiny_model, *asked, "--workers", "2") == 0
    together = json.loads((tmp_path / "together" / "summary.json").read_text())["runs"]
    assert len(together) == 2
    for ours, theirs in zip(alone, together, strict=True):
        assert ours | {"step_ms": 0} == theirs | {"step_ms": 0}
