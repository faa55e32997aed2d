"""`vapor-track inspect`."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from rich.table import Table

from filtering.errors import VaporTrackError
from sequences.options import SequenceOptions
from sequences.outputs.results import results_folder
from sequences.reading.counts import ImageCounts
from vapor.checkpoints.checkpoint import find_model
from vapor.commands.console import (
    OutputPath,
    Overwrite,
    parse,
    progress_of,
    show,
    show_images,
    show_notices,
    show_skipped,
    usage_error,
)
from vapor.inspection.clocks import ImageClock
from vapor.inspection.coverage import Coverage, height
from vapor.inspection.inspect import Inspection, inspect
from vapor.inspection.odometry import OdometryCheck
from vapor.inspection.picture import draw_map
from vapor.inspection.predictions import Predictions
from vapor.inspection.walks import Walk
from vapor.observation import Device, VaporObservationModel
from vapor.reporting.report import write_report
from vapor.training_data.training_set import files_read

_TOLD = 8
_MAP, _REPORT = "map.png", "report.json"


@dataclass(frozen=True)
class Options:
    """Say of recordings whether they are good enough to train on, and what to record again."""

    data: Annotated[tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="DATA ...")]
    """MCAP files, rosbag2 folders, data set folders or files that list a split; PATH@START:STOP takes only those images
    of it."""
    model: str | None = None
    """Model file, or name of a model that ships with the package: say, too, where it is unsure or wrong."""
    output: OutputPath | None = None
    """Folder for report.json and, where there are true poses, map.png; new or with earlier ones."""
    overwrite: Overwrite = False
    json: bool = False
    """Print the report as JSON instead."""
    num_samples: int = 300
    """Posterior samples an image, with a model."""
    seed: int = 0
    """Of the samples."""
    device: Device = "auto"
    """Where the network runs."""
    reading: Annotated[SequenceOptions, tyro.conf.arg(name="")] = field(default_factory=SequenceOptions)

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise VaporTrackError(f"seed is {self.seed}, expected a number from 0")


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    o = parse("inspect", Options, arguments)
    if not o.data:
        usage_error("inspect", "no data, expected at least one file or folder")
    with _outputs(o) as directory:
        model = None
        if o.model is not None:
            model = VaporObservationModel.from_checkpoint(o.model, num_samples=o.num_samples, device=o.device)
        with progress_of("inspect") as advance:
            found = inspect(o.data, o.reading, model=model, seed=o.seed, progress=advance)
        if directory is not None:
            if found.coverage is not None:
                draw_map(directory / _MAP, found.coverage, found.predictions)
            write_report(directory / _REPORT, found.as_json())
    if o.json:
        show(json.dumps(found.as_json(), indent=2, sort_keys=True, allow_nan=False))
        return
    _show_walks(found.walks)
    if found.coverage is not None:
        show("\nWhat they show")
        show_notices([*_coverage_lines(found, found.coverage)])
    show("\nOdometry")
    show_notices([*_odometry_lines(found), *_clock_lines(found.clocks)])
    if found.predictions is not None:
        show("\nThe model")
        show_notices([*_model_lines(found.predictions, found.coverage)])
    show("\nVerdict")
    show_notices([f"{number}. {sentence}" for number, sentence in enumerate(found.verdict, 1)])
    if o.output is not None:
        for name in (_MAP,) * (found.coverage is not None) + (_REPORT,):
            show(f"{o.output / name}")


def _outputs(o: Options) -> AbstractContextManager[Path | None]:
    if o.output is None:
        return nullcontext()
    reads = chain([] if o.model is None else [find_model(o.model)], files_read(o.data, o.reading))
    return results_folder(o.output, "inspect", writes=(_MAP, _REPORT), reads=reads, overwrite=o.overwrite)


def _show_walks(walks: Sequence[Walk]) -> None:
    table = Table(title=f"{len(walks)} recordings" if len(walks) > 1 else "1 recording", title_justify="left")
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
    show(table)
    for walk in walks:
        show_notices([f"{walk.name}: {line}" for line in _walk_lines(walk)])
    for notice in dict.fromkeys(notice for walk in walks for notice in walk.notices):
        show_notices([notice])
    counts = [walk.counts for walk in walks if walk.counts is not None]
    if counts:
        show_images(sum(counts, ImageCounts(0)).as_json())
    sources = {id(walk.skipped): walk.skipped for walk in walks}
    show_skipped(sum((Counter(skipped) for skipped in sources.values()), Counter()))


def _walk_lines(walk: Walk) -> Iterator[str]:
    if walk.assumed_hz is not None:
        yield f"has no stamps: {walk.assumed_hz} Hz assumed, gaps cannot be told"
    if "true poses" in walk.lacks:
        yield f"no true poses: {walk.lacks['true poses']}"
    gaps = walk.gaps
    if gaps:
        told = ", ".join(f"{long_s:.2f} s at {at_s:.1f} s" for at_s, long_s in gaps[:_TOLD])
        yield f"{len(gaps)} gaps between images: {told}{', ...' if len(gaps) > _TOLD else ''}"
    frozen = walk.frozen
    if frozen:
        told = ", ".join(f"{first} to {last}" for first, last in frozen[:_TOLD])
        yield f"one and the same image: {told}{', ...' if len(frozen) > _TOLD else ''}"
    jumps = walk.as_json()["brightness_jumps"]
    if jumps:
        told = ", ".join(map(str, jumps[:_TOLD]))
        yield f"suddenly brighter or darker at images {told}{', ...' if len(jumps) > _TOLD else ''}"


def _coverage_lines(found: Inspection, coverage: Coverage) -> Iterator[str]:
    others, what = coverage.others, "recording" if coverage.by_recordings else "pass"
    shares = [f"{100 * float((others == i).mean()):.0f} % by {i or 'none'}" for i in np.unique(others).tolist()]
    if not coverage.by_recordings:
        shares = [f"{100 * float((others > 0).mean()):.0f} %"]
    yield (
        f"of {len(others)} images another {what} shows what is there (within {coverage.split.near_m:.2g} m and 45°):"
        f" {', '.join(shares)}"
    )
    stretches = coverage.alone()
    for stretch in stretches[:_TOLD]:
        yield f"{stretch} are shown by no other {what}"
    if len(stretches) > _TOLD:
        yield f"and {len(stretches) - _TOLD} shorter ones"
    floors = coverage.floors()
    for number, floor in reversed(list(enumerate(floors, 1))):
        count = len(floor.names)
        who = f"{floor.names[0]} alone" if count == 1 else f"{count} of {len(coverage.images.names)} recordings"
        late = f", only in their last {100 * floor.late:.0f} %" if floor.late is not None else ""
        trained = f", {floor.trained} of them trained on" if coverage.split.held_out_mask.any() and count > 1 else ""
        yield (
            f"floor {number} of {len(floors)} ({height(floor.low_m, floor.high_m)}): {floor.images} images, shown by"
            f" {who}{late}{trained}"
        )
    yield from found.notices
    for note in coverage.split.notes:
        yield f"`train` would say: {note}"


def _odometry_lines(found: Inspection) -> Iterator[str]:
    check = found.odometry
    if check is None:
        reasons = dict.fromkeys(walk.lacks["odometry"] for walk in found.walks if "odometry" in walk.lacks)
        if not reasons and found.coverage is None:
            reasons = {"there are no true poses to compare it with": None}
        yield "nothing can be said: " + ("; ".join(reasons) or "no two images in a row have both it and true poses")
        return
    yield from _check_lines(check)


def _clock_lines(clocks: Sequence[ImageClock]) -> Iterator[str]:
    told = [clock for clock in clocks if clock.late_ms is not None]
    if told:
        late = ", ".join(f"{clock.late_ms:+.0f} ms ({clock.name}, {clock.against})" for clock in told[:_TOLD])
        yield f"clock of the images, later than others by: {late}{', ...' if len(told) > _TOLD else ''}"


def _check_lines(check: OdometryCheck) -> Iterator[str]:
    axes = check.axes
    if axes is None:
        yield "axes: too short to compare"
    elif axes.swapped:
        yield (
            f"axes: {axes.said()}: extrinsics? (correlation of motions {axes.correlation:.2f}, so turned"
            f" {axes.correlation_turned:.2f}; the figures below are with axes so turned)"
        )
    else:
        off = f", best when turned by {np.degrees(axes.off_rad):.0f}°: extrinsics?" if axes.tilted else ""
        yield f"axes: motions are alike (correlation {axes.correlation:.2f}){off}"
    if check.late_ms:
        late = [f"{abs(ms):.0f} ms {'late' if ms > 0 else 'early'} ({name})" for name, ms in check.late_ms.items()]
        yield f"clock, against the true poses: {', '.join(late[:_TOLD])}{', ...' if len(late) > _TOLD else ''}"
    for reason in dict.fromkeys(check.unknown_late.values()):
        names = [name for name, own in check.unknown_late.items() if own == reason]
        yield f"clock of {', '.join(names[:_TOLD])}{', ...' if len(names) > _TOLD else ''} unknown: {reason}"
    yield f"errors unknown: {check.no_fit}" if check.fit is None else str(check.fit).replace("\n", "\n  ")


def _model_lines(predictions: Predictions, coverage: Coverage | None) -> Iterator[str]:
    figures = predictions.as_json(None)
    yield (
        f"{100 * predictions.ambiguous:.0f} % of {len(predictions.places)} images may be in several places; nine tenths"
        f" of the samples lie within {figures['median_spread_m']:.2g} m (median)"
    )
    yield (
        f"unfamiliarity {figures['median_unfamiliarity']:.2f} (median; above 1 is foreign:"
        f" {100 * predictions.foreign:.0f} % of the images)"
    )
    if coverage is None:
        return
    error = figures["median_error_m"]
    yield (
        f"right (0.3 m, 20°) in {100 * figures['right']:.0f} % of the images with true poses, median error"
        f" {'?' if error is None else f'{error:.2g}'} m; images that it was trained on look better than new ones"
    )
    weak = predictions.weak_places(coverage)
    for place in weak[:_TOLD]:
        yield str(place)
    if len(weak) > _TOLD:
        yield f"and {len(weak) - _TOLD} more where most images are wrong"
