"""Settings of trainings that take seconds."""

from vapor.regressors.network_config import NetworkConfig
from vapor.training.config import TrainConfig

TINY_TRAIN = TrainConfig(
    network=NetworkConfig(image_width=32, image_height=32, shortest_edge=34, feature_dim=16, latent_dim=4),
    bandwidth_translation_m=2.0,
    bandwidth_rotation_rad=2.0,  # so wide that the density at the truth is more than its floor
    epochs=1,
    batch_size=16,
    calibrate=False,
    validation_fraction=0.0,
)
