"""Faults: when they begin, how long they last, and how a walk is evaluated."""

import numpy as np
import pytest

from filtering.estimate import Mode
from filtering.se3 import Poses
from tests.helpers.simulation import translated
from vapor.benchmark.faults.metrics import evaluate_fault, longest_run, summarise_faults
from vapor.benchmark.faults.table import FAULTS, NONE, find_moment
from vapor.tracking.loop import Belief

pytestmark = pytest.mark.usefixtures("unchecked")


def test_faults_last_a_while_to_the_end_or_throughout():
    times_ns = 100_000_000 * np.arange(300, dtype=np.int64)
    assert FAULTS["black"].during(100, times_ns) == range(100, 150)
    assert FAULTS["black"].during(20, times_ns[::5]) == range(20, 30)
    assert FAULTS["noise"].during(100, times_ns) == range(100, 300)
    assert FAULTS["late"].during(100, times_ns) == range(300)


def test_a_fault_begins_once_the_filter_was_converged_for_a_while_and_never_too_late():
    times_ns = 100_000_000 * np.arange(300, dtype=np.int64)
    status = ["converged"] * 300
    assert find_moment(status, times_ns) == 50
    status[40] = "ambiguous"
    assert find_moment(status, times_ns) == 91
    assert find_moment(status[:240], times_ns[:240]) is None
    assert find_moment(status[:241], times_ns[:241]) == 91
    assert find_moment(["lost"] * 300, times_ns) is None


def test_the_longest_run_is_found_at_both_ends_and_between():
    for said, expected in (
        ("..xx.x", (2, 2)),
        ("xxx.xx", (0, 3)),
        ("x.xx", (2, 2)),
        ("xx.xx", (0, 2)),
        ("...", (0, 0)),
    ):
        assert longest_run(np.array([each == "x" for each in said])) == expected


def test_a_fault_is_evaluated_on_the_images_from_its_beginning_on():
    n, begin = 200, 40
    times_ns, truth = 100_000_000 * np.arange(n, dtype=np.int64), Poses.identity(n)
    off_m = np.zeros(n)
    off_m[60:80] = 1.0  # wrong, and sure of it for 15 images
    status = np.array(["ambiguous"] * n)
    status[begin:75] = "converged"
    status[75:90] = "lost"
    modes = [(Mode(translated([[x, 0.0, 0.0]])[0], np.eye(6), 1.0),) for x in off_m]
    found = evaluate_fault(Belief(modes, status.tolist()), times_ns, truth, begin, range(begin, begin + 50))
    assert found == {
        "success": True,
        "right": 140 / 160,
        "right_after": 1.0,
        "converged": 35 / 160,
        "lost": 15 / 160,
        "noticed": 15 / 20,
        "lost_ever": 15 / 200,
        "sure_and_wrong": 15 / 160,
        "longest_s": pytest.approx(1.5),
        "longest_at_s": 6.0,
    }


def evaluated(**more) -> dict:
    fractions = dict.fromkeys(
        ("right", "right_after", "converged", "lost", "noticed", "lost_ever", "sure_and_wrong"), 0.5
    )
    return {"success": True, **fractions, "longest_s": 0.0, "longest_at_s": None, **more}


def test_a_summary_averages_fractions_and_names_the_walks_that_failed():
    results = [
        {"name": name, "scene": "ceiling", "fault": fault, "begin": 50, "methods": {"filter": found}}
        for name, fault, found in (
            ("b", "black", evaluated(right=1.0, noticed=None, longest_s=1.2, longest_at_s=7.0)),
            ("a", "black", evaluated(right=0.0, success=False, longest_s=0.9, longest_at_s=3.0)),
            ("a", NONE, evaluated()),
            ("b", NONE, evaluated()),
        )
    ]
    summary = summarise_faults(results)
    assert list(summary["ceiling"]) == [NONE, "black"]
    total = summary["ceiling"]["black"]
    assert total["walks"] == 2
    ours = total["methods"]["filter"]
    assert (ours["successes"], ours["right"], ours["noticed"], ours["longest_s"]) == (1, 0.5, 0.5, 1.2)
    assert ours["unsuccessful"] == ["a"]
    assert ours["sure_and_wrong_walks"] == {"b": [7.0, 1.2]}
