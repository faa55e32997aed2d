"""Weight decay: which weights shrink by how much."""

from dataclasses import replace
from pathlib import Path

import pytest

from tests.helpers.tiny_training import TINY, make_frames
from vapor.regressors.network_config import make_regressor
from vapor.regressors.scene_box import SceneBox
from vapor.training.config import TrainConfig
from vapor.training.state import parameter_groups
from vapor.training.train import train_on
from vapor.training_data.training_set import TrainingError


def _norms(config: TrainConfig, output: Path) -> dict[str, float]:
    """Norm of all matrices of each part of a network trained for some steps."""
    trained = train_on({"a": make_frames(24)}, output, replace(config, learning_rate=1e-3, validation_fraction=0.0))
    squares: dict[str, float] = {}
    for name, value in trained.checkpoint.state_dict.items():
        if value.ndim > 1:
            part = name.split(".")[0]
            squares[part] = squares.get(part, 0.0) + float(value.square().sum())
    return squares


def test_a_decay_of_the_encoder_shrinks_the_encoder_alone(tmp_path):
    still = replace(TINY, weight_decay=0.0, ema_decay=0.0, resume=False)
    free = _norms(still, tmp_path / "free.safetensors")
    constrained = _norms(replace(still, encoder_weight_decay=300.0), tmp_path / "constrained.safetensors")
    assert set(free) == {"backbone", "feature", "latent_mean", "latent_log_variance", "pose_map"}
    for part in free.keys() - {"pose_map"}:
        assert constrained[part] < 0.5 * free[part]
    assert constrained["pose_map"] == pytest.approx(free["pose_map"], rel=0.05)


@pytest.mark.parametrize("head", ["variational", "point", "mixture"])
def test_every_matrix_decays_as_its_part_and_nothing_else_does(head):
    config = replace(
        TINY,
        network=replace(TINY.network, head=head),
        weight_decay=0.1,
        encoder_weight_decay=0.3,
        validation_fraction=0.0,
    )
    network = make_regressor(config.network, SceneBox((0.0,) * 3, (1.0,) * 3))
    decays = {id(p): g["weight_decay"] for g in parameter_groups(network, config) for p in g["params"]}
    for name, parameter in network.named_parameters():
        encoder = name.startswith(("backbone", "feature", "latent"))
        assert decays.pop(id(parameter)) == (0.0 if parameter.ndim <= 1 else 0.3 if encoder else 0.1), name
    assert not decays
    same = parameter_groups(network, replace(config, encoder_weight_decay=None))
    assert {g["weight_decay"] for g in same} == {0.1, 0.0}


@pytest.mark.parametrize("name", ["weight_decay", "encoder_weight_decay"])
@pytest.mark.parametrize("value", [-0.1, float("nan"), float("inf")])
def test_a_weight_decay_that_is_none_is_refused(name, value):
    with pytest.raises(TrainingError, match=f"training: {name} is .*, expected a number of at least 0"):
        replace(TINY, **{name: value})
