"""The page of one run: `report.html`."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from filtering.errors import listed
from vapor.evaluation.trajectory import RIGHT, THRESHOLDS
from vapor.reporting.calibration import LEAST_IMAGES, calibration_table
from vapor.reporting.html.drawings import plan, reliability, status_strip
from vapor.reporting.html.landmark_picture import landmark_caption, landmark_picture
from vapor.reporting.html.page import Block, Page, code, folded, paragraph, picture, section, table
from vapor.reporting.html.run_figures import belief_plot, error_plot, run_scene
from vapor.reporting.next_steps import next_steps
from vapor.reporting.record import RunRecord
from vapor.reporting.report import method_table
from vapor.tracking.methods import METHODS, in_order

_NAMED = 2  # times at which the camera was carried off
_LIMIT_M, _LIMIT_DEG = THRESHOLDS[RIGHT]
_WITHIN = f"within {_LIMIT_M:g} m and {_LIMIT_DEG:g}° of the truth"


def run_page(
    record: RunRecord,
    report: Mapping[str, Any],
    *,
    title: str,
    settings: Mapping[str, Any],
    notices: Sequence[str] = (),
    command: str = "",
) -> Page:
    """The page of a run, with its report, the name of its sequence, the content of `config.json`, and its command."""
    steps, others = next_steps(report, notices)
    sections = _sections(record, report, settings, command)
    return Page(title, _asked(report, settings), verdict(report, record), sections, others, steps)


def _asked(report: Mapping[str, Any], settings: Mapping[str, Any]) -> str:
    """The question of the page: images, model, odometry, and whether these are synthetic or simulated."""
    sequence = settings.get("sequence", {})
    kind = "synthetic images" if str(sequence.get("image_source")).startswith("synthetic") else "images"
    model = settings.get("model", {}).get("name")
    asked = f"{report['frames']} {kind} in {report['duration_s']:.0f} s, localized{f' by {model}' if model else ''}"
    odometry = sequence.get("motion") or sequence.get("odometry", settings.get("odometry"))
    if odometry is None:
        return asked
    kind = odometry.partition(": ")[0]  # of simulated odometry, the noise
    return f"{asked}. Odometry: {kind if kind.startswith('simulated') else odometry}"


def verdict(report: Mapping[str, Any], record: RunRecord) -> str:
    """The result of a run, in a sentence or two."""
    if "filter" not in report:
        sure = [index for index, status in enumerate(record.status) if status == "converged"]
        found = "Never sure where it is"
        if sure:
            first_s = int(record.times_ns[sure[0]] - record.times_ns[0]) / 1e9
            found = f"Sure in {100 * len(sure) / len(record.status):.0f} % of the images, first after {first_s:.1f} s"
        return f"{found}. There are no true poses to compare with."
    found, consistency = filter_sentence(report).removesuffix("."), report["consistency"]
    if consistency["images"] == 0:
        return f"{found}; never sure."
    if consistency["wrong"] == 0.0:
        return f"{found}; never sure and wrong."
    wrong = round(consistency["wrong"] * consistency["images"])
    return f"{found}; sure and wrong in {wrong} of the {consistency['images']} images that it called converged."


def filter_sentence(report: Mapping[str, Any]) -> str:
    """How good the filter was against true poses, in a sentence."""
    metrics = report["filter"]
    off = f"{100 * metrics['median_translation_m']:.1f} cm and {metrics['median_rotation_deg']:.1f}° off in the median"
    if metrics["converged_at_s"] is None:
        part = 100 * metrics["recall"][RIGHT]
        return f"It did not find the right place for good: {part:.0f} % of the images are right, {_WITHIN}."
    since = "the first image" if metrics["converged_at_s"] == 0.0 else f"{metrics['converged_at_s']:.1f} s"
    return f"Right from {since} on, {off}."


def _sections(record: RunRecord, report: Mapping[str, Any], settings: Mapping[str, Any], command: str) -> list[Block]:
    sections = [section("Trajectory and belief", [run_scene(record)])]
    over_time: list[Block] = [status_strip(record)]
    if (errors := error_plot(record)) is not None:
        columns, rows = method_table(report)
        ours = [number for number, row in enumerate(rows) if row[0] == METHODS["filter"].label]
        caption = "Medians, and the fraction of images within both limits; no trajectory was aligned"
        sections.append(section("Errors", [table(columns, rows, caption, ours)]))
        over_time.append(errors)
    sections.append(section("Over time", [*over_time, belief_plot(record)]))
    if record.outline is not None:
        sections.append(section("From above", [plan(record, record.outline)]))
    if "verified" in report:
        sections.append(section("Landmarks", _landmarks(record, report)))
    if (trust := _trust(report)) is not None:
        sections.append(section("Calibration of the uncertainty", trust))
    if report.get("storeys") is not None:
        sections.append(section("Storeys", _storeys(report["storeys"])))
    missing = settings.get("sequence", {}).get("no_odometry")
    why = [paragraph(f"No odometry is recorded: {missing}.")] if missing else []
    sections.append(section("Inputs and resources", [_counts(report), *why]))
    blocks = [code(command)] if command else []
    versions = settings.get("versions", {})
    rows = [(name, str(version)) for name, version in versions.items()]
    blocks.append(folded("Versions", [table(("", "version"), rows, "Versions", words=True)]))
    rest = {name: value for name, value in settings.items() if name != "versions"}
    blocks.append(folded("Settings", [code(json.dumps(rest, indent=2))]))
    sections.append(section("How it was made", blocks))
    return sections


def _landmarks(record: RunRecord, report: Mapping[str, Any]) -> list[Block]:
    inliers = report["inliers"]
    median = "" if inliers is None else f" In the median {inliers:.0f} landmarks agree with the pose of such an image."
    blocks: list[Block] = [
        paragraph(
            f"Landmarks verified a place in {100 * report['verified']:.0f} % of the images: from there they are seen"
            f" where the image shows them, and the pose is as sharp as that.{median}"
        )
    ]
    if (shown := record.landmarks) is not None:
        seconds = int(record.times_ns[shown.number] - record.times_ns[0]) / 1e9
        alt = "An image with its features, and the landmarks among them"
        blocks.append(picture(landmark_picture(shown), alt, landmark_caption(shown, seconds)))
    return blocks


def _trust(report: Mapping[str, Any]) -> list[Block] | None:
    if "consistency" not in report:
        return None
    weights = [
        reliability(report["reliability"]),
        paragraph(
            "Images by the weight that the filter gave its best mode, and the fraction of them in which that mode is"
            f" {_WITHIN}. Dots lie on the line where weights are probabilities, and above it where the filter is more"
            " careful than it need be. Neighbouring images share their errors, so few of them are independent."
        ),
    ]
    columns, rows = calibration_table(report)
    if not rows:
        few = f"Fewer than {LEAST_IMAGES} images are converged: too few to say whether the stated regions are true."
        return [paragraph(few), *weights]
    ours = [number for number, row in enumerate(rows) if row[0] == METHODS["filter"].label]
    return [
        table(columns, rows, "True poses in the stated regions", ours),
        paragraph(
            "Of the filter the images that it called converged count, of poses in hindsight those that images fit and"
            " at one place only. A region is the smallest part of the stated distribution with that probability. NEES,"
            " the normalised estimation error squared, is larger than 5.35 where errors are larger than stated. Wrong"
            f" poses are not {_WITHIN}."
        ),
        *weights,
    ]


def _storeys(storeys: Mapping[str, Any]) -> list[Block]:
    rows = [
        (f"storey {number}, {height:.1f} m", f"{100 * part:.1f} %")
        for number, (height, part) in enumerate(zip(storeys["heights_m"], storeys["belief"], strict=True))
    ]
    sure = f"Sure of its storey, by 95 % and more, after {100 * storeys['sure']:.0f} % of the images"
    if (wrong := storeys.get("sure_and_wrong")) is not None:
        sure += f", of these wrong: {100 * wrong:.1f} %"
    blocks: list[Block] = [paragraph(f"{sure}.")]
    if "accuracy" in storeys:
        right = [(METHODS[name].label, f"{100 * part:.0f} %") for name, part in in_order(storeys["accuracy"]).items()]
        ours = [number for number, row in enumerate(right) if row[0] == METHODS["filter"].label]
        blocks.append(table(("", "right storey"), right, "Images on the right storey", ours))
        blocks.append(
            paragraph(
                "On stairs the storey changes at one height. There a pose some centimetres from the truth, right by all"
                " limits, may be on the other storey."
            )
        )
    return [*blocks, table(("", "belief"), rows, "Belief after the last image, by storey and height of the camera")]


def _counts(report: Mapping[str, Any]) -> Block:
    step = report["step_ms"]
    rows = [("images localized", str(report["frames"])), ("with a true pose", str(report["frames_with_true_pose"]))]
    rows += [
        (f"of {name}", f"{each['images']}" + (f", {each['left_out']} left out" if each["left_out"] else ""))
        for name, each in report.get("cameras", {}).items()
    ]
    rows += [(f"skipped, {reason}", str(number)) for reason, number in report["skipped"].items()]
    rows += [
        ("hypotheses, median", str(report["particles"])),
        ("a step, median and 95 %", f"{step['p50']:.1f} and {step['p95']:.1f} ms"),
    ]
    if report["smoothed_doubtful"] is not None:
        rows.append(("smoothed poses that images do not fit", str(report["smoothed_doubtful"])))
    if (hindsight := report["hindsight"]) is not None:
        rows.append(("smoothed poses of two possible places", str(hindsight["ambiguous"])))
        if carried_off := hindsight["carried_off_s"]:
            named = listed((f"{each:.1f} s" for each in carried_off), _NAMED)
            rows.append(("carried off, in hindsight, after", named))
    if report["peak_rss_mb"] is not None:
        rows.append(("peak memory", f"{report['peak_rss_mb']:.0f} MB"))
    return table(("", ""), rows, "Images, time and memory")
