"""Named training configurations, the paper's and faster ones, and the methods that they can train."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType

from vapor.regressors.loss_config import LossConfig
from vapor.regressors.network_config import Head, NetworkConfig, regressor_class
from vapor.training.augment_config import AugmentConfig
from vapor.training.config import TrainConfig

_RESNET18 = NetworkConfig("resnet18", image_width=224, image_height=224, shortest_edge=256)
_FAST = NetworkConfig("efficientnet-lite0", image_width=128, image_height=96, shortest_edge=101)
_LITE0 = replace(_RESNET18, backbone="efficientnet-lite0")
_TABLES = TrainConfig(
    network=NetworkConfig("resnet18-quarter", image_width=64, image_height=48, shortest_edge=52),
    loss=LossConfig(num_samples=100),
    epochs=8,
    finish=0.0,
)


def _paper(
    lambda_rotation: float, batch_size: int, epochs: int, decay_epochs: int, alpha: float = 0.2, hidden_layers: int = 3
) -> TrainConfig:
    """The schedule of Zangeneh et al. (ICRA 2023); all images are trained on, and the last weights are the model."""
    return TrainConfig(
        network=replace(_RESNET18, hidden_layers=hidden_layers, shortcut=False),
        loss=LossConfig(
            lambda_translation=5.0,
            position_unit="metre",
            lambda_rotation=lambda_rotation,
            alpha=alpha,
            num_samples=1000,
        ),
        aspect="network",
        initial_log_variance=0.0,
        augment=AugmentConfig(crop="anywhere"),
        epochs=epochs,
        batch_size=batch_size,
        learning_rate=1e-4,
        weight_decay=0.0,
        decay_epochs=decay_epochs,
        ema_decay=0.0,
        validation_fraction=0.0,
        precision="float32",
    )


def _learning(c: TrainConfig) -> TrainConfig:
    """The settings of a preset for a frozen backbone, changed for a regressor whose backbone learns."""
    if not regressor_class(c.network.head).frozen_backbone:
        return c
    names = "weight_decay", "ema_decay", "finish", "most_epochs", "select_by"
    usual = {name: getattr(TrainConfig(), name) for name in names}
    return replace(c, network=_FAST, loss=replace(c.loss, alpha=0.1), **usual)


def _head(
    head: Head, *, components: int | None = None, relative: float = 0.0, **loss: float
) -> Callable[[TrainConfig], TrainConfig]:
    def configured(c: TrainConfig) -> TrainConfig:
        c = _learning(c)
        network = replace(c.network, head=head, components=components or c.network.components)
        return replace(c, network=network, loss=replace(c.loss, relative=relative, **loss))

    return configured


def _flow(c: TrainConfig) -> TrainConfig:
    """Higher rates than 0.001 make it vague."""
    return replace(_head("flow", components=32)(c), learning_rate=min(c.learning_rate, 1e-3))


def _retrieval(c: TrainConfig) -> TrainConfig:
    """On ImageNet's features, which a ResNet's weights must be given for."""
    network = replace(c.network, head="retrieval", feature_dim=512, hidden_width=256, components=64, dropout=0.3)
    if c.pretrained_weights is None:
        network = replace(network, backbone="efficientnet-lite0")
    loss = replace(c.loss, relative=0.0)
    return replace(
        c,
        network=network,
        loss=loss,
        learning_rate=1e-3,
        weight_decay=5e-2,
        ema_decay=0.99,
        finish=0.05,
        most_epochs=20,
        select_by="log_density",
    )


PRESETS: Mapping[str, TrainConfig] = MappingProxyType(
    {
        "auto": _retrieval(TrainConfig(network=_FAST, augment=AugmentConfig(light=0.3), larger_from_hours=1.0)),
        "demo": TrainConfig(aspect="network", epochs=30, finish=0.0, small_images_first=0.7),
        "resnet18": TrainConfig(network=_RESNET18, aspect="network", learning_rate=1e-3, epochs=30, finish=0.0),
        "efficientnet-lite0": TrainConfig(network=_LITE0, aspect="network", learning_rate=1e-3, epochs=30, finish=0.0),
        "tables": _TABLES,
        "paper-7scenes": _paper(10.0, 64, 100, 10),
        "paper-cambridge": _paper(100.0, 64, 500, 50),
        "paper-ambiguous": _paper(2.0, 4, 500, 50),
        "paper-ceiling": _paper(2.0, 4, 2000, 50, alpha=0.05, hidden_layers=9),
        "paper-synthetic": _paper(2.0, 4, 500, 50),
    }
)

METHODS: Mapping[str, Callable[[TrainConfig], TrainConfig]] = MappingProxyType(
    {
        "variational": _head("variational"),
        "no-sampling": _head("deterministic"),
        "no-kl": _head("variational", beta=0.0),
        "posenet": _head("point"),
        "bayesian-posenet": _head("dropout"),
        "mapnet": _head("point", relative=1.0),
        "mixture-10": _head("mixture", components=10),
        "mixture-50": _head("mixture", components=50),
        "flow": _flow,
        "retrieval": _retrieval,
    }
)
"""Choices of `--method` by the names of the literature: the paper's regressor, the same without its parts, those it is
compared with, one that is a density, and one that recalls training images. Each changes a configuration. Every head of
`REGRESSORS` can be trained without a row here."""
