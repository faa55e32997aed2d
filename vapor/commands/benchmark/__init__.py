"""`vapor-track benchmark`: a module for each thing that can be measured, imported only when it is called."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module

from vapor.commands.console import usage_error
from vapor.commands.terminal import overview, write

KINDS = ("step", "localization", "faults", "familiarity", "real", "live", "live-faults")
"""Names of the modules here that each have `Options`, with a docstring that says what is measured, and `main`."""


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    if arguments[:1] in (["-h"], ["--help"]):
        meanings = {name: import_module(f"{__name__}.{_module(name)}").Options.__doc__ for name in KINDS}
        write(overview("vapor-track benchmark KIND", "Measure; each has its own --help.", meanings))
        return
    if not arguments or arguments[0] not in KINDS:
        usage_error("benchmark", f"expected one of {', '.join(KINDS)} first")
    import_module(f"{__name__}.{_module(arguments[0])}").main(arguments[1:])


def _module(name: str) -> str:
    return name.replace("-", "_")
