"""Shapes and types in annotations, which tests execute."""

import functools
import inspect
import typing
from collections.abc import Callable, Iterator
from dataclasses import is_dataclass
from types import SimpleNamespace
from typing import Any

import jaxtyping
from beartype import BeartypeConf, beartype
from jaxtyping import TypeCheckError, jaxtyped

_CONFIGURED = BeartypeConf(violation_type=TypeCheckError)
FIRST, ONE_IN = 20, 20  # calls of a function in a test that are checked, and of those after them
_tests_begun = 0


def begin_test() -> None:
    """Check the first calls of every function again."""
    global _tests_begun
    _tests_begun += 1


def install(packages: list[str]) -> None:
    """Check the functions and dataclasses of packages that are imported from now on."""
    jaxtyping.jaxtyped = checked  # what the hook decorates with
    jaxtyping.install_import_hook(packages, "beartype.beartype").__enter__()


def checked(what: Any = None, *, typechecker: Any = None) -> Any:
    """As jaxtyping's own decorator does, which checks parameters twice and binds them to names first, in half the time.

    A function is made ready when it is first called: many never are, and by then all names in annotations are defined.
    Checks take longer than much of what they check: in each test they are of the first 20 calls of a function, and of
    one in 20 after these.
    """
    if what is None:
        return functools.partial(checked, typechecker=typechecker)
    if inspect.isclass(what):
        if is_dataclass(what) and "__init__" in vars(what):
            what.__init__ = checked(what.__init__)
        return what
    ready: Callable[..., Any] | None = None
    calls, test = 0, -1

    @functools.wraps(what)
    def call(*arguments: Any, **named: Any) -> Any:
        __tracebackhide__ = True
        nonlocal ready, calls, test
        if test != _tests_begun:
            test, calls = _tests_begun, 0
        calls += 1
        if calls > FIRST and calls % ONE_IN:
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
