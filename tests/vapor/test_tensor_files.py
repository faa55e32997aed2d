"""Checksums: no damage to a model or to the state of a training goes unnoticed, and files of before are told."""

import json

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from tests.helpers.checkpoints import SMALL, make_checkpoint
from vapor.checkpoints.file_format import SHIPPED, load_checkpoint, save_checkpoint
from vapor.evaluation.validation import Validation
from vapor.tensor_files import CHECKSUM, CheckpointError, content_sha256, read_safetensors, write_safetensors
from vapor.training.config import TrainConfig
from vapor.training.state import load_state, save_state, start

DAMAGED = r"m\.safetensors: (damaged: .* do not match its checksum, expected the file as it was|cannot be read .*exp)"


@pytest.fixture
def model(tmp_path):
    save_checkpoint(tmp_path / "m.safetensors", make_checkpoint(), store_float16=True)
    return tmp_path / "m.safetensors"


@pytest.fixture
def small(tmp_path):
    """A file of ours that is quickly read a thousand times."""
    tensors = {"a": torch.randn(30, 10), "b": torch.tensor(3), "c": torch.randn(8, 8).half()}
    metadata = {"format": "vapor-track model", "version": "8", "config": json.dumps({"seed": 3})}
    write_safetensors(tmp_path / "m.safetensors", tensors, metadata)
    return tmp_path / "m.safetensors"


def flipped(content, bit):
    damaged = bytearray(content)
    damaged[bit // 8] ^= 1 << bit % 8
    return bytes(damaged)


def overwritten(content, rng):
    begin, length = rng.integers(len(content) - 64), rng.integers(1, 64)
    return content[:begin] + rng.bytes(length) + content[begin + length :]


def swapped(content, rng):
    a, b = sorted(64 * rng.choice(len(content) // 64, 2, replace=False))
    return content[:a] + content[b : b + 64] + content[a + 64 : b] + content[a : a + 64] + content[b + 64 :]


def cut(content, rng):
    return content[: rng.integers(len(content))]


def refused(path, content):
    path.write_bytes(content)
    with pytest.raises(CheckpointError, match=DAMAGED):
        read_safetensors(path)


def test_any_flipped_bit_is_told(small):
    content, rng = small.read_bytes(), np.random.default_rng(0)
    header = 8 * (8 + int.from_bytes(content[:8], "little"))
    named = 8 * content.index(CHECKSUM.encode())
    in_name = range(named, named + 8 * len(CHECKSUM))
    for bit in [*in_name, *rng.choice(header, 200), *rng.integers(header, 8 * len(content), 100)]:
        refused(small, flipped(content, int(bit)))
    small.write_bytes(content)
    read_safetensors(small)


@pytest.mark.parametrize("damage", [overwritten, swapped, cut])
def test_a_file_that_was_overwritten_in_part_or_cut_or_shuffled_is_refused(small, damage):
    content, rng = small.read_bytes(), np.random.default_rng(0)
    for _ in range(40):
        damaged = damage(content, rng)
        assert damaged != content
        refused(small, damaged)


def test_the_checksum_is_of_names_types_shapes_and_bytes_of_tensors_and_of_all_other_metadata():
    tensors, metadata = {"a": torch.zeros(2, 3), "b": torch.tensor(1)}, {"format": "x"}
    others = [
        ({"c": tensors["a"], "b": tensors["b"]}, metadata),
        ({**tensors, "a": torch.zeros(2, 3, dtype=torch.int32)}, metadata),
        ({**tensors, "a": torch.zeros(3, 2)}, metadata),
        ({**tensors, "b": torch.tensor(2)}, metadata),
        ({"a": tensors["a"]}, metadata),
        (tensors, {"format": "y"}),
        (tensors, {"format": "x", "version": "1"}),
    ]
    assert len({content_sha256(*content) for content in [(tensors, metadata), *others]}) == 8
    assert content_sha256(tensors, {**metadata, CHECKSUM: "any"}) == content_sha256(tensors, metadata)
    strided = {**tensors, "a": torch.zeros(3, 2).T}
    assert content_sha256(strided, metadata) == content_sha256(tensors, metadata)


def test_a_file_of_ours_without_a_checksum_is_refused(model):
    metadata, tensors = read_safetensors(model)
    save_file(tensors, model, {name: value for name, value in metadata.items() if name != CHECKSUM})
    with pytest.raises(CheckpointError, match=DAMAGED):
        load_checkpoint(model)


def test_models_that_ship_state_their_camera():
    shipped = sorted(SHIPPED.glob("*.safetensors"))
    assert shipped
    for path in shipped:
        assert load_checkpoint(path).camera is not None


def test_files_of_others_are_taken_without_a_checksum(tmp_path):
    save_file({"a": torch.ones(2)}, tmp_path / "a.safetensors", {"format": "pt", "origin": "elsewhere"})
    assert read_safetensors(tmp_path / "a.safetensors")[1]["a"].tolist() == [1.0, 1.0]


def test_a_damaged_state_of_a_training_is_refused_with_what_to_do(tmp_path):
    path = tmp_path / "m.training.safetensors"
    checkpoint = make_checkpoint()
    config = TrainConfig(network=SMALL, device="cpu")
    state = start(config, checkpoint.box, checkpoint.prior_poses, None)
    save_state(path, state, {"seed": 0})
    content = path.read_bytes()
    load_state(path, state, {"seed": 0})
    path.write_bytes(flipped(content, 8 * len(content) - 100))
    with pytest.raises(CheckpointError, match=r"damaged: .*; remove the file, or train with --no-resume"):
        load_state(path, state, {"seed": 0})


def without_step(tensors: dict, config: dict) -> None:
    del tensors["optimizer.0.step"]


def other_best(tensors: dict, config: dict) -> None:
    tensors["best.x"] = torch.ones(1)


def words_in_history(tensors: dict, config: dict) -> None:
    config["history"] = [dict.fromkeys(Validation.__dataclass_fields__, "x")]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (without_step, r"the optimizer has moments other than .* expected a training's state; remove"),
        (other_best, r"Missing key.* expected a training's state; remove"),
        (words_in_history, r"history configuration has \w+ 'x', expected a "),
    ],
)
def test_a_state_that_no_training_wrote_is_refused_though_its_checksum_fits(change, said, tmp_path):
    path, checkpoint = tmp_path / "m.training.safetensors", make_checkpoint()
    state = start(TrainConfig(network=SMALL, device="cpu"), checkpoint.box, checkpoint.prior_poses, None)
    for weights in state.network.parameters():
        weights.grad = torch.zeros_like(weights)
    state.optimizer.step()
    save_state(path, state, {"seed": 0})
    load_state(path, state, {"seed": 0})
    metadata, tensors = read_safetensors(path)
    config = json.loads(metadata["config"])
    change(tensors, config)
    write_safetensors(path, tensors, {**metadata, "config": json.dumps(config)})
    with pytest.raises(CheckpointError, match=said):
        load_state(path, state, {"seed": 0})
