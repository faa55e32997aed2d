"""Live localization of a walk in a made-up system, by a model that knows where its images were taken."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from filtering.error_model import ErrorModel
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from sequences.options import ReadingOptions
from sequences.recordings.message_definitions import decoder, encoder
from sequences.recordings.source import RawMessage
from tests.helpers.fake_transport import FakeTransport, messages_of, offering
from tests.helpers.live_system import ANSWERS
from tests.helpers.sequence_files import BEGIN_NS, picture, world_from_camera
from vapor.observation import VaporObservationModel
from vapor.pipeline.model import LoadedModel
from vapor.robot import health, session
from vapor.robot.config import LiveConfig
from vapor.robot.estimate import LiveEstimate
from vapor.robot.session import LiveSession

ELSEWHERE = Poses.exp(np.array([0.0, 0.0, 30.0, 0.0, 0.0, 0.0]))


class KnowingModel(VaporObservationModel):
    """An observation model that knows when each colour was seen; of a walk of at most twelve images.

    Args:
        places: How many places look alike: with two, the second is 30 m above.
        seconds: How long an image takes.
    """

    def __init__(self, places: int = 1, seconds: float = 0.0) -> None:
        self.places, self.seconds = places, seconds
        calibration = SimpleNamespace(errors=ErrorModel(), odometry=None)
        self.description: Any = SimpleNamespace(calibration=calibration, prior_poses=Poses.identity(3))
        self.verifier = None

    @property
    def notices(self) -> list[str]:
        return []

    def seen_by(self, camera: Any) -> "KnowingModel":
        return self

    def observe(self, image: np.ndarray, *, rng: np.random.Generator) -> PosePosterior:
        time.sleep(self.seconds)
        index = int(np.argmin([np.abs(picture(i)[0, 0].astype(int) - image[5, 5]).sum() for i in range(12)]))
        truth = world_from_camera(BEGIN_NS + 100_000_000 * index)
        seen = [truth if n == 0 else ELSEWHERE @ truth for n in range(self.places)]
        noise = Poses.exp(rng.normal(0.0, 0.005, (200, 6)))
        samples = Poses.concatenate([Poses.stack([pose] * 200) @ noise for pose in seen])
        return PosePosterior.from_samples(samples, ErrorModel())


@dataclass
class Running:
    """A session that runs in a thread.

    Attributes:
        transport: Its system.
        estimates: What it told the callback.
        told: What it told a person.
        error: What it ended by; None where it was stopped.
    """

    transport: FakeTransport
    session: LiveSession
    estimates: list[LiveEstimate]
    told: list[str]
    error: BaseException | None = None

    def messages(self, name: str) -> list[Any]:
        """What was published under /estimate, on /tf or on /diagnostics."""
        topic = f"/{name}" if name in ("tf", "diagnostics") else f"/estimate/{name}"
        kind = ANSWERS[topic]
        return [decoder(kind)(data) for data in list(self.transport.published[topic])]

    def say(self, raws: list[RawMessage]) -> None:
        """Send messages, and wait for images to be localized before the next is sent."""
        for raw in raws:
            self.transport.say(raw)
            if raw.topic.startswith("/odom"):
                time.sleep(0.001)

    def control(self, topic: str, kind: str = "std_msgs/Empty", **fields: Any) -> None:
        """Send one message as a person would."""
        self.transport.say(RawMessage(topic, time.time_ns(), encoder(kind)(fields), kind, "cdr", b""))

    def wait(self, condition: Any, timeout_s: float = 10.0) -> None:
        """Wait until something is so."""
        end_s = time.monotonic() + timeout_s
        while not condition():
            assert time.monotonic() < end_s, self.told
            assert self.error is None, self.error
            time.sleep(0.005)

    def wait_for(self, number: int) -> None:
        """Wait until so many images were localized."""
        self.wait(lambda: len(self.estimates) >= number)


def knowing(model: KnowingModel) -> LoadedModel:
    return LoadedModel("knowing", Path("knowing.safetensors"), "", model)


@contextmanager
def running(
    walk: Path,
    *,
    model: KnowingModel | None = None,
    reading: ReadingOptions | None = None,
    on_estimate: Any = None,
    **settings: Any,
) -> Iterator[Running]:
    """A session in a system that offers the topics of a walk."""
    transport = offering(messages_of(walk))
    loaded = knowing(model or KnowingModel())
    told: list[str] = []
    localization = LiveSession(loaded, transport, reading or ReadingOptions(), LiveConfig(**settings), tell=told.append)
    estimates: list[LiveEstimate] = []
    run = Running(transport, localization, estimates, told)

    def work() -> None:
        try:
            localization.run(on_estimate or estimates.append)
        except BaseException as error:
            run.error = error

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield run
    finally:
        localization.stop()
        thread.join(10)
        assert not thread.is_alive()


def hurry(patch: pytest.MonkeyPatch) -> None:
    """Have everything that waits for seconds wait for a tenth of that."""
    from sequences.live import reader

    patch.setattr(reader, "_SETTLED_S", 0.03)
    patch.setattr(reader, "_ASK_AGAIN_S", 0.01)
    patch.setattr(reader, "_REPORT_AGAIN_S", 0.1)
    patch.setattr(session, "_TICK_S", 0.05)
    patch.setattr(health, "_SILENT_S", 0.2)
    patch.setattr(health, "_ODOMETRY_SILENT_S", 0.1)
