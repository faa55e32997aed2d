"""TrainConfig: how a network is trained."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from filtering.errors import require_within
from vapor.checkpoints.calibration import Calibration
from vapor.engines.engine import Device
from vapor.regressors.loss_config import LossConfig
from vapor.regressors.network_config import REGRESSORS, NetworkConfig, regressor_class
from vapor.training.augment_config import AugmentConfig
from vapor.training_data.training_set import TrainingError

CameraChoice = Literal["auto", "estimated", "stated"]

_LARGER = 1.75  # edges of images, where a training may take longer


@dataclass(frozen=True)
class TrainConfig:
    """How a network is trained; the defaults are the fast schedule, the paper's are presets.

    Example:
        >>> from dataclasses import replace
        >>> import vapor
        >>> vapor.TrainConfig(epochs=10).landmarks
        True
        >>> overnight = replace(vapor.PRESETS["auto"], hours=8.0)
    """

    hours: float = 0.2
    """Upper bound of the training's duration, hours, unless `epochs` is given; the time of a step is measured first,
    and `train` says how long it will take. Landmarks and calibration come on top."""
    epochs: int | None = None
    """Number of passes over the training images. Default: as many as `hours` allow, from 4 to `most_epochs`."""
    landmarks: bool = True
    """Keep a map of points that the images show, which gives poses to centimetres."""
    camera: CameraChoice = "auto"
    """The camera of the landmarks. stated: by CameraInfo or the like. estimated: the one that fits images and poses.
    auto: estimated where none is stated or where it fits clearly better, else stated."""
    calibrate: bool = True
    """At the end, fit the errors of posteriors (and of recorded odometry) on the held-out images, and learn the
    appearance of the place."""
    network: NetworkConfig = field(default_factory=NetworkConfig)
    """Shape of the network, and of its images."""
    aspect: Literal["camera", "network"] = "camera"
    """Aspect of the network's images: camera takes the aspect of the camera of most images (of the first image where no
    camera is known), with as many pixels as `network` has but no more than the camera has; network takes the network's
    own, to which images are cropped."""
    loss: LossConfig = field(default_factory=LossConfig)
    """Weights of the loss."""
    augment: AugmentConfig = field(default_factory=AugmentConfig)
    """Amounts of the augmentation of training images."""
    bandwidth_translation_m: float = 0.1
    """Kernel width of posterior samples along each axis, metres, for the density by which epochs are evaluated."""
    bandwidth_rotation_rad: float = 0.1
    """Kernel width about each axis, radians."""
    pretrained_weights: Path | None = None
    """Initial weights of the backbone: ImageNet's, as safetensors or a torch state dict with torchvision's names, or
    the weights of a model trained here. Without it a ResNet starts from random weights."""
    pretrained: bool = True
    """efficientnet-lite0: start from the ImageNet weights of its package where no file is given."""
    initial_model: Path | None = None
    """A model trained here, of the same network shape, whose weights are the start: to go on with more data, or with
    another loss. Its scene box is widened where the new data need it."""
    initial_log_variance: float = -4.0
    """variational: approximate log σ² of the latent before training, unless `initial_model` gives one. With a low one
    the pose map uses early what the encoder learns, which noise would hide; the paper has 0."""
    most_epochs: int = 200
    """Greatest number of epochs, unless `epochs` is given."""
    larger_from_hours: float | None = None
    """With aspect camera and without `epochs`: from this number of `hours` on, the edges of images are 1.75 times as
    long as in `network`."""
    finish: float = 0.2
    """After its evaluation the model goes on learning from all images, held-out ones too, for this fraction of the
    epochs; with 0 it never learns from held-out images."""
    batch_size: int = 32
    """Images per step, at least 2; all images where there are fewer."""
    learning_rate: float = 3e-3
    """Largest learning rate of AdamW."""
    weight_decay: float = 1e-2
    """Decoupled weight decay of matrices; with 0, AdamW is Adam."""
    warmup: float = 0.1
    """Fraction of the training in which the learning rate rises by a cosine, before it falls by another."""
    decay_epochs: int | None = None
    """Instead, the learning rate decays by 0.8 after every n epochs, ten times at most: n in the paper."""
    ewta_fraction: float = 0.0
    """Fraction of the training in which the samples per image grow from the number of winners, who then all learn, to
    M (evolving winners take all, Makansi et al., CVPR 2019): where many places look alike, unambiguous information is
    learned first. 0 draws all M from the start, as the paper does."""
    small_images_first: float = 0.0
    """Fraction of the epochs in which images are shrunk, to 0.4 of their edges and later to 0.6: features of places are
    learned from them in a third to half of the time. These epochs are not evaluated. retrieval: without effect."""
    ema_decay: float = 0.998
    """Decay per step of the exponential moving average of weights, which becomes the model; with 0 the last weights
    become the model."""
    validation_fraction: float = 0.1
    """Approximate fraction of the images that is held out where no validation data is given, in passes over ground that
    others cover; 0 for none."""
    validation_images: int = 500
    """Greatest number of held-out images by which epochs are evaluated, evenly spaced."""
    select_by: Literal["sample_recall", "mode_recall", "log_density"] = "sample_recall"
    """The epoch that is best on held-out images by this figure becomes the model; without held-out images the last one.
    The density at the true pose falls when a possible place is forgotten, but it prefers vague posteriors to sharp ones
    that miss: for a ceiling of 24 places alike it once chose the second epoch of 24."""
    precision: Literal["auto", "float32", "bfloat16"] = "auto"
    """Arithmetic of the encoder in training; auto takes bfloat16 where the hardware has it, except for
    efficientnet-lite0 on a CPU, which gains nothing by it."""
    seed: int = 0
    """Seed of initial weights, order, augmentation and latent noise."""
    device: Device = "auto"
    """Device of the training."""
    resume: bool = True
    """Continue an interrupted training of the same output, configuration and data."""

    def __post_init__(self) -> None:
        for name, least in (("epochs", 1), ("larger_from_hours", 1e-9), ("decay_epochs", 1)):
            if getattr(self, name) is not None:
                require_within(self, **{name: (least, 10**9)})
        fractions = "ewta_fraction", "small_images_first", "ema_decay", "validation_fraction", "warmup"
        require_within(
            self,
            most_epochs=(1, 10**9),
            hours=(1e-9, 1e9),
            learning_rate=(1e-30, 1e30),
            batch_size=(2, 10**9),  # batch statistics take two
            validation_images=(1, 10**9),
            initial_log_variance=(-10.0, 5.0),
            weight_decay=(0.0, 1e9),
            seed=(0, 2**63),
            **dict.fromkeys(fractions, (0.0, 0.999)),
        )
        Calibration(self.bandwidth_translation_m, self.bandwidth_rotation_rad)  # refuses widths out of range
        if self.initial_model is not None and self.pretrained_weights is not None:
            raise TrainingError(
                f"training: initial_model {self.initial_model} and pretrained_weights {self.pretrained_weights} are"
                " both given, expected one of them: a model has its own backbone"
            )
        if self.loss.relative > 0.0 and not regressor_class(self.network.head).learns_relative_poses:
            able = " or ".join(head for head in REGRESSORS if regressor_class(head).learns_relative_poses)
            raise TrainingError(
                f"training: loss.relative is {self.loss.relative} with head {self.network.head}, expected head {able}"
            )

    def network_for(self, width: int, height: int) -> NetworkConfig:
        """The network's shape for a camera's images, given their size in pixels."""
        if self.aspect == "network":
            return self.network
        larger = self.epochs is None and self.larger_from_hours is not None and self.hours >= self.larger_from_hours
        return (self.network.larger(_LARGER) if larger else self.network).for_camera(width, height)

    @property
    def known_epochs(self) -> int:
        """Number of epochs, once that is known."""
        assert self.epochs is not None
        return self.epochs

    @property
    def files_read(self) -> tuple[Path, ...]:
        """Files of weights that a training starts from."""
        return tuple(file for file in (self.initial_model, self.pretrained_weights) if file is not None)

    def settings(self) -> dict[str, Any]:
        """Settings that identify a training: all but where it runs."""
        return {name: value for name, value in asdict(self).items() if name not in ("device", "resume")}
