"""The page of many runs with one model: `summary.html`."""

from __future__ import annotations

import os
from collections import Counter, defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from urllib.parse import quote

import numpy as np
from jaxtyping import Float64

from filtering.storeys import Storeys, up_axis
from vapor.checkpoints.checkpoint import ModelDescription
from vapor.reporting.html.page import Block, Page, code, folded, paragraph, section, table
from vapor.reporting.html.plans import Plans, dots, line
from vapor.reporting.next_steps import MOST_STEPS, MOVE_ON
from vapor.reporting.outcome import STATES, Outcome, said_of_training, total
from vapor.reporting.outline import Outline

_WORDS: Mapping[str, str] = {
    "right": "converged and right",
    "converged": "converged, true pose unknown",
    "ambiguous": "ambiguous",
    "lost": "lost",
    "wrong": "converged and wrong",
}
_GOOD = ("right", "converged")
_SHOWN = 50  # recordings of a table that is not folded
_CELLS = 12  # along the longer side of a plan
_MOST_AREAS, _LEAST_RECORDINGS, _BAD = 5, 2, 0.5  # areas listed; recordings not right there, and the part of the images


@dataclass(frozen=True)
class Site:
    """The place of many runs: its outline, its storeys (None for one), and the axis of the map that is up."""

    outline: Outline
    storeys: Storeys | None
    up: Float64[np.ndarray, "3"]

    @staticmethod
    def of_model(model: ModelDescription, storeys: Storeys | None) -> Site:
        """What a model knows of its place."""
        return Site(Outline.of_model(model), storeys, up_axis(model.prior_poses))


@dataclass(frozen=True)
class Area:
    """A square where it was mostly not sure, or wrong: its letter, plan, corner in units of the drawing, middle in the
    map (metres).

    `state` is the most frequent one of such images, which are the fraction `failed`; `recordings` are the names of
    those that have any there.
    """

    letter: str
    plan: int
    corner: tuple[int, int]
    middle_m: Float64[np.ndarray, "3"]
    state: str
    failed: float
    recordings: tuple[str, ...]


def summary_page(outcomes: Sequence[Outcome], site: Site, model: str, *, of: int, command: str = "") -> Page:
    """The page of the recordings done so far, of so many in all; their reports are in folders of their names beside."""
    localized = [outcome for outcome in outcomes if outcome.error is None]
    failed = [outcome for outcome in outcomes if outcome.error is not None]
    sections: list[Block] = []
    steps: list[tuple[str, str]] = []
    if localized:
        good = [positions for outcome in localized if len(positions := _positions(outcome, _GOOD))]
        plans = Plans.of(site.outline, np.concatenate([np.empty((0, 3)), *good]), site.storeys, site.up)
        areas = _areas(localized, plans)
        sections.append(section("Where it was not sure, or wrong", _map(localized, plans, areas)))
        sections.append(section("Recordings, the worst first", _recordings(localized)))
        of_areas = _of_areas(areas)
        steps = [*of_areas, *(step for step in _of_runs(localized) if step[0] not in dict(of_areas))]
    if failed:
        rows = [(outcome.name, str(outcome.error)) for outcome in failed]
        sections.append(section("Not localized", [table(("recording", "reason"), rows, "Recordings", words=True)]))
    if command:
        sections.append(section("How it was made", [code(command)]))
    notices = [] if len(outcomes) == of else [f"{of - len(outcomes)} of {of} recordings are not done: the run ended."]
    title = f"{of} recording{'s' * (of != 1)}"
    return Page(title, f"Localized by {model}", _verdict(outcomes), sections, notices, steps[:MOST_STEPS])


def _verdict(outcomes: Sequence[Outcome]) -> str:
    summed = total(outcomes)
    poor = len(outcomes) - summed["failed"] - summed["went_well"]
    parts = [f"{summed['went_well']} of {len(outcomes)} recordings went well"]
    parts += [f"{poor} did not"] if poor else []
    parts += [f"{summed['failed']} could not be localized at all"] if summed["failed"] else []
    judged = [outcome for outcome in outcomes if outcome.success is not None]
    wrong = sum(outcome.images * outcome.states.get("wrong", 0.0) for outcome in judged)
    sure = wrong + sum(outcome.images * outcome.states.get("right", 0.0) for outcome in judged)
    words = [f"{', '.join(parts)}.", *filter(None, [said_of_training(outcomes)])]
    words += [f"Of {round(sure)} images that it called converged {round(wrong)} are wrong."] if sure else []
    return " ".join(words)


def _positions(outcome: Outcome, states: Collection[str]) -> Float64[np.ndarray, "k 3"]:
    visited = zip(outcome.visited.positions_m, outcome.visited.states, strict=True)
    return np.reshape([position for position, state in visited if state in states], (-1, 3)).astype(float)


def _map(outcomes: Sequence[Outcome], plans: Plans, areas: Sequence[Area]) -> list[Block]:
    """Where the cameras were, by state, the worst on top; a click on a point leads to the report."""
    marks: dict[int, str] = defaultdict(str)
    shown: Counter[str] = Counter()
    outside = 0
    for state in STATES:
        for outcome in outcomes:
            positions = _positions(outcome, [state])
            inside, on = plans.shows(positions), plans.storey(positions)
            outside += int((~inside).sum())
            shown[state] += int(inside.sum())
            for number in np.unique(on[inside]).tolist():
                d = dots(np.unique(plans.drawn(positions[inside & (on == number)]).round(), axis=0))
                marks[number] += (
                    f'<a href="{_report(outcome)}" tabindex="-1"><title>{escape(f"{outcome.name}: {_WORDS[state]}")}'
                    f"</title>{line(state, d)}</a>"
                )
    for area in areas:
        x, y = area.corner
        side = round(_side(plans))
        marks[area.plan] += (
            f'<rect class="area" x="{x}" y="{y}" width="{side}" height="{side}"/>'
            f'<text class="area" x="{x + 6}" y="{y + side - 6}">{area.letter}</text>'
        )
    key = [(state, _WORDS[state]) for state in STATES if shown[state]]
    blocks = [plans.block(marks, key, "Where the cameras were", "group")] if marks else []
    known = [outcome.visited.are_true for outcome in outcomes]
    guesses = "estimated positions, which are guesses where it is lost"
    words = "true positions" if all(known) else f"true positions where they are known, else {guesses}"
    words = words if any(known) else guesses
    note = f"Points are {words}; a click on one leads to its report."
    lie = "point lies" if outside == 1 else "points lie"
    note += f" {outside} {lie} outside of the plan, as in another place or frame." if outside else ""
    return [*blocks, paragraph(note), *_area_table(areas, plans)]


def _areas(outcomes: Sequence[Outcome], plans: Plans) -> list[Area]:
    """Squares, no two side by side, with half of the images and more not sure, or wrong, of two recordings and more."""
    side_m = _side(plans) / plans.scale
    images: dict[tuple[int, ...], dict[str, float]] = defaultdict(lambda: dict.fromkeys(STATES, 0.0))
    failing: dict[tuple[int, ...], dict[str, None]] = defaultdict(dict)
    for outcome in outcomes:
        # A lost camera without a true pose may be anywhere.
        states = [state for state in STATES if outcome.visited.are_true or state != "lost"]
        weight = outcome.images / max(1, len(outcome.visited.states))
        for state in states:
            positions = _positions(outcome, [state])
            positions = positions[plans.shows(positions)]
            cells = np.floor((plans.on_plan(positions) - plans.low_m) / side_m).astype(int)
            for cell in np.column_stack([plans.storey(positions), cells]).tolist():
                images[*cell][state] += weight
                if state not in _GOOD:
                    failing[*cell][outcome.name] = None
    found = []
    for cell, names in failing.items():
        bad = {state: images[cell][state] for state in STATES if state not in _GOOD}
        part = sum(bad.values()) / sum(images[cell].values())
        if part >= _BAD and len(names) >= _LEAST_RECORDINGS:
            found.append((len(names), part, cell, max(bad, key=bad.__getitem__)))
    areas: list[Area] = []
    taken: list[tuple[int, ...]] = []
    for _, part, cell, state in sorted(found, reverse=True):
        beside = any(cell[0] == other[0] and np.abs(np.subtract(cell, other)).max() <= 1 for other in taken)
        if beside or len(areas) == _MOST_AREAS:
            continue
        taken.append(cell)
        letter, corner = chr(ord("A") + len(areas)), np.round(np.multiply(cell[1:], _side(plans))).astype(int)
        middle_m = plans.in_map(plans.low_m + side_m * (np.array(cell[1:]) + 0.5))
        areas.append(Area(letter, cell[0], tuple(corner.tolist()), middle_m, state, part, tuple(failing[cell])))
    return areas


def _side(plans: Plans) -> float:
    """Of an area, in units of the drawing."""
    return plans.scale * float(plans.size_m.max()) / _CELLS


def _area_table(areas: Sequence[Area], plans: Plans) -> list[Block]:
    if not areas:
        return []
    rows = [
        (
            area.letter,
            *([plans.name(area.plan)] if plans.storeys else []),
            ", ".join(
                f"{name} {at:.1f}" for name, at, up in zip("xyz", area.middle_m, plans.up, strict=True) if not up
            ),
            f"{100 * area.failed:.0f} %",
            _WORDS[area.state],
            str(len(area.recordings)),
        )
        for area in areas
    ]
    columns = (
        "area",
        *(["storey"] if plans.storeys else []),
        "middle, m",
        "not sure, or wrong",
        "most are",
        "recordings",
    )
    return [table(columns, rows, "Areas where in at least half of the images it was not sure, or wrong")]


def _of_areas(areas: Sequence[Area]) -> list[tuple[str, str]]:
    """What to do about areas: an action, and its reason."""
    actions = {
        "Record these parts of the place again, and train with them, too.": ("lost", "wrong"),
        MOVE_ON: ("ambiguous",),
    }
    steps = []
    for action, states in actions.items():
        those = [area for area in areas if area.state in states]
        named = ", ".join(f"{area.letter} ({len(area.recordings)} recordings)" for area in those)
        if those:
            words = " or ".join(_WORDS[state] for state in states if any(area.state == state for area in those))
            steps.append((action, f"Most images are {words} in these areas of the plan: {named}."))
    return steps


def _of_runs(outcomes: Sequence[Outcome]) -> list[tuple[str, str]]:
    """What the runs ask for, that of most runs first, with one of the reasons."""
    reasons: dict[str, dict[str, str]] = defaultdict(dict)
    for outcome in sorted(outcomes, key=_badness):
        for action, reason in outcome.steps:
            reasons[action].setdefault(outcome.name, reason)
    most_first = sorted(reasons.items(), key=lambda each: -len(each[1]))
    return [
        (action, f"{len(runs)} of {len(outcomes)} recordings ask for it; {name}: {reason}")
        for action, runs in most_first
        for name, reason in [next(iter(runs.items()))]
    ]


def _badness(outcome: Outcome) -> tuple[bool, float, float]:
    return outcome.went_well, -outcome.states.get("wrong", 0.0), sum(outcome.states.get(state, 0.0) for state in _GOOD)


def _recordings(outcomes: Sequence[Outcome]) -> list[Block]:
    states = [state for state in STATES if any(state in outcome.states for outcome in outcomes)]
    has_truth = any(outcome.success is not None for outcome in outcomes)
    columns = ["recording", "went well", "images", *(_WORDS[state].replace(", ", ",\n") for state in states)]
    columns += ["at the end", *(["median error"] if has_truth else [])]
    rows, links = [], {}
    for outcome in sorted(outcomes, key=_badness):
        parts = [f"{100 * outcome.states.get(state, 0.0):.0f} %" for state in states]
        off = outcome.median_translation_m
        error = "" if off is None else f"{off:.2f} m  {outcome.median_rotation_deg:.1f}°"
        row = [
            outcome.name,
            f"{'yes' if outcome.went_well else 'no'}{', trained on' if outcome.trained_on else ''}",
            str(outcome.images),
            *parts,
            str(outcome.final_status),
        ]
        rows.append([*row, *([error] if has_truth else [])])
        links[outcome.name] = _report(outcome)
    well = "Went well: " + (
        "with true poses, it found the place and kept it; without, it was sure of it at the end."
        if has_truth
        else "it was sure of the place at the end. There are no true poses to compare with."
    )
    shown = _SHOWN if len(rows) > _SHOWN + 1 else len(rows)
    first = table(columns, rows[:shown], "Each with a link to its report", links=links)
    more = table(columns, rows[shown:], "The others", links=links)
    others = [folded(f"{len(rows) - shown} more", [more])] if rows[shown:] else []
    return [paragraph(well), first, *others]


def _report(outcome: Outcome) -> str:
    return f"{quote(os.fsencode(outcome.name))}/report.html"
