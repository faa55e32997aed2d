"""`vapor-benchmark gpu`."""

from __future__ import annotations

import faulthandler
import math
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

from rich.table import Table

from filtering.errors import VaporTrackError, require_within
from sequences.outputs import refuse_other
from vapor.benchmark import PROGRAM
from vapor.benchmark.commands.options import require_each_once
from vapor.benchmark.figures import new_table
from vapor.benchmark.gpu.stages import Deadline, Finding, Result, Stage, carry_out
from vapor.commands.console import OutputPath, Overwrite, parse, show
from vapor.reporting.report import write_report

# Name -> module of `vapor.benchmark.gpu`, function, share of the time. A module is imported when its stage begins, so
# that one that lacks a package fails alone.
_STAGES: Mapping[str, tuple[str, str, float]] = {
    "parity": ("parity", "compare_networks", 45.0),
    "network": ("network", "time_networks", 45.0),
    "run": ("tracking", "compare_runs", 60.0),
    "step": ("tracking", "time_steps", 45.0),
    "matching": ("matching", "time_matching", 10.0),
    "training": ("training", "time_training", 125.0),
}
_GRACE_S = 10.0  # after which work that does not look at the clock is ended


@dataclass(frozen=True)
class Options:
    """Measure a GPU in a few minutes: the same results as on the processor, times of networks, steps and training."""

    output: OutputPath = Path("gpu.json")
    """JSON file with all figures, the machine, its driver, versions and the date; it grows with every figure."""
    overwrite: Overwrite = False
    device: Literal["cuda", "cpu"] = "cuda"
    """What is measured; cpu shows, on a machine without a GPU, that everything runs."""
    tiny: bool = False
    """Measure so little that it shows only whether everything runs."""
    seconds: float = 330.0
    """Time for all of it: what does not fit is left out or cut short. After ten seconds more the process is ended."""
    threads: int | None = None
    """Processor threads of the networks. Default: as many as torch takes."""
    stages: tuple[str, ...] = tuple(_STAGES)
    """parity: samples and densities; network: batches, bfloat16, CUDA graphs; run: a localized walk; step: whole steps;
    matching: of landmarks; training: of the paper's network."""

    def __post_init__(self) -> None:
        require_within(self, seconds=(1.0, 1e6))
        if self.threads is not None:
            require_within(self, threads=(1, 10**4))
        require_each_once("stages", self.stages, _STAGES)


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    o = parse("gpu", Options, arguments, program=PROGRAM)
    whole = Deadline(o.seconds)
    refuse_other(o.output, "result of vapor-benchmark gpu", _is_own, overwrite=o.overwrite)
    with _ended_after(o.seconds + _GRACE_S), tempfile.TemporaryDirectory() as folder:
        machine, results = _measure(o, whole, Path(folder))
    show(_table(machine, results))
    checks = [finding for result in results for finding in result.findings if finding.passes is not None]
    failed = [result.stage for result in results if result.outcome == "failed"]
    wrong = [finding.what for finding in checks if not finding.passes]
    show(f"{len(checks) - len(wrong)} of {len(checks)} checks pass; all figures are in {o.output}")
    if failed or wrong:
        said = [f"stages that failed: {', '.join(failed)}"] if failed else []
        said += [f"checks that failed: {'; '.join(wrong)}"] if wrong else []
        raise VaporTrackError(". ".join(said))


def _measure(o: Options, whole: Deadline, folder: Path) -> tuple[dict[str, Any], list[Result]]:
    """Carry out the stages; the machine, and what was found."""
    import torch

    from vapor.benchmark.gpu.machine import describe_machine
    from vapor.benchmark.gpu.setting import TINY, Setting, Sizes
    from vapor.threads import limited_threads

    if o.device == "cuda" and not torch.cuda.is_available():
        raise VaporTrackError(
            f"no GPU: torch {torch.__version__} finds no CUDA device, expected one with its driver, and a torch built"
            " for it (--device cpu --tiny shows without one that everything runs)"
        )
    machine = describe_machine(torch.device(o.device))
    setting = Setting(o.device, TINY if o.tiny else Sizes(), folder, o.threads or torch.get_num_threads())

    def report(results: Sequence[Result]) -> None:
        write_report(o.output, _as_json(o, machine, results))
        if results[-1].outcome != "under way":
            show(_line(results[-1]))

    stages = _stages(setting, o.stages)
    show(f"{machine['device']}, torch {machine['torch']}: stages {', '.join(o.stages)} in {o.seconds:.0f} s at most")
    with limited_threads(setting.threads):
        return machine, carry_out(stages, whole, report)


def _stages(setting: Any, names: Sequence[str]) -> list[Stage]:
    return [
        Stage(name, share, partial(_work, module, function, setting))
        for name, (module, function, share) in _STAGES.items()
        if name in names
    ]


def _work(module: str, function: str, setting: Any, deadline: Deadline) -> Iterator[Finding]:
    from importlib import import_module

    yield from getattr(import_module(f"vapor.benchmark.gpu.{module}"), function)(setting, deadline)


@contextmanager
def _ended_after(seconds: float) -> Iterator[None]:
    """End the process, saying where it was, if the block takes longer: work that hangs is not asked."""
    faulthandler.dump_traceback_later(seconds, exit=True, file=sys.__stderr__ or sys.stderr)
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()


_FORMAT = "vapor-benchmark gpu"


def _is_own(path: Path) -> bool:
    """Whether a file is an earlier result."""
    import json

    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(stored, dict) and stored.get("format") == _FORMAT


def _as_json(o: Options, machine: Mapping[str, Any], results: Sequence[Result]) -> dict[str, Any]:
    stages = []
    for result in results:
        findings = [
            {
                key: None if isinstance(value, float) and not math.isfinite(value) else value
                for key, value in (asdict(finding) | {"passes": finding.passes}).items()
            }
            for finding in result.findings
        ]
        stages.append(asdict(result) | {"findings": findings})
    settings = {"device": o.device, "tiny": o.tiny, "seconds": o.seconds, "threads": o.threads}
    return {"format": _FORMAT, "machine": machine, "settings": settings, "stages": stages}


def _line(result: Result) -> str:
    reason = f": {result.reason}" if result.reason else ""
    return f"{result.stage}: {result.outcome} after {result.seconds:.1f} s, {len(result.findings)} figures{reason}"


def _table(machine: Mapping[str, Any], results: Sequence[Result]) -> Table:
    about = ", ".join(f"{key} {value}" for key, value in machine.items() if key not in ("device", "date"))
    table = new_table(
        f"{machine['device']} ({about}), {machine['date']}", "stage, figure", "value", "95 %", "check", "how"
    )
    table.columns[0].no_wrap, table.columns[-1].justify = True, "left"
    for result in results:
        table.add_row(f"{result.stage}: {result.outcome}", f"{result.seconds:.1f} s", "", "", "")
        for each in result.findings:
            p95 = "" if each.p95 is None else f"{each.p95:.4g}"
            check = "" if each.most is None else f"{'ok' if each.passes else 'FAILS'}, at most {each.most:g}"
            table.add_row(f"  {each.what}", f"{each.value:.4g} {each.unit}", p95, check, each.note)
    return table
