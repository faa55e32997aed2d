"""AugmentConfig: how training images are varied. No torch is needed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from filtering.errors import require_within


@dataclass(frozen=True)
class AugmentConfig:
    """Augmentation of training images; an amount a means a factor drawn from [1 − a, 1 + a]."""

    crop: Literal["central", "anywhere"] = "central"
    """central: crops from the middle, of the network's aspect; anywhere: crops from the whole image. A crop far off
    centre shows the view of a turned camera."""
    brightness: float = 0.3
    """Amount of brightness."""
    contrast: float = 0.3
    """Amount of contrast about the image's mean grey."""
    saturation: float = 0.3
    """Amount of saturation."""
    colour: float = 0.1
    """Amount of each colour channel's own gain."""
    blur_probability: float = 0.3
    """Fraction of the images that are blurred."""
    blur_sigma_px: float = 1.0
    """Largest standard deviation of the Gaussian blur, pixels; each is drawn from half of it up."""
    light: float = 0.0
    """Standard deviation of the logarithm of uneven light, as of lamps at another hour."""

    def __post_init__(self) -> None:
        require_within(
            self,
            light=(0.0, 3.0),
            brightness=(0.0, 1.0),
            contrast=(0.0, 1.0),
            saturation=(0.0, 1.0),
            colour=(0.0, 1.0),
            blur_probability=(0.0, 1.0),
            blur_sigma_px=(0.0, 1e3),
        )
