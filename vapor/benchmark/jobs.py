"""Jobs of a benchmark, in processes of this machine, with their progress."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from vapor.commands.progress import progress
from vapor.parallel import in_parallel

Result = TypeVar("Result")


def completed(
    work: str, unit: str, function: Callable[..., Result], jobs: Sequence[tuple], workers: int
) -> list[Result]:
    """The result of `function(*job)` for every job, in their order; jobs keep their results in files by themselves.

    Args:
        work: What is done, for the progress that is shown.
        unit: What is counted, a plural.
        function: Its result depends on its arguments only.
        jobs: Arguments of each.
        workers: Processes at a time.
    """
    results: dict[int, Result] = {}
    with progress(work, unit) as advance:
        for number, result in in_parallel(function, jobs, workers):
            results[number] = result
            advance(len(results), len(jobs))
    return [results[number] for number in range(len(jobs))]
