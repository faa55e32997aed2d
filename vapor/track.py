"""The program `vapor-track`: it runs a command, and turns errors into one line and an exit status."""

from __future__ import annotations

# Nothing else is imported before `main` has taken the signals: Ctrl-C within an import leaves a traceback.
import _signal  # pyright: ignore[reportMissingImports]
import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    from vapor.commands.terminal import Signals

COMMANDS = {
    "demo": "synthesize a sequence, localize in it with a model that ships, and compare",
    "run": "localize the camera of a recorded sequence",
    "live": "localize a robot from its ROS 2 topics while it moves, and publish its pose, tf and diagnostics",
    "inspect": "judge whether recordings are good enough to train on, and what to record again",
    "map": "find the poses of images alone, such as videos of a place, so that `train` can use them",
    "train": "train a pose regressor on sequences or data sets with true poses",
    "calibrate": "calibrate a trained model on held-out sequences with true poses",
    "evaluate": "measure the trajectories of a run against true poses",
    "fuse": "localize from pose estimates of others, given as text, and odometry",
    "posterior": "draw the posterior of one image",
    "replay": "publish a recording as ROS 2 topics, in real time",
    "export": "write a trained model as an ONNX file, for robots without torch",
    "convert": "write a data set of images with true poses as an MCAP sequence",
    "synthesize": "render a sequence through a synthetic scene",
    "completion": "print the script by which a shell completes commands, options and names",
}
"""Name -> description; each is a module of `vapor.commands`, imported only when it is called."""


def main(arguments: list[str] | None = None) -> int:
    """Run the command line.

    Args:
        arguments: Words after `vapor-track`; None for the process's own, whose signals are then handled (`Signals`).

    Returns:
        Exit status: 0 on success, 1 for input that cannot be used, 2 for wrong arguments, 128 + n when ended by signal
        n, such as 130 by Ctrl-C.
    """
    about = "Camera localization by a particle filter over learned pose posteriors. `vapor-track demo` is a first run."
    return run_program("vapor-track", about, COMMANDS, "vapor.commands", arguments)


def run_program(program: str, about: str, commands: dict[str, str], package: str, arguments: list[str] | None) -> int:
    """Run the command line of a program, whose commands are modules of a package that have a `main`; as `main`."""
    if arguments is None and _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler:
        _signal.signal(_signal.SIGINT, _signal.SIG_DFL)  # ends the process as SIGTERM does, until `take` below
    from vapor.commands.terminal import Signals, encode_anything, flush_output, overview, wrapped, write, write_error

    words = list(sys.argv[1:] if arguments is None else arguments)
    prefix = " ".join([program, *(word for word in words[:1] if word in commands)])
    signals = Signals(prefix)
    if arguments is None:
        signals.take()
    encode_anything()
    try:
        try:
            if not words or words[0] in ("-h", "--help"):
                write(f"{overview(f'{program} COMMAND', about, commands)}\n")
                write(
                    wrapped(f"`{program} COMMAND --help` lists a command's options, `{program} --version` its version.")
                )
                return 0 if words else 2
            return _run(program, commands, package, words, signals)
        finally:
            flush_output()
    except BrokenPipeError:
        return 1
    except BaseException as error:
        signals.working = False
        if signals.received is not None or isinstance(error, KeyboardInterrupt):
            return signals.report()
        if (failure := _failure(error)) is None:
            raise
        write_error(f"{prefix}: {failure}")
        return 1
    finally:
        signals.working, signals.silent = False, True
        if arguments is None:
            # The process ends: a search of all that it has for cycles would take half a second.
            import gc

            gc.freeze()


def _run(program: str, commands: dict[str, str], package: str, words: list[str], signals: Signals) -> int:
    import importlib

    from filtering.errors import shortened
    from vapor.commands.terminal import write, write_error

    name, rest = words[0], words[1:]
    if name == "--version":
        write(f"{program} {importlib.import_module('importlib.metadata').version('vapor-track')}")
        return 0
    if name not in commands:
        near = importlib.import_module("difflib").get_close_matches(name, [*commands, "--help", "--version"], 1)
        meant = f"did you mean {near[0]}? Expected" if near else "expected"
        write_error(f"{program}: unknown command {shortened(repr(name), 60)}, {meant} one of {', '.join(commands)}")
        return 2
    command = importlib.import_module(f"{package}.{name.replace('-', '_')}").main
    signals.working = True
    command(rest)
    signals.complete = True
    return 0


def _failure(error: BaseException) -> str | None:
    """Message of an error that is not a defect of the program; None for any other. By names, as torch may be absent."""
    from filtering.errors import VaporTrackError

    if isinstance(error, VaporTrackError):
        return str(error)
    if isinstance(error, OSError):
        return f"{error.filename or 'file'}: {error.strerror or error}"
    kind, text = type(error).__name__, str(error).lower()
    if kind in ("BrokenProcessPool", "TerminatedWorkerError"):
        return "a worker process ended unexpectedly, perhaps for lack of memory; fewer --workers need less"
    signs = ("not enough memory", "can't allocate memory", "out of memory")
    is_short = kind == "OutOfMemoryError" or (isinstance(error, RuntimeError) and any(sign in text for sign in signs))
    if isinstance(error, MemoryError) or is_short:
        return "not enough memory; smaller images, batches or numbers of samples and particles need less"
    return None


if __name__ == "__main__":
    sys.exit(main())
