"""The pose regressors by name: what `--network.head` offers. A new one is a file in this folder and a row here.

The help of `NetworkConfig.head` has half a sentence on each; whatever `--method` and `vapor-benchmark regressors` shall
offer by a name has a row in `vapor.training.presets`, too.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from types import MappingProxyType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from vapor.regressors.base import PoseRegressor
    from vapor.regressors.network_config import NetworkConfig
    from vapor.regressors.scene_box import SceneBox

REGRESSORS: Mapping[str, str] = MappingProxyType(
    {
        "variational": "variational.VariationalPoseRegressor",
        "deterministic": "deterministic.DeterministicPoseRegressor",
        "point": "point.PointRegressor",
        "dropout": "dropout.DropoutRegressor",
        "mixture": "mixture.MixtureRegressor",
        "flow": "flow.FlowRegressor",
        "retrieval": "retrieval.RetrievalRegressor",
    }
)
"""Name -> module of `vapor.regressors` and class, imported when it is asked for."""


def regressor_class(head: str) -> type[PoseRegressor]:
    """The class of a name in `REGRESSORS`."""
    module, name = REGRESSORS[head].split(".")
    return getattr(import_module(f"vapor.regressors.{module}"), name)


def make_regressor(config: NetworkConfig, box: SceneBox) -> PoseRegressor:
    """The configured regressor, with random weights."""
    return regressor_class(config.head)(config, box)
