"""Weight decay: which weights shrink."""

from dataclasses import replace

import pytest

from tests.helpers.tiny_training import TINY, make_frames
from vapor.regressors.network_config import make_regressor
from vapor.regressors.scene_box import SceneBox
from vapor.training.state import parameter_groups
from vapor.training.train import train_on
from vapor.training_data.training_set import TrainingError


def test_a_larger_decay_shrinks_the_weights(tmp_path):
    still = replace(TINY, ema_decay=0.0, resume=False, learning_rate=1e-3, validation_fraction=0.0, calibrate=False)
    norms = []
    for decay in (0.0, 300.0):
        config = replace(still, weight_decay=decay)
        trained = train_on({"a": make_frames(24)}, tmp_path / f"{decay}.safetensors", config).checkpoint
        norms.append(sum(float(v.square().sum()) for v in trained.state_dict.values() if v.ndim > 1))
    assert norms[1] < 0.5 * norms[0]


@pytest.mark.parametrize("head", ["variational", "point", "mixture"])
def test_every_matrix_decays_and_nothing_else_does(head):
    config = replace(TINY, network=replace(TINY.network, head=head), weight_decay=0.1)
    network = make_regressor(config.network, SceneBox((0.0,) * 3, (1.0,) * 3))
    decays = {id(p): g["weight_decay"] for g in parameter_groups(network, config) for p in g["params"]}
    for name, parameter in network.named_parameters():
        assert decays.pop(id(parameter)) == (0.1 if parameter.ndim > 1 else 0.0), name
    assert not decays


@pytest.mark.parametrize("value", [-0.1, float("nan"), float("inf")])
def test_a_weight_decay_out_of_range_is_refused(value):
    with pytest.raises(TrainingError, match=r"training: weight_decay is .*, expected 0.0 to"):
        replace(TINY, weight_decay=value)
