"""Networks can be recorded as a CUDA graph: a pass copies nothing from the processor, which shows without a GPU."""

import pytest
import torch
from torch.overrides import TorchFunctionMode

from tests.helpers.checkpoints import an_image, any_checkpoint, noise
from vapor.engines.torch_engine import WholeNetwork
from vapor.regressors.network_config import REGRESSORS

_COPIES = torch.tensor, torch.as_tensor, torch.from_numpy, torch.Tensor.new_tensor, torch.Tensor.to, torch.Tensor.item


class _NoCopies(TorchFunctionMode):
    def __torch_function__(self, func, types, args=(), kwargs=None):
        onto = func is torch.Tensor.to and not any(isinstance(a, str | torch.device) for a in args[1:])
        assert func not in _COPIES or onto, f"{func} within a pass"
        return func(*args, **(kwargs or {}))


@pytest.mark.parametrize("head", REGRESSORS)
def test_a_pass_makes_no_tensor_of_numbers(head):
    whole = WholeNetwork(any_checkpoint(head))
    inputs = torch.from_numpy(an_image()), torch.from_numpy(noise(whole.network.noise_dim))
    with torch.inference_mode(), _NoCopies():
        whole(*inputs)
