"""ResNet-18 (He et al., CVPR 2016) with torchvision's parameter names, so that its published weights load."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn


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


class ResNet18(nn.Module):
    """ResNet-18: images to pooled features, or to class scores.

    Args:
        width: Channels of the first stage; the stages have 1, 2, 4, 8 times as many. 64 is the published network.
        num_classes: Size of `fc`; None leaves the classifier away.
    """

    def __init__(self, width: int = 64, num_classes: int | None = None) -> None:
        super().__init__()
        self.num_features = 8 * width
        self.conv1 = nn.Conv2d(3, width, 7, stride=2, padding=3, bias=False)
        self.bn1 = nn.BatchNorm2d(width)
        self.maxpool = nn.MaxPool2d(3, stride=2, padding=1)
        self.layer1 = nn.Sequential(BasicBlock(width, width, 1), BasicBlock(width, width, 1))
        self.layer2 = nn.Sequential(BasicBlock(width, 2 * width, 2), BasicBlock(2 * width, 2 * width, 1))
        self.layer3 = nn.Sequential(BasicBlock(2 * width, 4 * width, 2), BasicBlock(4 * width, 4 * width, 1))
        self.layer4 = nn.Sequential(BasicBlock(4 * width, 8 * width, 2), BasicBlock(8 * width, 8 * width, 1))
        self.fc = nn.Linear(8 * width, num_classes) if num_classes is not None else None
        for module in self.modules():
            # Names and shapes only are on the meta device; to draw there loads torch's compiler, which takes seconds.
            if isinstance(module, nn.Conv2d) and not module.weight.is_meta:
                nn.init.kaiming_normal_(module.weight, mode="fan_out", nonlinearity="relu")

    @property
    def stages(self) -> tuple[nn.Module, ...]:
        """Modules whose outputs are the image at four depths, with `backbones.stage_channels` channels."""
        return self.layer1, self.layer2, self.layer3, self.layer4

    def maps(self, x: Float[Tensor, "b 3 h w"]) -> tuple[Float[Tensor, "b c i j"], Float[Tensor, "b f k l"]]:
        """What the third and the last of `stages` make of ImageNet-normalised images."""
        x = self.maxpool(torch.relu_(self.bn1(self.conv1(x))))
        third = self.layer3(self.layer2(self.layer1(x)))
        return third, self.layer4(third)

    def forward(self, x: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b f"]:
        """Features (b, 8 width) of ImageNet-normalised images, or scores (b, num_classes)."""
        x = self.maps(x)[1].mean(dim=(2, 3))
        return x if self.fc is None else self.fc(x)
