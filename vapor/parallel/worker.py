"""What a worker of a cluster does: a job that travelled as bytes, in one thread, after a look at its own version."""

from __future__ import annotations

import importlib.metadata
import io
import pickle
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from threadpoolctl import threadpool_limits

from filtering.errors import VaporTrackError
from vapor.cache import code_digest
from vapor.storage import local_path, url_of

_PACKAGE = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class About:
    """What a process says of itself.

    Attributes:
        version: Of this package.
        code: Digest of its code.
        threads: How many jobs it does at a time.
    """

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
    """A job that could not be done: on which worker, and why."""

    worker: str
    error: str

    def __str__(self) -> str:
        return f"{self.worker}: {self.error}"


@dataclass(frozen=True)
class Refused:
    """A job that was not begun, as the worker is another program."""

    worker: str
    about: About


def about_this(dask_worker: Any = None) -> About:
    """What this process is; as `dask_worker` Dask gives itself to a function, and tells the threads."""
    threads = 1 if dask_worker is None else dask_worker.state.nthreads
    return About(importlib.metadata.version("vapor-track"), code_digest("sequences", "vapor"), threads)


def packed(function: Callable[..., Any], job: tuple) -> bytes:
    """A function and its arguments for another machine: there paths mean the same as here.

    Those of models that ship lead to the package there, copies of what is in storage to copies there; all others are
    made absolute.
    """
    out = io.BytesIO()
    _Packer(out).dump((function, job))
    return out.getvalue()


def do(content: bytes, expected: About) -> Done | Failed | Refused:
    """Do a packed job, if this process is what was expected."""
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
        return Failed(address, str(error))
    except OSError as error:
        return Failed(address, f"{error.filename or 'file'}: {error.strerror or error}")
    except MemoryError:
        return Failed(address, "not enough memory")


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
