"""Rotation matrices from what networks give."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional


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
