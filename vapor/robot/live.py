"""Live localization from Python: a callback, or `async for`."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Callable

from filtering.errors import VaporTrackError
from sequences.live.options import DdsOptions
from sequences.live.transport import Transport, join
from sequences.options import ReadingOptions
from vapor.pipeline.model import LoadedModel, load_model
from vapor.robot.config import LiveConfig
from vapor.robot.estimate import LiveEstimate
from vapor.robot.session import LiveSession

_MOST_WAITING = 10  # each has its image


def live(
    model: str | LoadedModel,
    config: LiveConfig | None = None,
    *,
    system: DdsOptions | Transport | None = None,
    reading: ReadingOptions | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> Live:
    """Localize a robot from its topics while it moves, and publish where it is.

    `async for estimate in live("model.safetensors")`, or `live("model.safetensors").run(callback)`.

    Args:
        model: Model file, name of a model that ships with the package, or what `load_model` made of one.
        config: Settings.
        system: The ROS 2 system to join, or a transport of one's own, which is closed at the end.
        reading: What to read of it; None for what is found.
        tell: Told what a person should know, in a line.

    Raises:
        VaporTrackError: no such model, or the system cannot be joined.
    """
    config = config or LiveConfig()
    loaded = load_model(model, config) if isinstance(model, str) else model
    transport = join(system) if system is None or isinstance(system, DdsOptions) else system
    return Live(loaded, transport, reading or ReadingOptions(), config, tell)


class Live:
    """Live localization that has not begun yet, see `live`."""

    def __init__(
        self,
        model: LoadedModel,
        transport: Transport,
        reading: ReadingOptions,
        config: LiveConfig,
        tell: Callable[[str], None],
    ) -> None:
        self._transport, self._has_begun = transport, False
        self._session = LiveSession(model, transport, reading, config, tell=tell)

    def run(self, on_estimate: Callable[[LiveEstimate], None] = lambda _: None) -> None:
        """Localize until `stop` is called, or an interruption comes.

        Args:
            on_estimate: Called after every image; until it returns, nothing else goes on.

        Raises:
            VaporTrackError: the topics cannot be used, or what was asked for cannot be written or served.
        """
        if self._has_begun:
            raise VaporTrackError("this live localization has ended, expected another call of `live`")
        self._has_begun = True
        try:
            self._session.run(on_estimate)
        finally:
            self._transport.close()

    @property
    def skipped(self) -> dict[str, int]:
        """How many images were left out so far, by reason."""
        return self._session.skipped

    @property
    def localized(self) -> int:
        """How many images were localized so far."""
        return self._session.localized

    def stop(self) -> None:
        """Have it end soon; may be called from any thread."""
        self._session.stop()

    async def __aiter__(self) -> AsyncIterator[LiveEstimate]:
        """Estimates as they come, until the loop over them ends; of ten that wait the oldest is dropped.

        Raises:
            VaporTrackError: as `run`.
        """
        loop = asyncio.get_running_loop()
        waiting: asyncio.Queue[LiveEstimate | BaseException | None] = asyncio.Queue()

        def put(item: LiveEstimate | BaseException | None) -> None:
            if waiting.qsize() >= _MOST_WAITING:
                waiting.get_nowait()
            waiting.put_nowait(item)

        def work() -> None:
            end: BaseException | None = None
            try:
                self.run(lambda estimate: tell(estimate))
            except BaseException as error:
                end = error
            tell(end)

        def tell(item: LiveEstimate | BaseException | None) -> None:
            if not loop.is_closed():
                loop.call_soon_threadsafe(put, item)

        thread = threading.Thread(target=work, name="live", daemon=True)
        thread.start()
        try:
            while (item := await waiting.get()) is not None:
                if isinstance(item, BaseException):
                    raise item
                yield item
        finally:
            self.stop()
            await asyncio.to_thread(thread.join)
