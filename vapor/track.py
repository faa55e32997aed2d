"""The command `vapor-track`: finds the command asked for, and turns errors into one line and an exit status."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Sequence

from filtering.errors import VaporTrackError

COMMANDS = {
    "run": "localize the camera of a recorded sequence",
    "demo": "synthesize a sequence, localize in it with a model that ships, and compare",
    "fuse": "localize from pose estimates of others, given as text, and odometry",
    "inspect": "say of recordings whether they are good enough to train on, and what to record again",
    "train": "train a pose regressor on sequences or data sets with true poses",
    "calibrate": "calibrate a trained model on held-out sequences with true poses",
    "synthesize": "render a sequence through a synthetic scene",
    "convert": "write a data set of images with true poses as an MCAP sequence",
    "posterior": "draw the posterior of one image",
    "evaluate": "measure the trajectories of a run against true poses",
    "experiment": "train many networks: methods side by side, recall over α, weight decay, schedules",
    "benchmark": "time the parts of a step, localize many synthetic sequences, or count foreign images noticed",
}
"""Name -> what it does; each is a module of `vapor.commands`, imported only when it is called."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        arguments: Words after `vapor-track`; None for the process's own.

    Returns:
        Exit status: 0 on success, 1 for input that cannot be used, 2 for wrong arguments, 130 when interrupted.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    if not words or words[0] in ("-h", "--help"):
        print(_overview())
        return 0 if words else 2
    if words[0] == "--version":
        print(f"vapor-track {importlib.import_module('importlib.metadata').version('vapor-track')}")
        return 0
    name, rest = words[0], words[1:]
    if name not in COMMANDS:
        print(f"vapor-track: unknown command {name!r}, expected one of {', '.join(COMMANDS)}", file=sys.stderr)
        return 2
    try:
        importlib.import_module(f"vapor.commands.{name}").main(rest)
    except VaporTrackError as error:
        print(f"vapor-track {name}: {' '.join(str(error).splitlines())}", file=sys.stderr)
        return 1
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except OSError as error:
        print(f"vapor-track {name}: {error.filename or 'file'}: {error.strerror or error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"vapor-track {name}: interrupted", file=sys.stderr)
        return 130
    except (MemoryError, RuntimeError) as error:
        shortage = _shortage(error)
        if shortage is None:
            raise
        print(f"vapor-track {name}: {shortage}", file=sys.stderr)
        return 1
    return 0


def _shortage(error: Exception) -> str | None:
    """What to say where the machine is too small; None for any other error. By names: torch may not be loaded."""
    kind, text = type(error).__name__, str(error).lower()
    if kind in ("BrokenProcessPool", "TerminatedWorkerError"):
        return "a worker process ended unexpectedly, perhaps for lack of memory; fewer --workers need less"
    signs = ("not enough memory", "can't allocate memory", "out of memory")
    if isinstance(error, MemoryError) or kind == "OutOfMemoryError" or any(sign in text for sign in signs):
        return "not enough memory; smaller images, batches or numbers of samples and particles need less"
    return None


def _overview() -> str:
    width = max(map(len, COMMANDS))
    lines = [f"  {name:<{width}}  {summary}" for name, summary in COMMANDS.items()]
    return "\n".join(
        [
            "usage: vapor-track COMMAND ...",
            "",
            "Particle-filter camera localization that consumes learned pose posteriors.",
            "",
            *lines,
            "",
            "`vapor-track COMMAND --help` lists a command's options.",
        ]
    )


if __name__ == "__main__":
    sys.exit(main())
