"""A model of your own place: trained on some walks, calibrated on another.

python examples/train_and_calibrate.py walk0.mcap walk1.mcap walk2.mcap --held-out walk3.mcap --output place.safetensors

Walks to try it on: for i in 0 1 2 3; do vapor-track synthesize staircase walk$i.mcap --seed $i --frames 200; done
"""

import argparse
from dataclasses import replace
from pathlib import Path

import vapor


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("walks", nargs="+", type=Path, help="recordings with true poses to learn from")
    parser.add_argument("--held-out", nargs="+", type=Path, required=True, help="others, to calibrate on")
    parser.add_argument("--hours", type=float, default=0.1, help="duration of the training")
    parser.add_argument("--epochs", type=int, help="passes over the images; default: as many as time allows")
    parser.add_argument("--output", type=Path, default=Path("place.safetensors"))
    options = parser.parse_args()

    # `train` calibrates by itself on passes that it holds out. With a walk to spare, calibrate on that.
    config = replace(vapor.PRESETS["auto"], hours=options.hours, epochs=options.epochs, calibrate=False)
    vapor.train(options.walks, options.output, config, validation=options.held_out)
    result = vapor.calibrate_model(str(options.output), options.held_out, options.output, training=options.walks)

    noise = result.calibration.errors
    print(f"an ordinary image is {100 * max(noise.typical_std[:3]):.0f} cm off")
    print(f"its error is correlated over {noise.length_m:.2f} m")
    print(f"no place of an image is right with a probability of {100 * noise.outlier_probability:.0f} %")


if __name__ == "__main__":
    main()
