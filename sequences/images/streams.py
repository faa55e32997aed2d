"""Image messages of one topic, in order -> images: stills each by itself, video through a decoder that remembers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
from jaxtyping import UInt8

Image = UInt8[np.ndarray, "height width 3"]


class Picture(NamedTuple):
    """One image of a topic.

    Attributes:
        time_ns: Its stamp.
        decode: Gives the image, RGB; raises SequenceError where it cannot be decoded.
        skipped: Why there is no image, as a reason to count; '' where there is one.
    """

    time_ns: int
    decode: Callable[[], Image]
    skipped: str = ""


class ImageStream(ABC):
    """Messages of one topic in, images out, in order of their stamps but for what the messages are out of order.

    Attributes:
        remembers: Whether an image may need messages before its own, so that none may be left out.
    """

    remembers: bool = False

    @abstractmethod
    def take(self, time_ns: int, message: SimpleNamespace | None) -> Iterable[Picture]:
        """The images that a message brings, none that is later than a message taken; None for one that was lost."""

    def finish(self) -> Iterable[Picture]:
        """The images that remain once no message comes any more."""
        return ()


class Stills(ImageStream):
    """A stream whose every message is an image."""

    def __init__(self, decode: Callable[[SimpleNamespace], Image]) -> None:
        """Set up a stream from what decodes a message."""
        self._decode = decode

    def take(self, time_ns: int, message: SimpleNamespace | None) -> list[Picture]:
        """The image of the message."""
        return [] if message is None else [Picture(time_ns, lambda: self._decode(message))]
