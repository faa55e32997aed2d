"""The page of many runs: how many went well, where they failed, and what to do next."""

import os
import re
from dataclasses import replace

import numpy as np
import pytest

from filtering.storeys import Storeys
from tests.helpers.pages import ReadPage
from vapor.commands.run import show_outcomes
from vapor.reporting.html.page import write_page
from vapor.reporting.html.summary_page import Site, summary_page
from vapor.reporting.outcome import Outcome, Visited
from vapor.reporting.outline import Outline

CORNERS = [[x, y, z] for x in (0.0, 20.0) for y in (0.0, 10.0) for z in (1.6, 4.6)]
SITE = Site(Outline(np.array(CORNERS * 100, np.float32), "landmarks"), Storeys((1.6, 4.6)), np.array([0.0, 0.0, 1.0]))
ADVICE = ("Look at the wheels.", "They slip.")


def outcome(name: str, states: dict[str, int], at: tuple[float, float, float], **others) -> Outcome:
    """So many images in each state, all at one place."""
    count = sum(states.values())
    each = tuple(state for state, number in states.items() for _ in range(number))
    visited = Visited((at,) * count, each, are_true=True)
    status = {"converged": sum(states.get(state, 0) for state in ("right", "converged", "wrong")) / count}
    fractions = {state: number / count for state, number in states.items()}
    given = {"success": not {"lost", "wrong"} & set(states), "median_translation_m": 0.1, "median_rotation_deg": 1.0}
    given |= {"images": count, "status": status, "states": fractions, "final_status": "converged", "visited": visited}
    return Outcome(name, f"{name}.mcap", **{**given, **others})


FLEET = [
    outcome("fine", {"right": 10}, (4.0, 3.0, 1.6)),
    outcome("gone", {"lost": 10}, (15.0, 8.0, 4.6), steps=(ADVICE,)),
    outcome("gone-too", {"lost": 9, "right": 1}, (15.1, 8.1, 4.6), steps=(ADVICE,)),
    outcome("sure", {"wrong": 10}, (4.0, 3.0, 1.6)),
    outcome("elsewhere", {"lost": 10}, (900.0, 3.0, 1.6)),
    Outcome("cut", "cut.mcap", error="cut.mcap: truncated <here>"),
]


def page_of(outcomes, site=SITE, **options) -> str:
    return summary_page(outcomes, site, "place.safetensors", of=options.pop("of", len(outcomes)), **options).html()


def rows_of(page: str) -> list[str]:
    return re.findall(r'<th scope="row"><a href="[^"]*">([^<]*)</a>', page)


def test_the_verdict_counts_what_went_well_what_did_not_and_what_was_not_localized():
    words = ReadPage.of(page_of(FLEET)).words
    assert "1 of 6 recordings went well, 4 did not, 1 could not be localized at all." in words
    assert "Of 21 images that it called converged 10 are wrong." in words
    assert "cut.mcap: truncated <here>" in words
    assert "are not done" not in words


def test_recordings_with_images_of_the_training_are_named_on_the_page_and_in_the_last_lines(tmp_path, capsys):
    (found, notice) = FLEET[0], "4 of 10 images were trained on: the model remembers them"
    fleet = [replace(found, name="seen", notices=(notice,)), replace(found, name="new"), FLEET[1]]
    page = ReadPage.of(page_of(fleet))
    assert "2 of 3 recordings went well, 1 did not. The model was trained on images of 1 of these: seen." in page.words
    assert "seenyes, trained on10" in page.words
    assert "newyes10" in page.words
    assert "trained on" not in page_of(fleet[1:])
    show_outcomes(fleet, tmp_path)
    *_, closing, _, said = capsys.readouterr().out.splitlines()
    assert closing.endswith("; success in 2 of 3")
    assert said == "The model was trained on images of 1 of these: seen."
    show_outcomes(fleet[1:], tmp_path)
    assert "trained on" not in capsys.readouterr().out


def test_recordings_are_listed_from_the_worst_and_lead_to_their_reports():
    page = page_of(FLEET)
    assert rows_of(page) == ["sure", "gone", "elsewhere", "gone-too", "fine"]
    assert 'href="gone-too/report.html"' in page
    odd = page_of([replace(FLEET[0], name='a "b"#1')])
    assert 'href="a%20%22b%22%231/report.html"' in odd


def test_the_last_of_many_recordings_is_not_folded_alone():
    def folded(count: int) -> list[str]:
        page = page_of([outcome(f"walk-{i}", {"right": 3}, (0.0, 0.0, 1.6)) for i in range(count)])
        return re.findall(r"<summary>(\d+ more)</summary>", page)

    assert folded(51) == []
    assert folded(52) == ["2 more"]


def test_one_recording_and_one_point_outside_are_not_several():
    words = ReadPage.of(page_of([outcome("elsewhere", {"lost": 1}, (900.0, 3.0, 1.6))])).words
    assert words.startswith("1 recording - ")
    assert " 1 point lies outside of the plan" in words


def test_a_name_that_is_no_text_leads_to_its_report_too(tmp_path):
    name = os.fsdecode(b"walk-\xff")
    page = summary_page([replace(FLEET[0], name=name)], SITE, "place.safetensors", of=1)
    write_page(tmp_path / "summary.html", page)
    written = (tmp_path / "summary.html").read_text(encoding="utf-8")
    assert 'href="walk-%FF/report.html">walk-?</a>' in written


def test_each_image_is_a_point_where_it_was_on_its_storey_in_the_colour_of_its_state():
    plans = re.findall(r"<svg.*?</svg>", page_of(FLEET))
    assert len(plans) == 2
    kinds = [set(re.findall(r'<path class="(\w+)"', plan)) - {"points", "bar"} for plan in plans]
    assert kinds == [{"right", "wrong"}, {"lost", "right"}]
    corners = np.array(re.findall(r"M(\d+) (\d+)h0", plans[0].split('class="points"')[1].split('"/>')[0]), float)
    ((x, y),) = re.findall(r'<path class="wrong" d="M(\d+) (\d+)h0"', plans[0])
    scale = np.ptp(corners[:, 0]) / 20.0
    np.testing.assert_allclose(
        [float(x), float(y)], corners.min(axis=0) + scale * np.array([4.0, 10.0 - 3.0]), atol=2.0
    )
    assert "10 points lie outside of the plan" in ReadPage.of(page_of(FLEET)).words


def test_where_several_recordings_failed_is_an_area_to_record_again():
    page = page_of(FLEET)
    cells = ReadPage.of(page).cells
    area = cells.index("A")
    assert cells[area + 1] == "storey 1, 4.6 m"
    middle = [float(number) for number in re.findall(r"[\d.]+", cells[area + 2])]
    np.testing.assert_allclose(middle, [15.0, 8.0], atol=20.0 / 12)
    assert cells[area + 3 : area + 6] == ["95 %", "lost", "2"]
    assert "B" not in cells  # one recording alone failed elsewhere, beside one that did not
    words = ReadPage.of(page).words
    assert "Record these parts of the place again, and train with them, too." in words
    assert "A (2 recordings)" in words


def test_the_actions_that_most_runs_ask_for_come_first():
    words = ReadPage.of(page_of(FLEET)).words
    assert "Look at the wheels. 2 of 5 recordings ask for it; gone: They slip." in words
    other = replace(FLEET[3], steps=(("Do something else.", "Once."),))
    words = ReadPage.of(page_of([*FLEET[:3], other])).words
    assert words.index("Look at the wheels.") < words.index("Do something else.")


def test_without_true_poses_the_status_at_the_end_decides_and_lost_positions_are_no_areas():
    blind = [
        replace(
            each,
            success=None,
            median_translation_m=None,
            final_status=status,
            visited=replace(each.visited, are_true=False),
        )
        for each, status in ((FLEET[1], "lost"), (FLEET[2], "lost"), (FLEET[0], "converged"))
    ]
    words = ReadPage.of(page_of(blind)).words
    assert "1 of 3 recordings went well, 2 did not." in words
    assert "called converged" not in words
    assert "There are no true poses to compare with." in words
    assert "estimated positions, which are guesses where it is lost" in words
    assert "Record these parts" not in words


def test_a_run_that_was_ended_says_how_many_are_left_and_one_of_failures_has_a_page():
    assert "3 of 9 recordings are not done" in ReadPage.of(page_of(FLEET, of=9)).words
    words = ReadPage.of(page_of([FLEET[-1]])).words
    assert "0 of 1 recordings went well, 1 could not be localized at all." in words


def test_a_place_of_one_storey_has_one_plan_even_where_nothing_went_well():
    page = page_of([FLEET[1]], replace(SITE, storeys=None))
    assert page.count("<svg") == 1
    assert "storey" not in ReadPage.of(page).words


@pytest.mark.parametrize("count", [200])
def test_the_page_of_many_recordings_is_small(count):
    rng = np.random.default_rng(0)
    states = ("right", "ambiguous", "lost", "wrong")
    fleet = []
    for number in range(count):
        positions = tuple(map(tuple, (rng.random((100, 3)) * [20.0, 10.0, 6.0]).round(2).tolist()))
        visited = Visited(positions, tuple(rng.choice(states, 100).tolist()), are_true=True)
        fleet.append(replace(FLEET[0], name=f"walk-{number}", visited=visited))
    page = page_of(fleet)
    assert len(page) < 2_000_000
    assert len(rows_of(page)) == count
