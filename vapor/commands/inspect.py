"""`vapor-track inspect`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Annotated, TypeAlias

import numpy as np
import tyro
from rich.table import Table

from filtering.errors import VaporTrackError, few, length_said, listed, shortened
from sequences.datasets.points import scene_points
from sequences.frame import Frame
from sequences.options import SequenceOptions
from sequences.outputs import results_folder
from sequences.reading.counts import ImageCounts
from vapor.checkpoints.file_format import find_model
from vapor.commands.console import (
    OutputPath,
    Overwrite,
    command_line,
    count_images,
    parse,
    show,
    show_notices,
    skipped_lines,
)
from vapor.commands.model_name import ModelName
from vapor.commands.progress import progress
from vapor.engines.engine import Device, EngineConfig
from vapor.inspection.camera import CameraCheck
from vapor.inspection.clocks import ImageClock
from vapor.inspection.coverage import Coverage
from vapor.inspection.inspect import Inspection, inspect
from vapor.inspection.odometry import LEAST_WINDOWS
from vapor.inspection.picture import draw_map
from vapor.inspection.predictions import Predictions
from vapor.inspection.recording import record_coverage
from vapor.inspection.verdict import late_said
from vapor.inspection.walk import Walk
from vapor.observation import VaporObservationModel
from vapor.reporting.html.page import Page, findings_page, write_page
from vapor.reporting.record import EvenlySpaced
from vapor.reporting.report import write_report
from vapor.reporting.rerun_shapes import SMALL_SIDE, Photograph
from vapor.training_data.entries import as_entry, files_read, name_entries

_MAP, _RECORDING, _REPORT, _PAGE = "map.png", "recording.rrd", "report.json", "report.html"
_MOST_PHOTOGRAPHS = 150  # Rerun keeps each apart, and of more in one place all are selected
_FILES = (_MAP, _RECORDING, _REPORT, _PAGE)
_SAMPLES = 300  # of a posterior
_NAMED = 8  # of a kind, at most

Part: TypeAlias = tuple[str, Sequence[Table | str]]
"""A heading, and a table or lines."""


@dataclass(frozen=True)
class Options:
    """Judge whether recordings are good enough to train on, and what to record again. Exit status: 0 if they are, 1 if
    not, or if they cannot be read."""

    data: Annotated[tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="DATA ...")]
    """MCAP files, rosbag2 folders, data set folders or files that list a split. PATH@100:200 takes only images 100 to
    199 of it."""
    model: ModelName | None = None
    """Also report where this model is unsure or wrong: a model file, or the name of one that ships with the package."""
    output: OutputPath | None = None
    """Folder for report.html and report.json, and with true poses map.png and recording.rrd; new or with earlier
    ones."""
    recording: bool = True
    """Write recording.rrd for the Rerun viewer: where the cameras were, and where the model puts them."""
    overwrite: Overwrite = False
    device: Device = "auto"
    """Where the network runs."""
    network: Annotated[EngineConfig, tyro.conf.arg(name="")] = field(default_factory=EngineConfig)
    reading: Annotated[SequenceOptions, tyro.conf.arg(name="")] = field(default_factory=SequenceOptions)


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    o = parse("inspect", Options, arguments)
    with _outputs(o) as directory:
        model = None
        if o.model is not None:
            engine, precision = o.network.engine, o.network.precision
            model = VaporObservationModel.from_checkpoint(
                o.model, num_samples=_SAMPLES, device=o.device, engine=engine, precision=precision
            )
        photographs: EvenlySpaced[Photograph] = EvenlySpaced(_MOST_PHOTOGRAPHS)

        def see(frame: Frame) -> None:
            if o.recording and directory is not None and frame.world_from_camera is not None:
                photographs.add(lambda: Photograph.of(frame, SMALL_SIDE))

        with progress() as shown:
            found = inspect(o.data, o.reading, model=model, see=see, progress=shown.at)
        if directory is not None:
            if found.coverage is not None:
                draw_map(directory / _MAP, found.coverage)
                if o.recording:
                    points = [scene_points(path) for path, _ in name_entries(o.data).values()]
                    record_coverage(
                        directory / _RECORDING,
                        found.coverage,
                        photographs.kept,
                        found.predictions,
                        points=[each for each in points if each is not None],
                    )
            write_report(directory / _REPORT, found.as_json())
            write_page(directory / _PAGE, _page(found, o, directory / _MAP, command_line("inspect", arguments)))
    _show_parts(found)
    if o.output is not None:
        for name in (_MAP,) * (found.coverage is not None) + (_REPORT, _PAGE):
            show(f"{o.output / name}")
        if found.coverage is not None and o.recording:
            show(f"rerun {o.output / _RECORDING}")
    if found.verdict.faults:
        count = len(found.verdict.faults)
        raise VaporTrackError(f"not good enough to train on yet: {count} point{'s' * (count > 1)} to put right")


def _page(found: Inspection, o: Options, picture: Path, command: str) -> Page:
    *found_parts, _ = parts(found)  # the last is the verdict
    seen = [("From above", [picture])] if found.coverage is not None else []
    asked = "Was it recorded well enough to train on, and what to record again?"
    to_do = [("What to do", _points(found))]
    title = ", ".join(as_entry(entry).name for entry in o.data)
    return findings_page(
        shortened(title, 100), asked, f"{found.verdict.answer}.", [*to_do, *seen, *found_parts], command=command
    )


def _outputs(o: Options) -> AbstractContextManager[Path | None]:
    if o.output is None:
        return nullcontext()
    reads = chain([] if o.model is None else [find_model(o.model)], files_read(o.data, o.reading))
    return results_folder(o.output, "inspect", writes=_FILES, reads=reads, overwrite=o.overwrite)


def _show_parts(found: Inspection) -> None:
    for title, items in parts(found):
        tables = [item for item in items if isinstance(item, Table)]
        for shown in tables or [f"\n{title}"]:
            show(shown)
        show_notices([item for item in items if isinstance(item, str)])


def parts(found: Inspection) -> list[Part]:
    """All findings, the verdict last."""
    count = len({id(walk.source) for walk in found.walks}) if found.has_several else len(found.walks)
    title = f"{count} recording{'s' if count > 1 else ''}"
    title += f" by {len(found.cameras)} cameras" if found.has_several else ""
    shown: list[Part] = [(title, [_table(found.walks), *_walk_lines(found.walks)])]
    if found.coverage is not None:
        shown.append(("Coverage", [*_coverage_lines(found.coverage), *found.notices]))
    shown.append(("Odometry", [*_odometry_lines(found), *_clock_lines(found.clocks)]))
    shown.append(("Images against poses", [*_view_lines(found.walks)]))
    of_cameras = (f"{name}: {line}" if found.has_several else line
                  for name, check in found.cameras.items() for line in _camera_lines(check))  # fmt: skip
    shown.append(("Cameras" if found.has_several else "Camera", [*of_cameras]))
    if found.predictions is not None:
        shown.append(("The model", [*_model_lines(found.predictions, found.coverage)]))
    shown.append(("Verdict", [f"{found.verdict.answer}.", *_points(found)]))
    return [(title, items) for title, items in shown if items]


def _points(found: Inspection) -> list[str]:
    return [f"{number}. {sentence}" for number, sentence in enumerate(found.verdict.points, 1)]


def _table(walks: Sequence[Walk]) -> Table:
    table = Table(
        title="Recordings",
        title_justify="left",
        padding=0,  # eleven columns in 80 characters
        caption="sharp: variance of the Laplacian at 240 pixels; blurred: below 0.3 of the recording's median",
        caption_justify="left",
    )
    table.add_column("", overflow="fold")
    for name in ("images", "posed", "s", "Hz", "pixels", "path", "sharp", "blurred", "dark", "blown"):
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
            "\n".join(f"{w}x{h}" for w, h in walk.sizes),
            "?" if walk.path_m is None else f"{walk.path_m:.1f} m",
            f"{figures['sharpness']:.0f}",
            *(f"{100 * figures[name]:.0f} %" for name in ("blurred", "dark", "blown_out")),
        )
    return table


def _walk_lines(walks: Sequence[Walk]) -> Iterator[str]:
    for walk in walks:
        if walk.source.assumed_hz is not None:
            yield f"{walk.name}: has no stamps: {walk.source.assumed_hz} Hz assumed, gaps cannot be seen"
        if gaps := [f"{long_s:.2f} s at {at_s:.1f} s" for at_s, long_s in walk.gaps]:
            yield f"{walk.name}: {len(gaps)} gaps between images: {listed(gaps, _NAMED)}"
        if frozen := [f"{begin} to {end}" for begin, end in walk.frozen]:
            yield f"{walk.name}: one and the same image: {listed(frozen, _NAMED)}"
    sources = list({id(walk.source): walk.source for walk in walks}.values())
    yield from dict.fromkeys(notice for source in sources for notice in source.notices)
    if counts := [source.counts for source in sources if source.counts is not None]:
        yield f"images     {count_images(sum(counts, ImageCounts(0)).as_json())}"
    yield from skipped_lines(sum((source.skipped for source in sources), Counter()))


def _coverage_lines(coverage: Coverage) -> Iterator[str]:
    others, what = coverage.others, "recording" if coverage.by_recordings else "pass"
    shown = [f"{100 * float((others == i).mean()):.0f} % by {i or 'none'}" for i in np.unique(others).tolist()]
    if not coverage.by_recordings:
        shown = [f"{100 * float((others > 0).mean()):.0f} %"]
    yield (
        f"of {len(others)} images another {what} shows the same ground (within"
        f" {length_said(coverage.split.near_m)} and 45°): {', '.join(shown)}"
    )
    segments = coverage.alone()
    yield from (f"{segment} are shown by no other {what}" for segment in segments[:_NAMED])
    if len(segments) > _NAMED:
        yield f"and {len(segments) - _NAMED} shorter ones"
    yield from map(str, reversed(coverage.storeys()))
    yield from (f"`train` would report: {note}" for note in coverage.split.notes)


def _odometry_lines(found: Inspection) -> Iterator[str]:
    check = found.odometry
    if check is None:
        reasons = dict.fromkeys(
            walk.source.lacks["odometry"] for walk in found.walks if "odometry" in walk.source.lacks
        )
        yield "unknown: " + ("; ".join(reasons) or "no two images in a row have both it and true poses")
        return
    axes = check.axes
    if axes is None:
        yield (
            "axes and unit of odometry against the true poses: unknown, as motions over a second are compared, and"
            f" there are fewer than {LEAST_WINDOWS}, or too small ones"
        )
    else:
        mirrored = f", mirrored {axes.correlation_mirrored:.2f}: one is left-handed" if axes.is_mirrored else ""
        turned = f", {axes.correlation_turned:.2f} {axes.turn_in_words}: extrinsics?" if axes.is_turned else ""
        yield f"motions of odometry and true poses over a second: correlation {axes.correlation:.2f}{mirrored}{turned}"
    if check.late_ms:
        late = [f"{late_said(ms)} ({name})" for name, ms in check.late_ms.items()]
        yield f"odometry's stamps against the true poses: {listed(late, _NAMED)}"
    for reason in dict.fromkeys(check.unknown_late.values()):
        names = [name for name, own in check.unknown_late.items() if own == reason]
        yield f"odometry's stamps against the true poses are unknown in {listed(names, _NAMED)}: {reason}"
    yield from [f"errors unknown: {check.no_fit}"] if check.fit is None else str(check.fit).splitlines()


def _clock_lines(clocks: Sequence[ImageClock]) -> Iterator[str]:
    known = [(clock.name, clock.late_ms, clock.against) for clock in clocks if clock.late_ms is not None]
    if late := [f"{late_said(late_ms)} against the {against} ({name})" for name, late_ms, against in known]:
        yield f"stamps of the images, by the motion that they show: {listed(late, _NAMED)}"


def _view_lines(walks: Sequence[Walk]) -> Iterator[str]:
    for walk in walks[:_NAMED]:
        if not walk.checks and (len(walk.poses) or any(step is not None for step in walk.odometry)):
            pairs = len(walk.views.pairs)
            yield f"{walk.name}: too few pairs of images between which the camera turns or moves: {pairs}"
        for check in walk.checks:
            agree = f"agree to {np.degrees(check.residual):.1f}°" if check.is_right else "do not agree as stated"
            yield f"{walk.name}: what images show and {check.by} {agree}, in {check.pairs} pairs of images"


def _camera_lines(check: CameraCheck) -> Iterator[str]:
    yield check.in_words
    if (camera := check.found) is not None and check.fit is not None:
        others = "" if check.of_all else "; images of other intrinsics were resampled"
        yield (
            f"fitted at {camera.width} x {camera.height} pixels: fx {camera.fx:.1f}, fy {camera.fy:.1f}, cx"
            f" {camera.cx:.1f}, cy {camera.cy:.1f}, k1 {check.fit.found.k1:.3f}, k2 {check.fit.found.k2:.3f}, found in"
            f" {check.images} images{others}"
        )


def _model_lines(predictions: Predictions, coverage: Coverage | None) -> Iterator[str]:
    figures = predictions.as_json(None)
    yield (
        f"{100 * predictions.ambiguous:.0f} % of {len(predictions.places)} images may be in several places; nine tenths"
        f" of the samples lie within {length_said(figures['median_spread_m'])} (median)"
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
        f" {'?' if error is None else length_said(error)}; images that it was trained on look better than new ones"
    )
    yield from few(predictions.weak_places(coverage), _NAMED, others="more places where most images are wrong")
