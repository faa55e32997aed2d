"""The command `vapor-benchmark`: what measures this library, a module of `vapor.benchmark.commands` each."""

from __future__ import annotations

import sys

from vapor.benchmark import PROGRAM
from vapor.track import run_program

COMMANDS = {
    "step": "time the parts of a step: decoding, network, landmarks, filter",
    "localization": "localize many synthetic sequences, and count successes",
    "faults": "localize walks in which the camera or the odometry fails: synthetic sequences, or recordings",
    "out-of-distribution": "count images of a place that are flagged as out of distribution, and others that are not",
    "buildings": "train a model in each of some synthetic buildings, and localize walks through it",
    "real": "localize recordings made by others: images, stored posteriors, and published estimates",
    "map": "map the images of recordings and data sets, and compare their poses with the true ones",
    "live": "measure `vapor-track live`: time from images and odometry to poses, memory, processor time",
    "live-faults": "let faults happen to a robot that `vapor-track live` follows",
    "regressors": "train every method on every scene, and measure recall, errors and densities",
    "gpu": "measure a GPU in a few minutes: the same results as on the processor, and times",
}
"""Name -> description; each is a module of `vapor.benchmark.commands`, imported only when it is called."""


def main(arguments: list[str] | None = None) -> int:
    """Run the command line of `vapor-benchmark`; arguments and exit status as in `vapor.track.main`."""
    about = "Measurements of vapor-track: times, and how well it localizes."
    return run_program(PROGRAM, about, COMMANDS, "vapor.benchmark.commands", arguments)


if __name__ == "__main__":
    sys.exit(main())
