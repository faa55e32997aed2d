"""Parts of networks: poses from vectors, rotations, and functions that can be traced."""

from __future__ import annotations

import math
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from vapor.regressors.scene_box import SceneBox


class PoseMap(nn.Module):
    """Vectors to camera poses inside the scene's box, through hidden layers with `width` outputs.

    With `shortcut_dim`, the size of the vectors, a linear map from them to the pose is added to the layers.
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
    """One pose of each image, `count` times; while a network is traced, `count` is a tensor."""
    translation, rotation = poses
    counted: Any = count  # torch's type hints know whole numbers only
    return translation[:, None].expand(-1, counted, -1), rotation[:, None].expand(-1, counted, -1, -1)


def rotation_from_6d(columns: Float[Tensor, "*batch 6"]) -> Float[Tensor, "*batch 3 3"]:
    """Rotation matrices whose first two columns are the given ones after Gram-Schmidt (Zhou et al., CVPR 2019)."""
    first = functional.normalize(columns[..., :3], dim=-1)
    second = columns[..., 3:]
    second = functional.normalize(second - (first * second).sum(-1, keepdim=True) * first, dim=-1)
    return torch.stack([first, second, torch.linalg.cross(first, second)], dim=-1)


def rodrigues(axis: Float[Tensor, "*batch 3"], angle: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch 3 3"]:
    """Rotations about unit vectors by angles in radians."""
    x, y, z = axis.unbind(-1)
    zero = torch.zeros_like(x)
    skew = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1).unflatten(-1, (3, 3))
    sin, versine = torch.sin(angle)[..., None, None], (1.0 - torch.cos(angle))[..., None, None]
    return torch.eye(3, dtype=axis.dtype, device=axis.device) + sin * skew + versine * (skew @ skew)


def normal_cdf(x: Tensor) -> Tensor:
    """Φ(x), the fraction of standard normal numbers below x."""
    if _is_tracing():
        return 0.5 * (1.0 + torch.erf(x / math.sqrt(2.0)))  # 6e-8 off at most
    return torch.special.ndtr(x)


def count_below(numbers: Tensor, x: Tensor, *, or_equal: bool = False) -> Tensor:
    """Number of the ascending numbers below each x (or equal to it), along the last axis."""
    if _is_tracing():
        below = numbers[..., None, :] <= x[..., None] if or_equal else numbers[..., None, :] < x[..., None]
        return below.sum(dim=-1)
    return torch.searchsorted(numbers.contiguous(), x.contiguous(), right=or_equal)


def mean_of_cells(maps: Tensor, grid: tuple[int, int]) -> Tensor:
    """Means of images (b, c, h, w) in the cells of a grid, (b, c, rows, columns); cells may share a row or column."""
    if not _is_tracing():
        return functional.adaptive_avg_pool2d(maps, grid)
    rows, columns = (_cells(int(size), count) for size, count in zip(maps.shape[2:], grid, strict=True))
    return rows @ maps @ columns.T


def _cells(size: int, count: int) -> Tensor:
    """Weights (count, size) of which each row is the mean of one cell."""
    weights = torch.zeros(count, size)
    for cell in range(count):
        first, end = cell * size // count, -((cell + 1) * -size // count)
        weights[cell, first:end] = 1.0 / (end - first)
    return weights


def _is_tracing() -> bool:
    return torch.jit.is_tracing()  # pyright: ignore[reportPrivateImportUsage]
