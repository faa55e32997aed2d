"""`vapor-track benchmark textbook`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Annotated, Any

import tyro

from filtering.errors import VaporTrackError, require_within
from vapor.benchmark.textbook.benchmark import TextbookBenchmark, TextbookConfig
from vapor.benchmark.textbook.methods import INSTALL_PARTICLES, installed
from vapor.benchmark.textbook.networks import time_networks
from vapor.benchmark.textbook.summary import summarise_methods
from vapor.benchmark.trials.kinds import KINDS
from vapor.commands.benchmark.scenes import SceneOptions, listed, with_help, write_summary
from vapor.commands.benchmark.textbook_tables import filter_tables, network_table
from vapor.commands.console import parse, show
from vapor.commands.progress import progress
from vapor.commands.workers import claim_shared, publish_results, workers_for
from vapor.observation import VaporObservationModel
from vapor.parallel.jobs import Workers
from vapor.training.presets import PRESETS

_MEANINGS = {name: kind.meaning for name, kind in KINDS.items() if kind.scale == 1.0}
_CONFIG = with_help(TextbookConfig, kinds=f"What happens in the runs. {listed(_MEANINGS)}.")


@dataclass(frozen=True, kw_only=True)
class Options(SceneOptions):
    """Compare with what one would take instead: textbook particle filters, and the paper's network in plain PyTorch."""

    preset: Annotated[str, tyro.conf.arg(metavar=f"{{{','.join(PRESETS)}}}")] = "paper-synthetic"
    """The network of this preset of `train` is timed beside that of the model."""
    repetitions: int = 50
    """How often each network is timed."""
    config: Annotated[TextbookConfig, tyro.conf.arg(name="", constructor=_CONFIG)] = field(default_factory=_CONFIG)

    def __post_init__(self) -> None:
        super().__post_init__()
        require_within(self, repetitions=(1, 10**6))
        if self.preset not in PRESETS:
            raise VaporTrackError(f"unknown preset {self.preset!r}, expected one of {', '.join(PRESETS)}")


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    o = parse("benchmark textbook", Options, arguments)
    with workers_for("benchmark textbook", o.config.workers, o.scheduler) as workers:
        _measure(o, workers)


def _measure(o: Options, workers: Workers) -> None:
    benchmark = TextbookBenchmark(o.model_of, o.output, o.config, o.replaced, workers)
    claim_shared(o.output, "benchmark textbook", workers, reads=o.files_read, overwrite=o.overwrite)
    for name in sorted(set(o.config.methods) - set(installed())):
        show(f"left out: {name}, which is not installed: {INSTALL_PARTICLES}")
    with progress("choosing", "runs") as advance:
        trials = benchmark.choose(advance)
    with progress("rendering", "walks") as advance:
        for done, total in benchmark.record(trials):
            advance(done, total)
    results = []
    with progress("filtering", "runs") as advance:
        for result in benchmark.compare(trials):
            results.append(result)
            advance(len(results), len(trials))
    results.sort(key=lambda result: result["name"])
    summary, networks = summarise_methods(results), _networks(o)
    write_summary(o, asdict(o.config) | {"preset": o.preset}, summary, results, networks=networks)
    publish_results(o.output)
    for table in filter_tables(summary):
        show(table)
    for scene, timings in networks.items():
        show(network_table(scene, o.preset, timings))


def _networks(o: Options) -> dict[str, list[dict[str, Any]]]:
    """Times of the paper's network and of our whole step, by scene."""
    timings: dict[str, list[dict[str, Any]]] = {}
    with progress("timing networks", "scenes") as advance:
        for scene, name in o.model_of.items():
            model = VaporObservationModel.from_checkpoint(
                name,
                num_samples=o.config.num_samples,
                device="cpu",
                engine=o.config.engine,
                precision=o.config.precision,
            )
            size = o.config.width, o.config.height
            each = time_networks(
                scene,
                model,
                PRESETS[o.preset].network,
                o.config.localizer,
                size=size,
                repetitions=o.repetitions,
                seed=o.config.first_seed,
            )
            timings[scene] = [asdict(timing) for timing in each]
            advance(len(timings), len(o.model_of))
    return timings
