"""A network from an image's bytes to poses, and to the image's description: the part that engines have in common."""

from __future__ import annotations

import torch
from jaxtyping import Float32, UInt8
from torch import Tensor, nn

from vapor.checkpoints.checkpoint import Checkpoint
from vapor.regressors.describer import Describer


class WholeNetwork(nn.Module):
    """One image and noise in; positions, rotations and, where the model says what is familiar, a description out.

    Args:
        checkpoint: A trained model.
    """

    def __init__(self, checkpoint: Checkpoint) -> None:
        super().__init__()
        self.network = checkpoint.build_network()
        self.described = checkpoint.familiarity is not None
        self._describer = Describer(self.network) if self.described else None

    def forward(
        self, image: UInt8[Tensor, "h w 3"], noise: Float32[Tensor, "m d"]
    ) -> tuple[Float32[Tensor, "m 3"], Float32[Tensor, "m 3 3"]] | tuple[Tensor, Tensor, Float32[Tensor, " n"]]:
        """Posterior samples for given noise; networks that draw nothing take as many as there are rows of it."""
        images = image[None]
        translation, rotation = self.network(self.network.normalise(images), noise[None])
        if self._describer is None:
            return translation[0], rotation[0]
        return translation[0], rotation[0], self._describer.last(images)[0]


def traced_inputs(whole: WholeNetwork, *, samples: int = 20) -> tuple[UInt8[Tensor, "h w 3"], Float32[Tensor, "m d"]]:
    """An image and noise by which a network is traced; then it takes any number of rows of noise.

    The noise has one column at least, as formats of networks have no empty inputs: what draws nothing ignores it.
    """
    config, generator = whole.network.config, torch.Generator().manual_seed(0)
    shape = (config.image_height, config.image_width, 3)
    image = torch.randint(0, 256, shape, dtype=torch.uint8, generator=generator)
    return image, torch.randn(samples, max(1, whole.network.noise_dim), generator=generator)
