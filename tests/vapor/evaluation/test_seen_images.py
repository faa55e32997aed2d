"""Features and descriptions of images: a backbone that never learns sees each image once."""

from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest
import torch

from filtering.se3 import Poses
from sequences.frame import Frame
from tests.helpers.tiny_model import NETWORK
from vapor.evaluation.seen_images import crops_of, describe_images, features_of
from vapor.evaluation.validation import predict
from vapor.regressors.backbones import Describer
from vapor.regressors.network_config import NetworkConfig
from vapor.regressors.retrieval import RetrievalRegressor
from vapor.regressors.scene_box import SceneBox
from vapor.regressors.variational import VariationalPoseRegressor
from vapor.training_data.load import load_training_set
from vapor.training_data.training_set import TrainingSet

BOX = SceneBox((-1.0,) * 3, (1.0,) * 3)
RETRIEVAL = NetworkConfig(
    "resnet18-quarter",
    head="retrieval",
    image_width=32,
    image_height=32,
    shortest_edge=36,
    feature_dim=16,
    hidden_width=16,
    components=4,
)


@pytest.fixture
def images() -> TrainingSet:
    pixels = np.random.default_rng(0).integers(0, 256, (40, 36, 48, 3), np.uint8)
    frames = [Frame(i, each, None, Poses.identity()) for i, each in enumerate(pixels)]
    return load_training_set({"room": frames}, RETRIEVAL.frame_size)


@pytest.fixture
def network(images) -> RetrievalRegressor:
    torch.manual_seed(0)
    network = RetrievalRegressor(RETRIEVAL, BOX).eval()
    numbers = torch.randn(10, len(network.centre))
    network.standardise(3.0 * numbers + 1.0)
    network.remember(numbers, torch.zeros(10, 3), torch.eye(3).expand(10, 3, 3))
    return network


def watched(network, monkeypatch) -> list[int]:
    """Sizes of the batches that the backbone is shown from now on."""
    shown, maps = [], network.backbone.maps
    monkeypatch.setattr(network.backbone, "maps", lambda x: (shown.append(len(x)), maps(x))[1])
    return shown


def test_features_and_descriptions_are_those_of_the_network_on_each_image(network, images):
    some = images.select(np.array([3, 4, 30]))
    ((_, pixels),) = crops_of(network, some.images, some.rows)
    with Describer(network) as describer, torch.inference_mode():
        expected = network.extract_features(network.normalise(pixels))
        described = describer.last(pixels)
    torch.testing.assert_close(features_of(network, some), expected)
    np.testing.assert_allclose(describe_images(network, some), described.numpy(), rtol=1e-5, atol=1e-6)


def test_crops_of_another_size_are_other_images(network, images):
    features_of(network, images)
    other = RetrievalRegressor(replace(RETRIEVAL, image_width=36), BOX).eval()
    other.backbone.load_state_dict(network.backbone.state_dict())
    other.standardise_like(network)
    ((_, pixels),) = crops_of(other, images.images, images.rows, len(images))
    with torch.inference_mode():
        expected = other.extract_features(other.normalise(pixels))
    torch.testing.assert_close(features_of(other, images), expected)


def test_each_image_is_shown_to_a_frozen_backbone_once_whatever_is_asked_for(network, images, monkeypatch):
    shown = watched(network, monkeypatch)
    first, every = images.select(np.arange(25)), np.arange(40)
    features = features_of(network, first)
    assert sum(shown) == 25
    samples = list(predict(network, images, 5, seed=0))
    describe_images(network, images)
    assert sum(shown) == len(samples) == 40
    again = features_of(network, images.select(every))
    assert torch.equal(again[:25], features)
    assert sum(shown) == 40
    repeated = features_of(network, images.select(np.resize(every, 90)))  # as while a step is timed
    assert torch.equal(repeated[40:80], again)
    assert sum(shown) == 40


def test_a_copy_with_the_same_backbone_shares_what_was_seen_and_standardises_it_by_its_own_numbers(
    network, images, monkeypatch
):
    features = features_of(network, images)
    other = deepcopy(network)
    other.centre += other.spread
    shown = watched(other, monkeypatch)
    torch.testing.assert_close(features_of(other, images), features - 1.0)
    assert not shown


def test_another_backbone_sees_the_images_anew(network, images):
    features = features_of(network, images)
    torch.manual_seed(1)
    other = RetrievalRegressor(RETRIEVAL, BOX).eval()
    other.standardise_like(network)
    assert (features_of(other, images) - features).abs().max() > 0.01
    assert torch.equal(features_of(network, images), features)


def test_a_backbone_that_learns_sees_the_images_whenever_asked(images):
    network = VariationalPoseRegressor(NETWORK, BOX)
    before = describe_images(network, images)
    assert network.training  # as it was
    with torch.no_grad():
        network.backbone.conv1.weight.mul_(1.5)
    assert np.abs(describe_images(network, images) - before).max() > 1e-3
