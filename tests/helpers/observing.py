"""A model of random weights that observes."""

from dataclasses import replace

import numpy as np

from tests.helpers.checkpoints import SMALL, make_checkpoint
from vapor.checkpoints.calibration import Calibration
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.observation import VaporObservationModel

CONFIG = replace(SMALL, shortest_edge=40)
IMAGE = np.random.default_rng(7).integers(0, 256, (60, 80, 3), dtype=np.uint8)


def uncalibrated() -> Checkpoint:
    return replace(make_checkpoint(CONFIG, 20), calibration=Calibration(), training={})


MODEL = VaporObservationModel.from_checkpoint(uncalibrated(), num_samples=50, device="cpu")


def observe(image, seed=0, model=MODEL):
    return model.observe(image, rng=np.random.default_rng(seed))
