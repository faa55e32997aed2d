"""The faults of the benchmark: what breaks, and for how long."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import numpy as np
from jaxtyping import Int64

from vapor.benchmark.faults import effects, timing
from vapor.benchmark.faults.timing import BEHIND_S, image_after, images_in
from vapor.benchmark.trials.replay import Replay

NONE = "none"
"""The name of the run without a fault."""

Film = Literal["black", "noise", "upside-down", "elsewhere", "three-times"]
"""Images that the network sees instead of those of the walk; the last: all of them, and two more after each."""


@dataclass(frozen=True)
class Fault:
    """Something that breaks.

    Attributes:
        meaning: What, as the tables call it.
        cause: What it changes in a replay, or what the camera shows instead.
        lasts: For `FAULT_S`, to the end of the walk, or throughout the walk.
        delay_s: By how many seconds it delays something; where images are further apart, it changes nothing.
    """

    meaning: str
    cause: Callable[[Replay, range], Replay] | Film
    lasts: Literal["a while", "to the end", "throughout"] = "a while"
    delay_s: float | None = None

    def during(self, begin: int, times_ns: Int64[np.ndarray, " n"]) -> range:
        """The images of a walk that are affected, where the fault begins at one of them."""
        if self.lasts == "a while":
            return range(begin, image_after(timing.FAULT_S, begin, times_ns))
        return range(0 if self.lasts == "throughout" else begin, len(times_ns))


# To add a fault: a name, what the tables call it, and a function of `effects` or the name of a film.
FAULTS: Mapping[str, Fault] = MappingProxyType(
    {
        "black": Fault("black images", "black"),
        "frozen": Fault("a frozen image", effects.frozen),
        "upside-down": Fault("images upside down", "upside-down"),
        "no-images": Fault("no images", effects.no_images),
        "standing-still": Fault("odometry stands still", effects.standing_still),
        "tripled": Fault("odometry tripled", effects.tripled),
        "reset": Fault("odometry back at its origin", effects.set_back),
        "scale": Fault("odometry 20 % long", effects.too_long),
        "scale-throughout": Fault("odometry 20 % long, always", effects.too_long, "throughout"),
        "late": Fault("odometry 0.2 s late, always", effects.late, "throughout", BEHIND_S),
        "ahead": Fault("camera's clock 1 s ahead", effects.ahead),
        "a-third": Fault("a third of images, always", effects.a_third, "throughout"),
        "three-times": Fault("3 times the images, always", "three-times", "throughout"),
        "elsewhere": Fault("another scene, to the end", "elsewhere", "to the end"),
        "noise": Fault("noise, to the end", "noise", "to the end"),
        "turned-over": Fault("upside down, to the end", "upside-down", "to the end"),
    }
)
"""Faults by name."""


def impossible(times_ns: Int64[np.ndarray, " n"]) -> list[str]:
    """Faults that would change nothing at the rate of these stamps (n,): delays of less than one image."""
    delays = {name: fault.delay_s for name, fault in FAULTS.items() if fault.delay_s is not None}
    return [name for name, delay_s in delays.items() if len(times_ns) < 2 or not images_in(delay_s, times_ns)]
