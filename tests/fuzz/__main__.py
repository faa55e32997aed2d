"""`make fuzz`: damage files for as long as asked, and report the outcomes."""

import argparse
import multiprocessing
import os
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import get_args

import cv2
import torch

from tests.fuzz.cases import Outcome, Sample, Verdict, keep, limit_memory
from tests.fuzz.readers import READERS

HANG_S = 10.0
"""A reading that takes longer hangs."""

_SETUP_S = 120.0  # to make a sample
_BLOCK = 200  # files of one reader in a row
_RESTART = 77  # exit status of a process whose remaining files go to a new one
_FORK = multiprocessing.get_context("fork")


@dataclass
class Failure:
    """Files that failed alike: how many, and the first."""

    count: int
    number: int
    verdict: Verdict


@dataclass
class Tally:
    """Outcomes of the files of one reader."""

    outcomes: Counter[Outcome] = field(default_factory=Counter)
    failures: dict[str, Failure] = field(default_factory=dict)

    def add(self, number: int, verdict: Verdict) -> None:
        self.outcomes[verdict.outcome] += 1
        if verdict.outcome == "failure":
            self.failures.setdefault(verdict.cause, Failure(0, number, verdict)).count += 1


@dataclass
class _Running:
    """A process that reads one block of files."""

    process: BaseProcess
    connection: Connection
    name: str
    numbers: range  # not judged yet
    folder: Path
    ready: bool = False  # the sample is made


def fuzz(
    blocks: Iterable[tuple[str, range]], *, seed: int, workers: int, until: float | None = None
) -> dict[str, Tally]:
    """Read blocks of damaged files, each in its own process, so that hangs and crashes are survived and named.

    Args:
        blocks: Names of readers, and numbers of cases.
        seed: Of all cases.
        workers: How many processes at a time.
        until: `time.monotonic()` at which to stop.
    """
    tallies: dict[str, Tally] = {}
    waiting = iter(blocks)
    again: deque[tuple[str, range]] = deque()  # the rest of blocks whose process ended
    running: dict[Connection, _Running] = {}
    try:
        while True:
            over = until is not None and time.monotonic() > until
            while not over and len(running) < workers:
                block = again.popleft() if again else next(waiting, None)
                if block is None:
                    break
                started = _start(*block, seed)
                running[started.connection] = started
            if over or not running:
                return tallies
            for ready in wait([*running], timeout=0.2):
                each = running[ready]  # pyright: ignore[reportArgumentType]
                if _has_ended(each, tallies.setdefault(each.name, Tally())):
                    _end(running.pop(each.connection))
                    if each.numbers:
                        again.append((each.name, each.numbers))
    except KeyboardInterrupt:  # the outcomes so far are reported
        return tallies
    finally:
        for each in running.values():
            _end(each)


def _start(name: str, numbers: range, seed: int) -> _Running:
    ours, theirs = _FORK.Pipe(duplex=False)
    folder = Path(tempfile.mkdtemp(prefix="fuzz-"))
    process = _FORK.Process(target=_work, args=(theirs, name, numbers, seed, folder), daemon=True)
    process.start()
    theirs.close()
    return _Running(process, ours, name, numbers, folder)


def _work(connection: Connection, name: str, numbers: range, seed: int, folder: Path) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends its processes
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # where decoders of images complain
    signal.setitimer(signal.ITIMER_REAL, _SETUP_S)  # SIGALRM ends a process that hangs, in C code too
    sample = Sample(name, folder)
    limit_memory()
    connection.send(None)
    for number in numbers:
        signal.setitimer(signal.ITIMER_REAL, HANG_S)
        verdict = sample.judge(*sample.changes(seed, number))
        connection.send(verdict)
        if verdict.cause.startswith("memory"):
            sys.exit(_RESTART)  # the peak of a process only grows


def _has_ended(each: _Running, tally: Tally) -> bool:
    """Whether a process has ended; else its verdict is taken."""
    try:
        verdict = each.connection.recv()
    except EOFError:
        each.process.join()
        status = each.process.exitcode
        if not each.ready:
            raise RuntimeError(f"the sample of {each.name} cannot be made and read in {_SETUP_S:g} s") from None
        if each.numbers and status != _RESTART:
            hung = status == -signal.SIGALRM
            cause = f"hang over {HANG_S:g} s" if hung else f"crash with exit status {status}"
            tally.add(each.numbers[0], Verdict("failure", cause))
            each.numbers = each.numbers[1:]
        return True
    if each.ready:
        tally.add(each.numbers[0], verdict)
        each.numbers = each.numbers[1:]
    each.ready = True
    return False


def _end(each: _Running) -> None:
    each.process.kill()
    each.process.join()
    each.connection.close()
    shutil.rmtree(each.folder, ignore_errors=True)


def rounds(names: Sequence[str], first: int, files: int | None) -> Iterator[tuple[str, range]]:
    """Blocks of every reader in turn: of so many files each, or without end."""
    begin = first
    while files is None or begin < first + files:
        end = begin + _BLOCK if files is None else min(begin + _BLOCK, first + files)
        for name in names:
            yield name, range(begin, end)
        begin = end


def report(tallies: dict[str, Tally], seed: int) -> str:
    """A table of the readers, and each failure with the command that repeats it."""
    outcomes = get_args(Outcome)
    lines = ["| reader | files | " + " | ".join(outcomes) + " |", "|---" * (2 + len(outcomes)) + "|"]
    for name in sorted(tallies, key=[*READERS].index):
        tally = tallies[name]
        total = tally.outcomes.total()
        lines.append(f"| {name} | {total} | " + " | ".join(str(tally.outcomes[o]) for o in outcomes) + " |")
    sums = sum((tally.outcomes for tally in tallies.values()), Counter())
    lines.append(f"| all | {sums.total()} | " + " | ".join(str(sums[o]) for o in outcomes) + " |")
    for name, tally in tallies.items():
        for cause, failure in sorted(tally.failures.items(), key=lambda item: -item[1].count):
            v = failure.verdict
            lines.append(f"\n{name}: {cause}, {failure.count} times; case {failure.number}: {v.damage}")
            lines += [f"  {v.details}"] if v.details else []
            lines.append(f"  python -m tests.fuzz --reader {name} --seed {seed} --first {failure.number} --files 1")
    return "\n".join(lines)


def main() -> int:
    """Run the command; 1 where a file failed."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0, help="how long, unless --files is given")
    parser.add_argument("--files", type=int, help="how many files of each reader")
    parser.add_argument("--seed", type=int, default=0, help="of the damage")
    parser.add_argument("--first", type=int, default=0, help="number of the first file of each reader")
    parser.add_argument("--reader", action="append", choices=[*READERS], help="which readers; all of them by default")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--keep", action="store_true", help="add an example of each failure to the tests' corpus")
    o = parser.parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    torch.set_num_threads(1)
    cv2.setNumThreads(0)
    until = None if o.files is not None else time.monotonic() + o.seconds
    tallies = fuzz(rounds(o.reader or [*READERS], o.first, o.files), seed=o.seed, workers=o.workers, until=until)
    print(report(tallies, o.seed))
    failed = [(name, failure) for name, tally in tallies.items() for failure in tally.failures.values()]
    for name, failure in failed if o.keep else ():
        with tempfile.TemporaryDirectory() as folder:
            sample = Sample(name, Path(folder))
            changes, damage = sample.changes(o.seed, failure.number)
            if not keep(sample, changes, failure.verdict):
                print(f"not kept, as too large or known: {name} {failure.number}: {damage}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
