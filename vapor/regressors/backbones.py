"""The convolutional networks that regressors look at images with, by name; torch is loaded when one is made."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from vapor.regressors.efficientnet import EfficientNetLite0
    from vapor.regressors.resnet import ResNet18

Backbone = Literal["resnet18", "resnet18-half", "resnet18-quarter", "efficientnet-lite0"]

# Mean and standard deviation of RGB pixels in 0..255 that the published weights expect.
_IMAGENET = ((123.675, 116.28, 103.53), (58.395, 57.12, 57.375))
_LITE0 = ((127.0, 127.0, 127.0), (128.0, 128.0, 128.0))
_WIDTHS = {"resnet18": 64, "resnet18-half": 32, "resnet18-quarter": 16}


def make_backbone(name: Backbone) -> ResNet18 | EfficientNetLite0:
    """The convolutional network of that name, with random weights and without classifier."""
    if name == "efficientnet-lite0":
        from vapor.regressors.efficientnet import EfficientNetLite0

        return EfficientNetLite0()
    from vapor.regressors.resnet import ResNet18

    return ResNet18(width=_WIDTHS[name])


def stage_channels(name: Backbone) -> tuple[int, int, int, int]:
    """Channels of the image at the four depths that are the backbone's `stages`."""
    if name == "efficientnet-lite0":
        return 24, 40, 112, 320
    width = _WIDTHS[name]
    return width, 2 * width, 4 * width, 8 * width


def pixel_statistics(name: Backbone) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Mean and standard deviation of RGB pixels in 0..255 by which the backbone's images are normalised."""
    return _LITE0 if name == "efficientnet-lite0" else _IMAGENET
