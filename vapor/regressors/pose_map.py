"""PoseMap: from vectors to camera poses, positions inside a box and rotations from six numbers."""

from __future__ import annotations

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from vapor.regressors.rotations import rotation_from_6d
from vapor.regressors.scene_box import SceneBox


class PoseMap(nn.Module):
    """Vectors to camera poses inside the scene's box.

    Args:
        hidden: Layers before the last.
        width: Size of what they give.
        box: Box that positions lie in.
        shortcut_dim: Size of the vectors, for a linear map from them to the pose beside the layers; 0 for no such map.
    """

    lower: Tensor
    upper: Tensor

    def __init__(self, hidden: nn.Module, width: int, box: SceneBox, shortcut_dim: int = 0) -> None:
        super().__init__()
        self.hidden = hidden
        self.translation = nn.Linear(width, 3)
        self.rotation_6d = nn.Linear(width, 6)
        self.shortcut = nn.Linear(shortcut_dim, 9, bias=False) if shortcut_dim else None
        self.register_buffer("lower", torch.tensor(box.lower), persistent=False)
        self.register_buffer("upper", torch.tensor(box.upper), persistent=False)

    def forward(
        self, vectors: Float[Tensor, "*batch d"]
    ) -> tuple[Float[Tensor, "*batch 3"], Float[Tensor, "*batch 3 3"]]:
        """Translations in metres and rotation matrices, world_from_camera."""
        hidden = self.hidden(vectors)
        translation, rotation_6d = self.translation(hidden), self.rotation_6d(hidden)
        if self.shortcut is not None:
            direct = self.shortcut(vectors)
            translation, rotation_6d = translation + direct[..., :3], rotation_6d + direct[..., 3:]
        return torch.lerp(self.lower, self.upper, torch.sigmoid(translation)), rotation_from_6d(rotation_6d)


def repeated(
    poses: tuple[Float[Tensor, "b 3"], Float[Tensor, "b 3 3"]], count: int | Tensor
) -> tuple[Float[Tensor, "b m 3"], Float[Tensor, "b m 3 3"]]:
    """One pose of each image, so many times; while a network is traced, `count` is a tensor."""
    translation, rotation = poses
    counted: Any = count  # of which torch's type hints know the first kind only
    return translation[:, None].expand(-1, counted, -1), rotation[:, None].expand(-1, counted, -1, -1)
