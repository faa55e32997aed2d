"""The workers of a Dask scheduler: their versions, and one function over many jobs on them."""

from __future__ import annotations

import asyncio
import importlib.metadata
import io
import os
import pickle
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from threadpoolctl import threadpool_limits

from filtering.errors import VaporTrackError
from sequences.atomic import workspace
from vapor.cache import code_digest
from vapor.storage import local_path, url_of

if TYPE_CHECKING:
    from distributed import Future

_PACKAGE = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class About:
    """Version of this package in a process, digest of its code, and number of jobs that it does at a time."""

    version: str
    code: str
    threads: int = 1

    def __str__(self) -> str:
        return f"vapor-track {self.version} with code {self.code} and {self.threads} thread{'s' * (self.threads != 1)}"


@dataclass(frozen=True)
class Done:
    """A job that was done, and its result."""

    result: Any


@dataclass(frozen=True)
class Failed:
    """A job that could not be done: address of its worker, and the error."""

    error: str


@dataclass(frozen=True)
class Refused:
    """A job that was not begun, as the worker runs another version."""

    worker: str
    about: About


def about_this(dask_worker: Any = None) -> About:
    """This process; Dask passes its worker as `dask_worker`, which has the threads."""
    threads = 1 if dask_worker is None else dask_worker.state.nthreads
    return About(importlib.metadata.version("vapor-track"), code_digest("sequences", "vapor"), threads)


def packed(function: Callable[..., Any], job: tuple) -> bytes:
    """A function and its arguments for another machine: there paths mean the same as here.

    Paths of models that ship lead to the package there, copies of files in storage to copies there; all others are made
    absolute.
    """
    out = io.BytesIO()
    _Packer(out).dump((function, job))
    return out.getvalue()


def do(content: bytes, expected: About) -> Done | Failed | Refused:
    """Do a packed job, if this process has the expected versions."""
    from distributed import get_worker

    worker = get_worker()
    about, address = about_this(worker), worker.address
    if about != expected:
        return Refused(address, about)
    try:
        function, job = pickle.loads(content)
        with _one_thread():
            return Done(function(*job))
    except VaporTrackError as error:
        return Failed(f"{address}: {error}")
    except OSError as error:
        return Failed(f"{address}: {error.filename or 'file'}: {error.strerror or error}")
    except MemoryError:
        return Failed(f"{address}: not enough memory")


class _Packer(pickle.Pickler):
    def reducer_override(self, value: Any) -> Any:
        if not isinstance(value, Path):
            return NotImplemented
        if (url := url_of(value)) is not None:
            return _unpacked, ("url", url)
        path = value.absolute()
        if path.is_relative_to(_PACKAGE / "models"):
            return _unpacked, ("package", str(path.relative_to(_PACKAGE)))
        return _unpacked, ("path", str(path))


def _unpacked(kind: Literal["url", "package", "path"], text: str) -> Path:
    return local_path(text) if kind == "url" else _PACKAGE / text if kind == "package" else Path(text)


@contextmanager
def _one_thread() -> Iterator[None]:
    if "torch" not in sys.modules:  # the function does not need it, and loading it takes seconds
        with threadpool_limits(1):
            yield
        return
    from vapor.threads import limited_threads

    with limited_threads(1):
        yield


Result = TypeVar("Result")

_PATIENCE_S = 10.0
_GONE = "finished jobs stay; running ones go on to their end"


class ClusterError(VaporTrackError):
    """A scheduler or workers that cannot be used, or jobs that failed on them."""


@dataclass(frozen=True)
class Cluster:
    """The workers of a scheduler, from `connected`: its address, a `Client` of Dask, and their expected version."""

    address: str
    client: Any
    expected: About

    @property
    def dashboard(self) -> str | None:
        """URL of the scheduler's page; None where it serves none."""
        return self.client.dashboard_link if "dashboard" in self.client.scheduler_info()["services"] else None

    @property
    def size(self) -> int:
        """Number of workers now."""
        return len(self.client.nthreads())

    def require_to_see(self, folder: Path) -> None:
        """Raise ClusterError where a worker does not see a folder, by one that is made in it."""
        with workspace(folder, "seen") as made:
            found = self.client.run(os.path.isdir, str(made.absolute()))
        for worker in (worker for worker, seen in found.items() if not seen):
            raise ClusterError(f"worker {worker} does not see {folder}, expected a disk that all see, or a URL")

    def results(self, function: Callable[..., Result], jobs: Sequence[tuple]) -> Iterator[Result]:
        """The result of `function(*job)` for every job, as each finishes, in no order.

        Jobs travel as `packed`. Those of a worker that dies are done by others. A job that fails for its input or for a
        full disk does not stop the others. Queued jobs are cancelled when no more results are asked for, as after
        Ctrl-C; running ones go on to their end.

        Raises:
            ClusterError: in the end, some failed; at once, a worker that joined is of another version, or the scheduler
                went away.
        """
        from distributed import as_completed

        submitted = [self.client.submit(do, packed(function, job), self.expected, pure=False) for job in jobs]
        failed: list[Failed] = []
        try:
            for future in as_completed(submitted, loop=self.client.loop):
                outcome = self._outcome(future)
                if isinstance(outcome, Failed):
                    failed.append(outcome)
                else:
                    yield outcome.result
        finally:
            if self.client.status == "running":
                self.client.cancel([future for future in submitted if not future.done()], force=True)
        if failed:
            others = "" if len(failed) == len(jobs) else ", the others are done"
            raise ClusterError(f"{len(failed)} of {len(jobs)} jobs failed{others}; worker {failed[0].error}")

    def _outcome(self, future: Future) -> Done | Failed:
        from distributed import KilledWorker

        error: Any = future.exception() if future.status == "error" else None
        if future.status in ("cancelled", "lost"):
            raise ClusterError(f"{self.address}: the scheduler went away; {_GONE}")
        if isinstance(error, KilledWorker):
            tries = error.allowed_failures + 1
            died = f"died in this job as {tries - 1} others did before, perhaps for lack of memory"
            return Failed(f"{error.last_worker.address}: {died}")
        if error is not None:
            raise error
        outcome = future.result()
        if isinstance(outcome, Refused):
            raise ClusterError(f"{_refusal({outcome.worker: outcome.about}, self.expected)}; {_GONE}")
        return outcome


@contextmanager
def connected(address: str, notify: Callable[[str], None]) -> Iterator[Cluster]:
    """Connect to the scheduler at an address, such as `tcp://host:8786`, and check its workers.

    Args:
        address: Of the scheduler.
        notify: Called with a line on every worker that dies.

    Raises:
        ClusterError: Dask is not installed, no scheduler answers within ten seconds, or a worker has another version or
            several threads. (Workers that join later are checked with their first job.)
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise ClusterError("--scheduler needs Dask: pip install 'vapor-track[cluster]'") from error
    try:
        asyncio.run(_ask(address))
        client: Any = Client(address, timeout=_PATIENCE_S, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        reason = " ".join(str(error).split()) or f"no answer within {_PATIENCE_S:g} s"
        raise ClusterError(f"{address}: {reason}; expected a Dask scheduler, such as tcp://host:8786") from error

    def report(event: tuple[float, Any]) -> None:
        about = event[1]
        if isinstance(about, dict) and about.get("action") == "remove-worker" and not about.get("expected"):
            notify(f"worker {about['worker']} went away; its job is done again by others")

    try:
        expected = about_this()
        found = client.run(about_this, on_error="return")
        others = {worker: about for worker, about in found.items() if about != expected}
        if others:
            raise ClusterError(_refusal(others, expected))
        client.subscribe_topic("all", report)
        yield Cluster(address, client, expected)
        if client.status == "running":
            client.unsubscribe_topic("all")
    finally:
        client.close(timeout=2)


async def _ask(address: str) -> None:
    # `Client` would wait forever for a server that is no scheduler, and long for a wrong address.
    from distributed.core import rpc
    from distributed.security import Security

    async with asyncio.timeout(_PATIENCE_S):
        async with rpc(address, connection_args=Security().get_connection_args("client")) as scheduler:
            await scheduler.identity()


def _refusal(others: dict[str, Any], expected: About) -> str:
    worker, about = next(iter(others.items()))
    found = about if isinstance(about, About) else f"another vapor-track, or none ({' '.join(str(about).split())})"
    more = f"; so have {len(others) - 1} more" if len(others) > 1 else ""
    return f"worker {worker} has {found}, expected {expected} as here{more}"
