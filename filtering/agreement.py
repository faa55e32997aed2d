"""Do the images fit the belief? The agreement of all cameras, and which camera disagrees with the others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from filtering.belief import Belief
from filtering.config import LocalizerConfig
from filtering.observation import View
from filtering.unchecked import unchecked_replace

_USUAL_S = 10.0  # time over which the usual agreement is averaged
_DISAGREES = 0.5  # of the agreement of the other cameras, below which a camera is left out
_RECENT_S = 2.0  # a camera sees places at this time that saw one within so many seconds


def follow_agreement(belief: Belief, fits: Sequence[float], views: Sequence[View], config: LocalizerConfig) -> Belief:
    """Average the fraction of the belief that fits the latest images.

    Nothing fits an image out of distribution; it counts where those of other cameras do not fit either.

    Args:
        belief: After these images.
        fits: The fraction of it that fits each image that counts.
        views: All images of the moment.
        config: Settings.
    """
    out_of_distribution = sum(
        view.posterior.is_out_of_distribution and agreement_of_others(belief, view.camera) < config.lost_agreement
        for view in views
    )
    if not fits and not out_of_distribution:
        return belief
    follow = following(belief.unseen_s, config)
    share = sum(fits) / (len(fits) + out_of_distribution)
    agreement = belief.agreement + follow * (share - belief.agreement)
    usual = belief.usual_agreement - np.expm1(-belief.unseen_s / _USUAL_S) * (agreement - belief.usual_agreement)
    return unchecked_replace(belief, agreement=agreement, usual_agreement=usual, unseen_s=0.0)


def following(unseen_s: float, config: LocalizerConfig) -> float:
    """Fraction by which an average agreement follows an image, so many seconds after the one before."""
    per_image = 1.0 / config.agreement_images
    return min(-float(np.expm1(-unseen_s / config.agreement_s)), per_image) if unseen_s > 0.0 else per_image


def disagrees(belief: Belief, name: str, config: LocalizerConfig) -> bool:
    """Whether a camera's views fit hardly ever while those of the others fit, as with a wrong mount or clock."""
    others = agreement_of_others(belief, name)
    return others >= config.converged_agreement and belief.cameras[name].agreement < _DISAGREES * others


def agreement_of_others(belief: Belief, name: str) -> float:
    """The average agreement of the cameras but one that see places at this time, in [0, 1]; 0 where none does."""
    others = [
        camera.agreement for other, camera in belief.cameras.items() if other != name and camera.unseen_s < _RECENT_S
    ]
    return float(np.mean(others)) if others else 0.0
