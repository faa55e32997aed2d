"""The kinds of trials: what happens in each, and which walk it is cut from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal

from sequences.paths import IMAGE_RATE_HZ, Cues


@dataclass(frozen=True)
class TrialKind:
    """What the trials of a kind have in common.

    Attributes:
        meaning: What happens, in words.
        cues: What is unique along the walks that they are cut from.
        cut: How: "window", a segment with a landmark in view in its first half; "kidnap", two segments; "whole", a
            whole walk; "stand", a walk that ends where the camera stops and stands for minutes.
        like: The kind whose figures describe them: whether the filter finds itself ("cue"), whether it is confident of
            a wrong place ("no-cue"), or whether it recovers ("kidnap").
        recorded_hz: Images a second of the recordings.
        stride: Only every so many of these images are seen.
        scale: Factor on all lengths: of samples, truth and odometry, and of their errors.
        in_sequences: Whether they are also cut into short sequences, in each of which methods begin anew.
    """

    meaning: str
    cues: Cues
    cut: Literal["window", "kidnap", "whole", "stand"]
    like: Literal["cue", "no-cue", "kidnap"]
    recorded_hz: float = IMAGE_RATE_HZ
    stride: int = 1
    scale: float = 1.0
    in_sequences: bool = False


# To add a kind: a name, and what happens.
KINDS: Mapping[str, TrialKind] = MappingProxyType(
    {
        "cue": TrialKind("something unique in the first half", "early", "window", "cue"),
        "no-cue": TrialKind("nothing unique", "none", "whole", "no-cue"),
        "kidnap": TrialKind("carried off", "early", "kidnap", "kidnap"),
        "walk": TrialKind("whole walks, something unique early", "early", "whole", "cue", in_sequences=True),
        "rate-3": TrialKind("3 images a second", "early", "whole", "cue", 30.0, 10),
        "rate-10": TrialKind("10 images a second", "early", "whole", "cue", 30.0, 3),
        "rate-30": TrialKind("30 images a second", "early", "whole", "cue", 30.0),
        "scale-0.1": TrialKind("as cue, lengths times 0.1", "early", "window", "cue", scale=0.1),
        "scale-30": TrialKind("as cue, lengths times 30", "early", "window", "cue", scale=30.0),
        "standing": TrialKind("standing where nothing is unique", "none", "stand", "no-cue"),
        "standing-cue": TrialKind("standing before something unique", "early", "stand", "no-cue"),
        "standing-30": TrialKind(
            "standing where nothing is unique, 30 images a second", "none", "stand", "no-cue", 30.0
        ),
        "standing-cue-30": TrialKind(
            "standing before something unique, 30 images a second", "early", "stand", "no-cue", 30.0
        ),
    }
)
"""Kinds by name. Those at several rates are the same walks, and so are those that stand at 10 and at 30 Hz."""

if TYPE_CHECKING:
    Kind = str
else:
    Kind = Literal[tuple(KINDS)]
    """A name in `KINDS`."""

STAND_AFTER, STAND_S = 50, 300.0
"""The image at which the camera stops at the earliest, at ten a second, and for how many seconds it stands."""


def walk_frames(kind: Kind, frames: int) -> int:
    """Images, at ten a second, of the walks that trials of so many images are cut from."""
    of = KINDS[kind]
    if of.cut == "stand" and of.cues == "none":
        return STAND_AFTER + 1
    return frames if of.cut == "whole" else 2 * frames


def recorded_images(kind: Kind, images: int) -> int:
    """Number of images of the recordings in the time of so many images at ten a second."""
    return round(images * KINDS[kind].recorded_hz / IMAGE_RATE_HZ)
