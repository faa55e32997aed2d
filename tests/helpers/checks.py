"""Annotated shapes and types, which are checked while tests run."""

import functools
import inspect
import typing
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import is_dataclass
from types import SimpleNamespace
from typing import Any

import jaxtyping
from beartype import BeartypeConf, beartype
from jaxtyping import TypeCheckError, jaxtyped

_CONFIGURED = BeartypeConf(violation_type=TypeCheckError)
# What a function is given is alike from call to call: all of its first calls are checked, and one in so many after.
_ALL_OF, _ONE_IN = 100, 50
_every_call: ContextVar[bool] = ContextVar("every call", default=False)


def install(packages: list[str]) -> None:
    """Check the functions and dataclasses of packages that are imported from now on."""
    jaxtyping.jaxtyped = checked  # what the hook decorates with
    jaxtyping.install_import_hook(packages, "beartype.beartype").__enter__()


def checked(what: Any = None, *, typechecker: Any = None) -> Any:
    """As jaxtyping's own decorator does, which checks parameters twice and binds them to names first, in half the time.

    A function is made ready when it is first called: many never are, and by then all names in annotations are defined.
    """
    if what is None:
        return functools.partial(checked, typechecker=typechecker)
    if inspect.isclass(what):
        if is_dataclass(what) and "__init__" in vars(what):
            what.__init__ = checked(what.__init__)
        return what
    ready: Callable[..., Any] | None = None
    calls = 0

    @functools.wraps(what)
    def call(*arguments: Any, **named: Any) -> Any:
        __tracebackhide__ = True
        if jaxtyping.config.jaxtyping_disable:
            return what(*arguments, **named)
        nonlocal ready, calls
        calls += 1
        if calls > _ALL_OF and calls % _ONE_IN and not _every_call.get():
            return what(*arguments, **named)
        if ready is None:
            ready = _with_checks(what)
        with jaxtyped("context"):  # sizes of axes are the same within a call
            return ready(*arguments, **named)

    return call


def _with_checks(function: Callable[..., Any]) -> Callable[..., Any]:
    if inspect.isgeneratorfunction(function):
        return jaxtyped(function, typechecker=beartype)
    function.__annotations__ = dict(_known(function))
    return beartype(conf=_CONFIGURED)(function)


def _known(function: Callable[..., Any]) -> Iterator[tuple[str, Any]]:
    """Annotations whose names exist while tests run; others are for type checkers."""
    for name, hint in function.__annotations__.items():
        with_hint = SimpleNamespace(__annotations__={name: hint})
        try:
            yield name, typing.get_type_hints(with_hint, function.__globals__, include_extras=True)[name]
        except NameError:
            continue


@contextmanager
def every_call_checked() -> Iterator[None]:
    """For what looks at the checks themselves."""
    token = _every_call.set(True)
    try:
        yield
    finally:
        _every_call.reset(token)


@contextmanager
def no_checks() -> Iterator[None]:
    """For what takes thousands of steps, where others check those of the same calls; may be nested."""
    before = jaxtyping.config.jaxtyping_disable
    jaxtyping.config.update("jaxtyping_disable", True)
    try:
        yield
    finally:
        jaxtyping.config.update("jaxtyping_disable", before)
