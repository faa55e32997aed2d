"""Which arithmetic the encoder is trained in."""

from __future__ import annotations

import torch

from vapor.regressors.registry import regressor_class
from vapor.training.config import TrainConfig


def uses_bfloat16(config: TrainConfig, device: torch.device) -> bool:
    """Whether the encoder is trained in bfloat16.

    With "auto" where that is faster than float32: without instructions for it, it is many times slower, and on a CPU
    separable convolutions do not gain by it where they learn.
    """
    if config.precision != "auto":
        return config.precision == "bfloat16"
    if device.type == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    if config.network.backbone == "efficientnet-lite0" and not regressor_class(config.network.head).frozen_backbone:
        return False
    capabilities = torch.cpu.get_capabilities()
    return bool(capabilities.get("avx512_bf16") or capabilities.get("amx_bf16"))
