"""`vapor-benchmark buildings`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from rich.table import Table

from filtering.errors import require_within
from sequences.outputs import claim_folder
from vapor.benchmark import PROGRAM
from vapor.benchmark.buildings.building import SHOWN, Building, BuildingsConfig, measure_building
from vapor.benchmark.commands.options import require_each_once
from vapor.benchmark.evaluation import short_label
from vapor.benchmark.figures import Walks, percent, percent_cell, table_of, text, values_at
from vapor.benchmark.jobs import completed
from vapor.commands.console import OutputPath, Overwrite, parse, show
from vapor.evaluation.consistency import REGIONS
from vapor.reporting.report import write_report

Results = Sequence[Mapping[str, Any]]

_CAPTION = (
    "a number for each test walk; right: within 0.3 m and 20°; from: when the filter is right for the first time; cm:"
    " median error; wrong and regions: of the converged images"
)


@dataclass(frozen=True)
class Options:
    """Render buildings that are drawn from numbers, train a model in each, and localize walks through it."""

    output: OutputPath
    """Directory for walks, models, runs and summary.json; an interrupted benchmark with the same output continues, and
    what was made by the same settings and code is kept."""
    buildings: tuple[int, ...] = (904, 903, 907, 905, 902, 910, 908, 901, 906, 909)
    """Numbers of the buildings."""
    overwrite: Overwrite = False
    workers: int = 1
    """Buildings at a time, each in a process of its own; a training needs up to 2 GB of memory."""
    config: Annotated[BuildingsConfig, tyro.conf.arg(name="")] = field(default_factory=BuildingsConfig)

    def __post_init__(self) -> None:
        require_within(self, workers=(1, 10**6))
        require_each_once("buildings", [str(number) for number in self.buildings])


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    o = parse("buildings", Options, arguments, program=PROGRAM)
    buildings = [Building(number, o.config) for number in o.buildings]
    claim_folder(o.output, f"{PROGRAM} buildings", reads=o.config.train.files_read, overwrite=o.overwrite)
    jobs = [(building, o.output) for building in buildings]
    of_buildings = completed("measuring", "buildings", measure_building, jobs, o.workers)
    results = [result for of_building in of_buildings for result in of_building]
    write_report(o.output / "summary.json", {"settings": settings_of(o.config), "walks": results})
    for table in tables(results):
        show(table)


def settings_of(config: BuildingsConfig) -> dict[str, Any]:
    """The settings, as JSON."""
    train = {key: str(value) if isinstance(value, Path) else value for key, value in asdict(config.train).items()}
    return asdict(config) | {"train": train}


# --- tables -----------------------------------------------------------------------------------------


def tables(results: Results) -> Iterator[Table]:
    """A row for each building and way to read its walks; below, what all walks give with intervals over buildings."""
    groups: dict[str, list[Mapping[str, Any]]] = {}
    for result in results:
        name = f"{result['building']}: {result['tour_m']:.0f} m"
        groups.setdefault(", ".join(filter(None, [name, result["reads"]])), []).append(result)
    reads = dict.fromkeys(values_at(results, "reads"))
    every = {each or "all walks": [result for result in results if result["reads"] == each] for each in reads}
    confidence = table_of("confidence of the filter, %", "building: tour", _CONFIDENCE, groups)
    confidence.caption = _CAPTION
    for table in (
        table_of("right, %", "building: tour", _RIGHT, groups),
        confidence,
        table_of("over all buildings", "", _OVER_ALL, every),
    ):
        table.columns[0].no_wrap = True
        yield table


def _each(form: Callable[[Any], str], *keys: str) -> Callable[[Results], str]:
    return lambda walks: ", ".join(form(value) for value in values_at(walks, *keys))


def _share(*keys: str) -> Callable[[Results], str]:
    return _each(lambda value: percent(value, unit=""), *keys)


def _centimetres(method: str) -> Callable[[Results], str]:
    return _each(lambda value: text(value, ".1f", factor=100.0), "methods", method, "median_m")


def _regions(walks: Results) -> str:
    return " / ".join(", ".join(percent(walk["coverage"][region], unit="") for region in REGIONS) for walk in walks)


def _minutes(walks: Results) -> str:
    return f"{walks[0]['train_s'] / 60:.0f} + {np.mean(values_at(walks, 'run_s')) / 60:.1f}"


def _mean(*keys: str) -> Callable[[Results], str]:
    return lambda walks: percent_cell(_over(walks).mean(values_at(walks, *keys)))


def _wrong(walks: Results) -> str:
    sure = [walk["images"] * walk["status"]["converged"] for walk in walks]
    return percent_cell(_over(walks).mean(values_at(walks, "wrong"), sure))


def _over(walks: Results) -> Walks:
    """Intervals over buildings: walks through one share its model."""
    return Walks(values_at(walks, "building"))


Columns = Mapping[str, Callable[[Results], str]]

_RIGHT: Columns = {
    "landmarks\nverify, %": _share("verified"),
    **{f"\n{short_label(name)}": _share("methods", name, "right") for name in SHOWN},
    "from\ns": _each(text, "first_right_s"),
    "filter\ncm": _centimetres("filter"),
    "smoothed\ncm": _centimetres("smoothed"),
}
_CONFIDENCE: Columns = {
    "\nconverged": _share("status", "converged"),
    "\nwrong": _share("wrong"),
    "\nlost": _share("status", "lost"),
    "regions\n50, 90, 95 %": _regions,
    "train, run\nminutes": _minutes,
}
_OVER_ALL: Columns = {
    "\nwalks": lambda walks: str(len(walks)),
    **{f"{short_label(name)}\nright": _mean("methods", name, "right") for name in SHOWN},
    "\nconverged": _mean("status", "converged"),
    "of these\nwrong": _wrong,
}
