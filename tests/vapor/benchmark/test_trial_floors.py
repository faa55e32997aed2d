"""Storeys in the result of a trial."""

from types import SimpleNamespace

import numpy as np
import pytest

from filtering.estimate import Mode
from filtering.se3 import Poses
from sequences.scenes import find_scene
from tests.helpers.corridors import corridor
from vapor.benchmark.trials import replay
from vapor.benchmark.trials.choose import Excerpt, Trial
from vapor.tracking.loop import Belief
from vapor.tracking.methods import METHODS

pytestmark = pytest.mark.usefixtures("unchecked")


@pytest.mark.parametrize("priors", [None, 50])
def test_storeys_are_evaluated_where_they_look_alike_and_where_there_are_several(priors, monkeypatch):
    """Of one storey none is right or not."""
    height = find_scene("corridor").storey_height_m
    assert height == 3.2
    truth = Poses(np.tile(np.eye(3), (4, 1, 1)), np.array([[x, 0.0, 0.0] for x in range(4)]))
    off = Poses(truth.rotation, truth.translation + np.array([[0.0, 0.0, height * up] for up in (1.05, 1, 0, 0)]))
    modes = tuple((Mode(off[i], 0.01 * np.eye(6), 1.0),) for i in range(4))
    beliefs = dict.fromkeys(("kalman", "gaussian_sum", "filter"), Belief(modes, ["ambiguous"] * 4))
    segment = SimpleNamespace(times_ns=10**8 * np.arange(4), truth=truth)
    followed = SimpleNamespace(
        segment=segment,
        beliefs=beliefs,
        smoothed=beliefs["filter"],
        image_modes=modes,
        particles=1,
        step_ms=1.0,
        kidnap_index=None,
    )
    monkeypatch.setattr(replay, "follow_trial", lambda trial, setup, replay: followed)
    monkeypatch.setattr(replay, "all_poses", lambda followed: dict.fromkeys(METHODS, off))
    storeys = Poses.concatenate([corridor(0, 5, z_m=z) for z in (0.0, height)])
    given = SimpleNamespace(
        ablation="full", cue_images=0, checkpoint=lambda: SimpleNamespace(prior_poses=storeys[:priors])
    )
    for scene in ("corridor", "ceiling"):
        trial = Trial(scene, "cue", (Excerpt(0, 0, 4),))
        found = replay.localize(trial, given, given)  # pyright: ignore[reportArgumentType]
        told, belief = found["methods"]["smoothed"], found["belief"]["filter"]
        assert told.get("storey_accuracy") == (0.5 if priors is None else None)
        assert "sequences" not in found
        if scene == "corridor":
            assert told["storey"] == {"but_for_it": 1.0, "settled_images": 2, "settled_right": 1.0}
            assert belief["on_storey"]["images"] == 2
        else:
            assert "storey" not in told
            assert "on_storey" not in belief
