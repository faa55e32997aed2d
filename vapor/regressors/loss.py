"""The distance between two poses, as the losses of all regressors weigh it."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from vapor.regressors.loss_config import LossConfig
from vapor.regressors.scene_box import SceneBox

_LARGEST_WEIGHT = 10.0  # of an axis along which cameras hardly move, whose errors are noise


def pose_distance(
    translation: Float[Tensor, "*batch 3"],
    rotation: Float[Tensor, "*batch 3 3"],
    true_translation: Float[Tensor, "*#batch 3"],
    true_rotation: Float[Tensor, "*#batch 3 3"],
    config: LossConfig,
    box: SceneBox,
) -> Float[Tensor, "*batch"]:
    """d_pose = λ_t ‖t̂ − t‖₂ + λ_r ‖R̂ − R‖_F; true poses broadcast, the box gives the unit of positions."""
    position, chord = pose_errors((translation, rotation), (true_translation, true_rotation), config, box)
    return config.lambda_translation * position + config.lambda_rotation * chord


def pose_errors(
    poses: tuple[Tensor, Tensor], truth: tuple[Tensor, Tensor], config: LossConfig, box: SceneBox
) -> tuple[Float[Tensor, "*b"], Float[Tensor, "*b"]]:
    """‖t̂ − t‖₂ in the configured unit, and ‖R̂ − R‖_F."""
    apart = poses[0] - truth[0]
    if config.position_unit == "box":
        apart = apart * apart.new_tensor(np.minimum(box.extent.max() / box.extent, _LARGEST_WEIGHT))
    return torch.linalg.vector_norm(apart, dim=-1), torch.linalg.vector_norm(poses[1] - truth[1], dim=(-2, -1))
