"""Live localization from Python: a callback, or `async for`."""

from __future__ import annotations

from collections.abc import Callable

from sequences.live.transport import DdsOptions, Transport, join
from sequences.options import ReadingOptions
from vapor.pipeline.model import LoadedModel, load_model
from vapor.robot.config import LiveConfig
from vapor.robot.session import LiveSession


def live(
    model: str | LoadedModel,
    config: LiveConfig | None = None,
    *,
    system: DdsOptions | Transport | None = None,
    reading: ReadingOptions | None = None,
    notify: Callable[[str], None] = lambda _: None,
) -> LiveSession:
    """Localize a robot from its topics while it moves, and publish where it is.

    `async for estimate in live("model.safetensors")`, or `live("model.safetensors").run(callback)`.

    Args:
        model: Model file, name of a model that ships with the package, or the result of `load_model`.
        config: Settings.
        system: The ROS 2 system to join, or a transport of one's own, which is closed at the end.
        reading: Topics to read; None for those that are found.
        notify: Called with each line for a person.

    Raises:
        VaporTrackError: no such model, or the system cannot be joined.

    Example:
        >>> import asyncio
        >>> import vapor
        >>> async def follow():
        ...     async for now in vapor.live("place.safetensors", vapor.LiveConfig(tf=False)):
        ...         if now.estimate.status != "lost":
        ...             return now.map_from_base.translation
        >>> asyncio.run(follow()).shape
        (3,)
    """
    config = config or LiveConfig()
    loaded = load_model(model, config) if isinstance(model, str) else model
    transport = join(system) if system is None or isinstance(system, DdsOptions) else system
    return LiveSession(loaded, transport, reading or ReadingOptions(), config, notify)
