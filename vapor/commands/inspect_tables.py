"""Tables and lines that `vapor-track inspect` prints."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from rich.table import Table

from sequences.reading.counts import ImageCounts
from vapor.commands.console import count_images, show, show_notices, skipped_lines
from vapor.inspection.camera import CameraCheck
from vapor.inspection.clocks import ImageClock
from vapor.inspection.coverage import Coverage, height
from vapor.inspection.inspect import Inspection
from vapor.inspection.predictions import Predictions
from vapor.inspection.walk import Walk

_NAMED = 8  # of a kind, at most


@dataclass(frozen=True)
class Part:
    """A heading, a table if any, and lines."""

    title: str
    lines: Sequence[str]
    table: Table | None = None


def show_inspection(found: Inspection) -> None:
    """Print all findings, the verdict last."""
    for part in parts(found):
        if part.table is None:
            show(f"\n{part.title}")
        else:
            show(part.table)
        show_notices(part.lines)


def parts(found: Inspection) -> Iterator[Part]:
    """All findings, the verdict last."""
    yield _walks(found.walks)
    if found.coverage is not None:
        yield Part("Coverage", [*_coverage_lines(found, found.coverage)])
    yield Part("Odometry", [*_odometry_lines(found), *_clock_lines(found.clocks)])
    if views := [*_view_lines(found.walks)]:
        yield Part("Images against poses", views)
    yield Part("Camera", [*_camera_lines(found.camera)])
    if found.predictions is not None:
        yield Part("The model", [*_model_lines(found.predictions, found.coverage)])
    yield Part("Verdict", [f"{number}. {sentence}" for number, sentence in enumerate(found.verdict, 1)])


def _first(items: Sequence[str]) -> str:
    return ", ".join(items[:_NAMED]) + (", ..." if len(items) > _NAMED else "")


def _walks(walks: Sequence[Walk]) -> Part:
    title = f"{len(walks)} recordings" if len(walks) > 1 else "1 recording"
    table = Table(title=title, title_justify="left")
    table.add_column("", overflow="fold")
    for name in ("images", "posed", "seconds", "Hz", "pixels", "path", "sharp", "blurred", "dark", "blown"):
        table.add_column(name, justify="right", no_wrap=True)
    for walk in walks:
        figures = walk.as_json()
        rate = figures["rate_hz"]
        table.add_row(
            walk.name,
            str(len(walk)),
            str(len(walk.poses)),
            f"{figures['duration_s']:.1f}",
            "?" if rate is None else f"{rate:.3g}",
            ", ".join(f"{w}x{h}" for w, h in walk.sizes),
            "?" if walk.path_m is None else f"{walk.path_m:.1f} m",
            f"{figures['sharpness']:.0f}",
            *(f"{100 * figures[name]:.0f} %" for name in ("blurred", "dark", "blown_out")),
        )
    table.caption = "sharp: variance of the Laplacian at 240 pixels; blurred: below 0.3 of the recording's median"
    table.caption_justify = "left"
    lines = [f"{walk.name}: {line}" for walk in walks for line in _walk_lines(walk)]
    lines += dict.fromkeys(notice for walk in walks for notice in walk.notices)
    counts = [walk.counts for walk in walks if walk.counts is not None]
    if counts:
        lines.append(f"images     {count_images(sum(counts, ImageCounts(0)).as_json())}")
    sources = {id(walk.skipped): walk.skipped for walk in walks}
    lines += skipped_lines(sum((Counter(skipped) for skipped in sources.values()), Counter()))
    return Part(title, lines, table)


def _walk_lines(walk: Walk) -> Iterator[str]:
    if walk.assumed_hz is not None:
        yield f"has no stamps: {walk.assumed_hz} Hz assumed, gaps cannot be seen"
    if "true poses" in walk.lacks:
        yield f"no true poses: {walk.lacks['true poses']}"
    if gaps := [f"{long_s:.2f} s at {at_s:.1f} s" for at_s, long_s in walk.gaps]:
        yield f"{len(gaps)} gaps between images: {_first(gaps)}"
    if frozen := [f"{begin} to {end}" for begin, end in walk.frozen]:
        yield f"one and the same image: {_first(frozen)}"
    if jumps := [str(index) for index in walk.as_json()["brightness_jumps"]]:
        yield f"suddenly brighter or darker at images {_first(jumps)}"


def _coverage_lines(found: Inspection, coverage: Coverage) -> Iterator[str]:
    others, what = coverage.others, "recording" if coverage.by_recordings else "pass"
    shown = [f"{100 * float((others == i).mean()):.0f} % by {i or 'none'}" for i in np.unique(others).tolist()]
    if not coverage.by_recordings:
        shown = [f"{100 * float((others > 0).mean()):.0f} %"]
    yield (
        f"of {len(others)} images another {what} shows the same ground (within {coverage.split.near_m:.2g} m and 45°):"
        f" {', '.join(shown)}"
    )
    segments = coverage.alone()
    for segment in segments[:_NAMED]:
        yield f"{segment} are shown by no other {what}"
    if len(segments) > _NAMED:
        yield f"and {len(segments) - _NAMED} shorter ones"
    storeys = coverage.storeys()
    for number, storey in reversed(list(enumerate(storeys, 1))):
        count = len(storey.names)
        who = f"{storey.names[0]} alone" if count == 1 else f"{count} of {len(coverage.images.names)} recordings"
        late = f", only in their last {100 * storey.late:.0f} %" if storey.late is not None else ""
        trained = f", {storey.trained} of them trained on" if coverage.split.held_out_mask.any() and count > 1 else ""
        yield (
            f"storey {number} of {len(storeys)} ({height(storey.low_m, storey.high_m)}): {storey.images} images,"
            f" shown by {who}{late}{trained}"
        )
    yield from found.notices
    for note in coverage.split.notes:
        yield f"`train` would report: {note}"


def _odometry_lines(found: Inspection) -> Iterator[str]:
    check = found.odometry
    if check is None:
        reasons = dict.fromkeys(walk.lacks["odometry"] for walk in found.walks if "odometry" in walk.lacks)
        if not reasons and found.coverage is None:
            reasons = {"there are no true poses to compare it with": None}
        yield "unknown: " + ("; ".join(reasons) or "no two images in a row have both it and true poses")
        return
    axes = check.axes
    if axes is None:
        yield "axes: too short to compare"
    elif axes.swapped:
        yield (
            f"axes: {axes.in_words()}: extrinsics? (correlation of motions {axes.correlation:.2f}, so turned"
            f" {axes.correlation_turned:.2f}; the figures below are with axes so turned)"
        )
    elif axes.mirrored:
        yield (
            f"axes: motions are each other's mirror images (correlation {axes.correlation:.2f}, mirrored"
            f" {axes.correlation_mirrored:.2f}): one is left-handed"
        )
    else:
        off = f", best when turned by {np.degrees(axes.off_rad):.0f}°: extrinsics?" if axes.tilted else ""
        yield f"axes: motions are alike (correlation {axes.correlation:.2f}){off}"
    if check.late_ms:
        late = [f"{abs(ms):.0f} ms {'late' if ms > 0 else 'early'} ({name})" for name, ms in check.late_ms.items()]
        yield f"clock, against the true poses: {_first(late)}"
    for reason in dict.fromkeys(check.unknown_late.values()):
        names = [name for name, own in check.unknown_late.items() if own == reason]
        yield f"clock of {_first(names)} unknown: {reason}"
    yield from [f"errors unknown: {check.no_fit}"] if check.fit is None else str(check.fit).splitlines()


def _view_lines(walks: Sequence[Walk]) -> Iterator[str]:
    for walk in walks[:_NAMED]:
        if not walk.views and (len(walk.poses) or any(step is not None for step in walk.odometry)):
            yield f"{walk.name}: too few pairs of images between which the camera turns or moves: {len(walk.pairs)}"
        for check in walk.views:
            agree = f"agree to {np.degrees(check.residual):.1f}°" if check.is_right else "do not agree as stated"
            yield f"{walk.name}: what images show and {check.by} {agree}, in {check.pairs} pairs of images"


def _clock_lines(clocks: Sequence[ImageClock]) -> Iterator[str]:
    if late := [f"{c.late_ms:+.0f} ms ({c.name}, {c.against})" for c in clocks if c.late_ms is not None]:
        yield f"clock of the images, late by: {_first(late)}"


def _camera_lines(check: CameraCheck) -> Iterator[str]:
    yield check.in_words
    if (camera := check.found) is not None and check.fit is not None:
        yield (
            f"fitted at {camera.width} x {camera.height} pixels: fx {camera.fx:.1f}, fy {camera.fy:.1f}, cx"
            f" {camera.cx:.1f}, cy {camera.cy:.1f}, k1 {check.fit.found.k1:.3f}, k2 {check.fit.found.k2:.3f}, found in"
            f" {check.images} images"
            f"{'' if check.of_all else '; images of other cameras were left out'}"
        )


def _model_lines(predictions: Predictions, coverage: Coverage | None) -> Iterator[str]:
    figures = predictions.as_json(None)
    yield (
        f"{100 * predictions.ambiguous:.0f} % of {len(predictions.places)} images may be in several places; nine tenths"
        f" of the samples lie within {figures['median_spread_m']:.2g} m (median)"
    )
    yield (
        f"OOD score {figures['median_ood_score']:.2f} (median; above 1 is out of distribution:"
        f" {100 * predictions.out_of_distribution:.0f} % of the images)"
    )
    if coverage is None:
        return
    error = figures["median_error_m"]
    yield (
        f"right (0.3 m, 20°) in {100 * figures['right']:.0f} % of the images with true poses, median error"
        f" {'?' if error is None else f'{error:.2g}'} m; images that it was trained on look better than new ones"
    )
    weak = predictions.weak_places(coverage)
    for place in weak[:_NAMED]:
        yield str(place)
    if len(weak) > _NAMED:
        yield f"and {len(weak) - _NAMED} more where most images are wrong"
