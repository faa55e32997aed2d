"""The summary of a benchmark: fractions, intervals, storeys, and the tables."""

import pytest

from vapor.benchmark.commands.localization import tables
from vapor.benchmark.localization import failed, summarise
from vapor.commands.console import show

pytestmark = pytest.mark.usefixtures("unchecked")


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
    metrics["position_recall"] = {"1m": 0.7, "3m": 0.8 + 0.01 * walk, "5m": 0.9}
    tracked = metrics | {
        "success": success,
        "converged_at_s": 3.0 if success else None,
        "after_convergence": {"images": 70, "recall": dict.fromkeys(recall, 0.9)} if success else None,
    }
    belief = {
        "status": {"converged": converged, "ambiguous": 1 - converged, "lost": 0.0},
        "converged_images": consistency(round(100 * converged), wrong),
        "after_convergence": consistency(70 if success else 0),
        "truth_among_modes": 0.9,
        "reliability": {
            "0.5": {"images": 20, "stated": 0.55, "right": 0.5},
            f"{0.6 + 0.1 * walk:.1f}": {"images": 80, "stated": 0.65, "right": 1.0 - wrong},
        },
        "longest_wrong_s": 10 * converged * wrong,
        "false_recoveries": 1,
        "kidnap": {"right_before": True, "images": recovered} if kind == "kidnap" else None,
    }
    methods = dict.fromkeys(("single_image", "dead_reckoning"), metrics)
    methods |= dict.fromkeys(("kalman", "gaussian_sum", "filter", "smoothed", "fixed_lag"), tracked)
    return {
        "name": f"ceiling-{kind}-{converged}", "scene": "ceiling", "kind": kind, "walk": walk, "variant": "full",
        "images": 100, "cue_images": 3, "methods": methods,
        "belief": dict.fromkeys(("filter", "kalman", "gaussian_sum", "smoothed"), belief),
        "image_truth_among_modes": 0.8, "particles": 100, "step_ms": 4.0,
    }  # fmt: skip


def test_fractions_of_images_are_weighed_by_how_many_images_there_were():
    both = [
        result("cue", converged=0.9, wrong=0.0),
        result("cue", converged=0.1, wrong=1.0, success=False),
        result("cue", converged=0.0, wrong=0.0),
    ]
    total = summarise(both)["ceiling"]["cue"]["full"]
    said = total["belief"]["filter"]["converged_images"]
    assert (said["images"], said["wrong"].value) == (100, pytest.approx(0.1))
    assert said["coverage"]["95%"].value == pytest.approx(0.9)
    assert total["belief"]["filter"]["status"]["converged"].value == pytest.approx(1 / 3)
    assert total["belief"]["filter"]["runs_wrongly_converged"].value == 1
    assert total["belief"]["filter"]["false_recoveries"] == 3
    assert total["methods"]["filter"]["successes"].value == 2
    assert total["methods"]["filter"]["recall_after_convergence"]["0.1m/10deg"].value == pytest.approx(0.9)
    assert "successes" not in total["methods"]["single_image"]
    assert total["failed"] == ["ceiling-cue-0.1"]


def test_reliability_is_over_all_images_of_all_runs_by_the_weight_of_the_best_mode():
    runs = [result("cue", converged=0.9, wrong=wrong, walk=walk) for walk, wrong in ((0, 0.0), (0, 0.5), (1, 0.0))]
    summary = summarise(runs)
    ranges = summary["ceiling"]["cue"]["full"]["belief"]["filter"]["reliability"]
    assert {low: row["images"] for low, row in ranges.items()} == {"0.5": 60, "0.6": 160, "0.7": 80}
    assert ranges["0.6"]["right"].value == pytest.approx(0.75)
    assert ranges["0.7"]["stated"].value == pytest.approx(0.65)
    shown = [table for table in tables(summary) if "0.6 and more" in list(table.columns[0].cells)]
    assert len(shown) == 1
    assert "75" in list(shown[0].columns[2].cells)[1]


def test_a_wrong_place_counts_in_any_image_and_in_a_twentieth_of_them():
    runs = [result("no-cue", converged=share, wrong=0.5) for share in (0.02, 0.08, 0.1, 0.3)]
    total = summarise(runs)["ceiling"]["no-cue"]["full"]
    assert total["belief"]["filter"]["runs_wrongly_converged"].value == 4
    assert total["belief"]["filter"]["runs_wrongly_converged_often"] == 2
    assert total["belief"]["filter"]["longest_wrong_s"] == pytest.approx(1.5)
    assert total["belief"]["filter"]["rightly_converged"].value == pytest.approx(0.0625)
    assert total["failed"] == ["ceiling-no-cue-0.1", "ceiling-no-cue-0.3"]


def test_recovery_counts_up_to_the_fiftieth_image():
    runs = [
        result("kidnap", converged=share, wrong=0.1, recovered=images)
        for share, images in ((0.1, 1), (0.2, 50), (0.3, 51), (0.4, None))
    ]
    kidnap = summarise(runs)["ceiling"]["kidnap"]["full"]["belief"]["filter"]["kidnap"]
    of_one_walk = {"recovered_in_time": (2, None, None), "median_images": (50.0, None, None)}
    assert kidnap == {"right_before": 4, "recovered": 3, **of_one_walk}
    assert [each["name"] for each in runs if failed(each)] == ["ceiling-kidnap-0.3", "ceiling-kidnap-0.4"]


def test_intervals_of_alike_runs_have_no_width_and_those_of_others_hold_the_figure():
    runs = [
        result("cue", converged=0.5 + 0.01 * walk, wrong=0.02 * walk, success=walk < 8, walk=walk)
        for walk in range(10)
        for _ in range(3)
    ]
    total = summarise(runs)["ceiling"]["cue"]["full"]
    method, said = total["methods"]["filter"], total["belief"]["filter"]["converged_images"]
    assert (total["runs"], total["walks"]) == (30, 10)
    assert method["median_translation_m"] == (0.1, 0.1, 0.1)
    rightly = total["belief"]["filter"]["rightly_converged"]
    for figure in (method["successes"], said["wrong"], said["coverage"]["95%"], rightly):
        assert figure.low < figure.value < figure.high


def on_storey(each: dict, right: float) -> dict:
    """A result of where storeys look alike: as many images once on it are right as are said."""
    storey = {"but_for_it": right, "settled_images": 90, "settled_right": right}
    methods = {name: method | {"storey": storey} for name, method in each["methods"].items()}
    belief = {name: found | {"on_storey": consistency(90, 1.0 - right)} for name, found in each["belief"].items()}
    return each | {"methods": methods, "belief": belief}


def test_storeys_are_summed_up_over_the_images_on_them_with_intervals():
    runs = [
        on_storey(result("walk", converged=0.5 + 0.01 * walk, wrong=0.0, walk=walk), 0.5 + 0.04 * walk)
        for walk in range(10)
    ]
    never = on_storey(result("walk", converged=0.9, wrong=0.0, walk=10), 0.1)
    nowhere = {"but_for_it": 0.1, "settled_images": 0, "settled_right": None}
    never["methods"] = {name: method | {"storey": nowhere} for name, method in never["methods"].items()}
    never["belief"] = {name: found | {"on_storey": consistency(0)} for name, found in never["belief"].items()}
    total = summarise([*runs, never])["ceiling"]["walk"]["full"]
    storey, belief = total["methods"]["smoothed"]["storey"], total["belief"]["filter"]["on_storey"]
    assert (storey["settled_images"], belief["images"]) == (900, 900)
    assert storey["settled_right"].value == pytest.approx(0.68)
    assert belief["wrong"].value == pytest.approx(0.32)
    assert storey["but_for_it"].value == pytest.approx((6.8 + 0.1) / 11)
    for name in ("but_for_it", "settled_right"):
        assert storey[name].low < storey[name].value < storey[name].high
    elsewhere = summarise([result("walk", converged=0.5, wrong=0.0)])["ceiling"]["walk"]["full"]
    assert "storey" not in elsewhere["methods"]["filter"]
    assert "on_storey" not in elsewhere["belief"]["filter"]


def in_sequences(each: dict, found: list[float], number: int = 20) -> dict:
    """A result with so many short sequences and few long ones, of which the filter succeeds in as many as are said."""
    success = {"1m": found[0], "0.5m": found[1]}
    single = {"1m": 0.1, "0.5m": 0.0}
    names = ("kalman", "gaussian_sum", "filter")
    short = {"sequences": number, "success": {"single_image": single} | dict.fromkeys(names, success)}
    methods = {name: method | {"storey_accuracy": found[0]} for name, method in each["methods"].items()}
    return each | {"methods": methods, "sequences": {"15": short, "100": {"sequences": 0, "success": None}}}


def test_sequences_are_summed_up_over_all_of_them_with_intervals_over_walks():
    runs = [
        in_sequences(result("walk", converged=0.5, wrong=0.0, walk=0), [1.0, 0.5], 30),
        in_sequences(result("walk", converged=0.5, wrong=0.0, walk=1), [0.5, 0.1], 10),
    ]
    total = summarise(runs)["ceiling"]["walk"]["full"]
    short = total["sequences"]["15"]
    assert short["sequences"] == 40
    assert short["success"]["filter"]["1m"] == pytest.approx((35 / 40, 0.5, 1.0))
    assert short["success"]["filter"]["0.5m"].value == pytest.approx(16 / 40)
    assert short["success"]["single_image"]["1m"].value == pytest.approx(0.1)
    assert total["sequences"]["100"] == {"sequences": 0, "success": {}}
    assert total["methods"]["filter"]["storey_accuracy"].value == pytest.approx(0.75)
    assert total["methods"]["filter"]["position_recall"]["3m"].value == pytest.approx(0.805)
    assert "sequences" not in summarise([result("cue", converged=0.5, wrong=0.0)])["ceiling"]["cue"]["full"]


@pytest.mark.parametrize("width", [80, 100])
def test_the_tables_fit_a_terminal(width, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", str(width))
    rates = [
        result(
            kind, converged=0.5 + 0.04 * walk, wrong=0.01 * walk, success=walk < 9, recovered=40 + 2 * walk, walk=walk
        )
        for kind in ("rate-3", "rate-10", "rate-30", "kidnap", "standing", "standing-30")
        for walk in range(10)
    ]
    rates = [on_storey(each, 0.9 + 0.01 * each["walk"]) for each in rates]
    rates = [in_sequences(each, [0.9 + 0.01 * each["walk"], 0.8]) for each in rates]
    for each in rates:
        each["sequences"]["100"] = each["sequences"]["15"]
    for table in tables(summarise(rates)):
        show(table)
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= width
    for kind in ("rate-3", "rate-10", "rate-30"):
        words = " ".join(lines).partition(f" {kind} ")[2].split()
        assert words[0] == "9/10"
    assert not [line for line in lines if "…" in line]
