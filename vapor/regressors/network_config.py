"""NetworkConfig: shape of the network and of its images; backbones and regressors by name. No torch is needed.

A new regressor is a class in this folder and a row of `REGRESSORS`; the help of `NetworkConfig.head` has half a
sentence on each. Names of `--method` and `vapor-benchmark regressors` stand in `vapor.training.presets`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal, get_args

from filtering.errors import VaporTrackError, require_within

if TYPE_CHECKING:
    from vapor.regressors.backbones import EfficientNetLite0, ResNet18
    from vapor.regressors.base import PoseRegressor
    from vapor.regressors.scene_box import SceneBox

Backbone = Literal["resnet18", "resnet18-half", "resnet18-quarter", "efficientnet-lite0"]

# Mean and standard deviation of RGB pixels in 0..255 that the published weights expect.
_IMAGENET = ((123.675, 116.28, 103.53), (58.395, 57.12, 57.375))
_LITE0 = ((127.0, 127.0, 127.0), (128.0, 128.0, 128.0))
_WIDTHS = {"resnet18": 64, "resnet18-half": 32, "resnet18-quarter": 16}
REGRESSORS: Mapping[str, str] = MappingProxyType(
    {
        "variational": "variational.VariationalPoseRegressor",
        "deterministic": "variational.DeterministicPoseRegressor",
        "point": "point.PointRegressor",
        "dropout": "point.DropoutRegressor",
        "mixture": "mixture.MixtureRegressor",
        "flow": "flow.FlowRegressor",
        "retrieval": "retrieval.RetrievalRegressor",
    }
)
"""Name -> module of `vapor.regressors` and class, imported on demand."""
_MOST_ASPECT = 4.0


def make_backbone(name: Backbone) -> ResNet18 | EfficientNetLite0:
    """The convolutional network of that name, with random weights and without classifier."""
    if name == "efficientnet-lite0":
        from vapor.regressors.backbones import EfficientNetLite0

        return EfficientNetLite0()
    from vapor.regressors.backbones import ResNet18

    return ResNet18(width=_WIDTHS[name])


def stage_channels(name: Backbone) -> tuple[int, int, int, int]:
    """Numbers of channels of the outputs of a backbone's four `stages`."""
    if name == "efficientnet-lite0":
        return 24, 40, 112, 320
    width = _WIDTHS[name]
    return width, 2 * width, 4 * width, 8 * width


def pixel_statistics(name: Backbone) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Mean and standard deviation of RGB pixels in 0..255 by which the backbone's images are normalised."""
    return _LITE0 if name == "efficientnet-lite0" else _IMAGENET


def regressor_class(head: str) -> type[PoseRegressor]:
    """The class of a name in `REGRESSORS`."""
    module, name = REGRESSORS[head].split(".")
    return getattr(import_module(f"vapor.regressors.{module}"), name)


def make_regressor(config: NetworkConfig, box: SceneBox) -> PoseRegressor:
    """The configured regressor, with random weights."""
    return regressor_class(config.head)(config, box)


if TYPE_CHECKING:
    Head = str
else:
    Head = Literal[tuple(REGRESSORS)]  # the choices of the option; a type checker wants them written out


@dataclass(frozen=True)
class NetworkConfig:
    """Shape of the network, and of the images it sees."""

    backbone: Backbone = "resnet18-half"
    """Convolutional network; resnet18-half has half of its channels, for demos, resnet18-quarter a quarter."""
    head: Head = "variational"
    """The map from the feature to poses: "variational", through a random latent vector; "deterministic", through its
    mean; "point", directly to one pose; "dropout", the same with random units of the feature left out, also in use;
    "mixture", to a density of Gaussians in position and isotropic matrix-Fisher distributions in rotation; "flow", to a
    density made of splines; "retrieval", to a mixture around similar training images."""
    image_width: int = 160
    """Width of the network's input images, pixels. With the aspect of the camera they show the camera's image without
    the margin for crops; the paper's images are squares."""
    image_height: int = 120
    """Height of the network's input images, pixels."""
    shortest_edge: int = 126
    """Shorter side of the frames that crops are taken from, pixels: the image's middle, of the network's aspect."""
    feature_dim: int = 2048
    """Size of the image feature, the input of the head."""
    latent_dim: int = 16
    """Dimension d of the latent space."""
    hidden_width: int = 128
    """Width of the hidden layers of the pose map, or of a flow."""
    hidden_layers: int = 3
    """Number of hidden layers of the pose map after the first, n_layers in the paper; or of a flow."""
    shortcut: bool = True
    """variational, deterministic: a linear map from the latent vector to the pose beside the hidden layers of the pose
    map. Fewer images suffice with it; the paper's network has none."""
    dropout: float = 0.5
    """dropout: fraction of the feature's units that is left out; retrieval: fraction of the numbers of an image."""
    components: int = 10
    """mixture, retrieval: number of components; flow: number of bins of each spline."""

    def __post_init__(self) -> None:
        if self.backbone not in get_args(Backbone):
            raise VaporTrackError(f"network: backbone is {self.backbone!r}, expected one of {get_args(Backbone)}")
        if self.head not in REGRESSORS:
            raise VaporTrackError(f"network: head is {self.head!r}, expected one of {tuple(REGRESSORS)}")
        shorter, longer = sorted((self.image_width, self.image_height))
        if not (32 <= shorter <= self.shortest_edge and longer <= 8 * shorter):
            raise VaporTrackError(
                f"network: image_width {self.image_width} and image_height {self.image_height} with shortest_edge"
                f" {self.shortest_edge}, expected 32 <= the shorter <= shortest_edge, the longer at most 8 times it"
            )
        require_within(
            self,
            shortest_edge=(32, 4096),
            feature_dim=(1, 65536),
            latent_dim=(1, 4096),
            hidden_width=(1, 8192),
            hidden_layers=(0, 100),
            dropout=(0.0, 0.99),
            components=(1, 10_000),
        )

    @property
    def frame_size(self) -> tuple[int, int]:
        """Width and height of the frames that crops are taken from, pixels."""
        scale = self.shortest_edge / min(self.image_width, self.image_height)
        return round(self.image_width * scale), round(self.image_height * scale)

    def larger(self, factor: float) -> NetworkConfig:
        """The same shape for images with edges longer by a factor."""
        edges = {name: round(factor * getattr(self, name)) for name in ("image_width", "image_height", "shortest_edge")}
        return replace(self, **edges)

    def for_camera(self, width: int, height: int) -> NetworkConfig:
        """The same shape for images of a camera's aspect: about as many pixels, but no more than the camera has."""
        aspect = min(max(width / height, 1 / _MOST_ASPECT), _MOST_ASPECT)
        pixels = min(self.image_width * self.image_height, width * height)
        scale = self.shortest_edge / min(self.image_width, self.image_height)
        sides = (8 * max(round(edge / 8), 4) for edge in ((pixels * aspect) ** 0.5, (pixels / aspect) ** 0.5))
        across, down = sides
        return replace(self, image_width=across, image_height=down, shortest_edge=round(scale * min(across, down)))
