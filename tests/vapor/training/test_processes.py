"""One training by several processes: the losses of one, and what cannot be shared."""

import socket
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest

from tests.helpers.full import full
from tests.helpers.tiny_training import TINY, Interrupted, interrupt_at, walks
from vapor.training import processes
from vapor.training.presets import METHODS
from vapor.training.processes import joined_processes, own_part, require_shares
from vapor.training.train import train_on
from vapor.training_data.training_set import TrainingError

SMALL = replace(TINY, epochs=3, batch_size=24, calibrate=False, finish=0.34)
SHARED = METHODS["retrieval"](SMALL)
SHARED = replace(SHARED, network=replace(SHARED.network, backbone="resnet18-quarter", components=6), finish=0.34)


def losses_of(output: Path) -> list[float]:
    losses: list[float] = []
    train_on(walks(), output, SHARED, progress=lambda p: losses.append(p.loss) if p.loss is not None else None)
    return losses


def second(variables: Mapping[str, str], output: Path) -> None:
    with pytest.MonkeyPatch.context() as patch:
        for name, value in variables.items():
            patch.setenv(name, value)
        with joined_processes("cpu"):
            train_on(walks(), output, SHARED)


@full
@pytest.mark.usefixtures("unchecked")
def test_two_processes_go_on_with_a_training_as_one_would_and_only_the_first_writes(tmp_path, monkeypatch):
    alone = losses_of(tmp_path / "alone.safetensors")
    output = tmp_path / "shared.safetensors"
    with suppress(Interrupted):
        train_on(walks(), output, SHARED, progress=interrupt_at(5))  # in the second epoch
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = str(server.getsockname()[1])
    variables = {"WORLD_SIZE": "2", "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": port, "TORCHELASTIC_RUN_ID": "none"}
    arguments = {**variables, "RANK": "1"}, tmp_path / "elsewhere.safetensors"  # where no state of it lies
    other = get_context("spawn").Process(target=second, args=arguments)
    other.start()
    for name, value in {**variables, "RANK": "0"}.items():
        monkeypatch.setenv(name, value)
    with joined_processes("cpu"):
        together = losses_of(output)
    other.join(30)
    assert other.exitcode == 0
    assert len(alone) == 3 + 3 + 3 + 4  # three epochs of three walks, and one of all four
    np.testing.assert_allclose(together, alone[3:], rtol=1e-4)
    assert {path.name for path in tmp_path.iterdir()} == {"alone.safetensors", "shared.safetensors"}


def test_parts_of_a_batch_make_up_the_whole_and_pairs_stay_together(monkeypatch):
    monkeypatch.setattr(processes, "num_processes", lambda: 4)
    monkeypatch.setattr(processes, "is_first", lambda: False)
    parts = []
    for rank in range(4):
        monkeypatch.setattr(processes.dist, "get_rank", lambda rank=rank: rank)
        parts.append((own_part(16), own_part(16, pairs=True)))
    assert sorted(np.concatenate([plain for plain, _ in parts])) == list(range(16))
    for _, paired in parts:
        first, second = paired.reshape(2, -1)
        np.testing.assert_array_equal(second - first, 8)


def test_batches_that_cannot_be_shared_are_refused(monkeypatch):
    monkeypatch.setattr(processes, "num_processes", lambda: 3)
    require_shares(33, pairs=False)
    with pytest.raises(TrainingError, match=r"batches of 32 images cannot be shared by 3 processes, expected a mult"):
        require_shares(32, pairs=False)
    with pytest.raises(TrainingError, match="batches of 16 pairs of images cannot"):
        require_shares(33, pairs=True)


@pytest.mark.parametrize("device", ["cpu", "cuda"])
def test_processes_that_cannot_be_joined_or_have_no_gpu_each_are_told(device, monkeypatch):
    launched = {"RANK": "first", "LOCAL_RANK": "1", "WORLD_SIZE": "2", "TORCHELASTIC_RUN_ID": "none"}
    for name, value in {**launched, "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": "1"}.items():
        monkeypatch.setenv(name, value)

    def no_such_gpu(number):
        raise RuntimeError(f"CUDA error: invalid device ordinal {number}")

    monkeypatch.setattr(processes.torch.cuda, "set_device", no_such_gpu)
    monkeypatch.setattr(processes, "resolve_device", processes.torch.device)
    reason = "invalid device ordinal 1" if device == "cuda" else "'first'"
    with (
        pytest.raises(TrainingError, match=rf"process first of 2.*: cannot join the others \(.*{reason}"),
        joined_processes(device),
    ):
        pass
