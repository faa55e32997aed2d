"""The filter step by step, and a plot of its certainty.

python examples/step_by_step.py sequence.mcap --model staircase --output belief.png

A recording to try it on: vapor-track synthesize staircase sequence.mcap --frames 100
"""

import argparse
from pathlib import Path

import matplotlib
import numpy as np

import vapor

matplotlib.use("Agg")
from matplotlib import pyplot as plt

COLOURS = {"converged": "tab:green", "ambiguous": "tab:orange", "lost": "tab:red"}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequence", type=Path, help="MCAP file or rosbag2 folder")
    parser.add_argument("--model", default="staircase", help="model file, or one that ships: staircase, ceiling")
    parser.add_argument("--output", type=Path, default=Path("belief.png"))
    options = parser.parse_args()

    sequence = vapor.SequenceReader(options.sequence)
    model = vapor.VaporObservationModel.from_checkpoint(options.model, camera=sequence.camera)
    localizer = vapor.ParticleLocalizer(model, rng=np.random.default_rng(0))

    figure, (above, below) = plt.subplots(2, sharex=True, figsize=(8, 5), layout="constrained")
    first_ns = None
    for frame in sequence:
        first_ns = frame.time_ns if first_ns is None else first_ns
        time_s = (frame.time_ns - first_ns) * 1e-9
        estimate = localizer.step(frame.image, frame.odometry)
        heights_m = [mode.world_from_camera.translation[2] for mode in estimate.modes]
        weights = [mode.weight for mode in estimate.modes]
        above.scatter([time_s] * len(weights), heights_m, s=40 * np.array(weights), color=COLOURS[estimate.status])
        below.scatter(time_s, weights[0], s=6, color=COLOURS[estimate.status])
    above.set_ylabel("height of each mode, m")
    below.set_ylabel("weight of the best mode")
    below.set_xlabel("time, s")
    for status, colour in COLOURS.items():
        below.scatter([], [], color=colour, label=status)
    below.legend()
    figure.savefig(options.output)
    print(f"{options.output}: {localizer.config.max_hypotheses} hypotheses at most, last status {estimate.status}")


if __name__ == "__main__":
    main()
