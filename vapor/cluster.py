"""Jobs on the workers of a Dask scheduler that the user started."""

from __future__ import annotations

import logging
import re
import socket
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from filtering.errors import VaporTrackError
from sequences.errors import SequenceError
from sequences.files import read_json
from vapor.versions import version_of

if TYPE_CHECKING:
    from distributed import Client

Result = TypeVar("Result")

_PACKAGE = "vapor-track"
_ANSWER_S = 10  # in which a scheduler answers, if there is one
_ADDRESS = re.compile(r"(?:(?:tcp|tls|ucx|wss?)://)?[^/\s]+:\d+|inproc://\S+")
_START = "dask worker SCHEDULER --nthreads 1"


def on_cluster(
    function: Callable[..., Result],
    jobs: Mapping[int, tuple],
    scheduler: str,
    given_up: Callable[..., Result] | None = None,
) -> Iterator[tuple[int, Result]]:
    """As `vapor.parallel.in_parallel`, on the workers of a Dask scheduler, which come and go as they like.

    Jobs of a worker that dies go to another one. While there is no worker they wait for one, and a warning is logged.

    Args:
        function: What every job does; workers can import it.
        jobs: Arguments of each, by its number.
        scheduler: Its address, such as tcp://host:8786, or the file that it wrote of itself.
        given_up: The result of a job, by its arguments, whose workers died four times; None to raise.

    Raises:
        VaporTrackError: Dask is not installed, the scheduler does not answer or ends, it or a worker has another
            version than this process, a worker has several threads, or the workers of a job died four times and
            `given_up` is None.
    """
    with _connected(scheduler) as client:
        from distributed import CancelledError, KilledWorker, as_completed

        _require_alike(client)
        # `pure` would take jobs with equal arguments for one.
        futures = {
            client.submit(_on_worker, version_of(_PACKAGE), function, job, pure=False): number
            for number, job in jobs.items()
        }
        for future in as_completed(futures, loop=client.loop):
            number = futures.pop(future)
            try:
                result = future.result()
            except KilledWorker as error:
                if given_up is None:
                    raise VaporTrackError("the workers of a job died each time, perhaps for lack of memory") from error
                result = given_up(*jobs[number])
            except CancelledError as error:
                raise VaporTrackError(f"{scheduler}: the Dask scheduler ended, or cancelled the jobs") from error
            except (ImportError, RuntimeError) as error:
                if isinstance(error, RuntimeError) and "deserialization" not in str(error):
                    raise
                raise VaporTrackError(
                    f"the Dask scheduler or a worker cannot read the jobs, expected {_PACKAGE} there as here: {error}"
                ) from error
            yield number, result


@contextmanager
def _connected(scheduler: str) -> Iterator[Client]:
    try:
        from distributed import Client
    except ImportError as error:
        raise VaporTrackError(
            "distributed is not installed, expected it for a Dask scheduler: pip install 'vapor-track[dask]'"
        ) from error
    no_answer = (
        f"{scheduler}: no Dask scheduler answers, expected the address that `dask scheduler` printed, such as"
        " tcp://host:8786, or its --scheduler-file"
    )
    if (address := _address_of(scheduler)) is None:
        raise VaporTrackError(no_answer)
    try:
        client = Client(address, timeout=_ANSWER_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise VaporTrackError(no_answer) from error
    log = logging.getLogger("distributed.client")
    log.addFilter(_nothing)  # a scheduler that ends is raised, and needs no traceback
    try:
        with client:
            yield client
    finally:
        log.removeFilter(_nothing)


def _address_of(scheduler: str) -> str | None:
    """The address that is stated, or that a scheduler's file has; None where it is none, which Dask would wait for."""
    try:
        address = read_json(Path(scheduler))["address"] if Path(scheduler).is_file() else scheduler
    except (SequenceError, KeyError, TypeError):
        return None
    return address if isinstance(address, str) and _ADDRESS.fullmatch(address) else None


def _nothing(record: logging.LogRecord) -> bool:
    return False


def _require_alike(client: Client) -> None:
    """Raise where scheduler or workers have another version than this process; log a warning without a worker."""
    versions: Any = client.get_versions(packages=[_PACKAGE])  # no coroutine, as this client is none of asyncio's
    workers = versions["workers"]
    if not workers:
        logging.getLogger(__name__).warning(
            "the Dask scheduler has no worker yet; jobs wait until there is one: %s", _START
        )
    for address, found in workers.items():
        _require_version(found["packages"][_PACKAGE], version_of(_PACKAGE), f"worker {address}")
    _require_version(versions["scheduler"]["packages"][_PACKAGE], version_of(_PACKAGE), "scheduler")


def _require_version(found: str | None, expected: str | None, where: str) -> None:
    if found != expected:
        has = f"has {_PACKAGE} {found}" if found else f"has no {_PACKAGE}"
        raise VaporTrackError(f"Dask {where} {has}, expected {expected}, as where the run was started")


def _on_worker(version: str | None, function: Callable[..., Result], job: tuple) -> Result:
    """One job; workers that came later are checked here."""
    from distributed import get_worker

    worker = get_worker()
    where = f"worker {worker.address} on {socket.gethostname()}"
    _require_version(version_of(_PACKAGE), version, where)
    if (threads := worker.state.nthreads) != 1:
        raise VaporTrackError(f"Dask {where} has {threads} threads, expected one: {_START}")
    return function(*job)
