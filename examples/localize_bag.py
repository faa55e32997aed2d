"""Localize a recording, and read the results.

python examples/localize_bag.py sequence.mcap --model staircase --output result/

A recording to try it on: vapor-track synthesize staircase sequence.mcap --frames 100
"""

import argparse
from pathlib import Path

import numpy as np

import vapor


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequence", type=Path, help="MCAP file or rosbag2 folder")
    parser.add_argument("--model", default="staircase", help="model file, or one that ships: staircase, ceiling")
    parser.add_argument("--output", type=Path, default=Path("result"))
    options = parser.parse_args()

    result = vapor.run(options.sequence, options.model, options.output, overwrite=True)

    record = result.record
    positions = record.methods["filter"].poses.translation  # of world_from_camera, metres, (n, 3)
    for i in np.linspace(0, len(record.status) - 1, 5).astype(int):
        x, y, z = positions[i]
        print(f"image {i:4d}: {record.status[i]:9s} at {x:6.2f} {y:6.2f} {z:6.2f} m")
    for notice in result.notices:
        print(notice)
    print(f"everything else is in {options.output}/: trajectory.tum, report.json, estimate.mcap, pictures")


if __name__ == "__main__":
    main()
