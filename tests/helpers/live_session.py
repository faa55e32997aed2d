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

from filtering.measurement_noise import MeasurementNoise
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from sequences.options import ReadingOptions
from sequences.recordings.message_definitions import decoder, encoder
from sequences.recordings.source import RawMessage
from tests.helpers.fake_transport import FakeTransport, messages_of, offering
from tests.helpers.live_system import ANSWERS
from tests.helpers.sequence_files import BEGIN_NS, IMAGES, picture, world_from_camera
from vapor.observation import VaporObservationModel
from vapor.pipeline.model import LoadedModel
from vapor.robot import health, session
from vapor.robot.belief import LiveEstimate
from vapor.robot.config import LiveConfig
from vapor.robot.session import LiveSession

ELSEWHERE = Poses.exp(np.array([0.0, 0.0, 30.0, 0.0, 0.0, 0.0]))


class KnowingModel(VaporObservationModel):
    """An observation model that recognizes the colours of a walk of at most twelve images, in some seconds each.

    Of two places that look alike the second is 30 m above the first. Samples err by `spread_m`, drawn anew each time.
    """

    def __init__(self, places: int = 1, seconds: float = 0.0, spread_m: float = 0.005) -> None:
        self.places, self.seconds, self.spread_m = places, seconds, spread_m
        calibration = SimpleNamespace(errors=MeasurementNoise(), odometry=None)
        self.description: Any = SimpleNamespace(
            calibration=calibration,
            prior_poses=Poses.identity(3),
            memory_poses=None,
            cameras=(),
            camera=None,
            landmarks=None,
        )
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
        noise = Poses.exp(rng.normal(0.0, self.spread_m, (200, 6)))
        samples = Poses.concatenate([Poses.stack([pose] * 200) @ noise for pose in seen])
        return PosePosterior.from_samples(samples, MeasurementNoise())


@dataclass
class Running:
    """A session that runs in a thread; `estimates` went to its callback, `told` to the user."""

    transport: FakeTransport
    session: LiveSession
    estimates: list[LiveEstimate]
    told: list[str]
    error: BaseException | None = None

    def messages(self, name: str) -> list[Any]:
        """Messages published under /estimate, on /tf or on /diagnostics."""
        topic = f"/{name}" if name in ("tf", "diagnostics") else f"/estimate/{name}"
        kind = ANSWERS[topic]
        return [decoder(kind)(data) for data in list(self.transport.published[topic])]

    def control(self, topic: str, kind: str = "std_msgs/Empty", **fields: Any) -> None:
        self.transport.say(RawMessage(topic, time.time_ns(), encoder(kind)(fields), kind, "cdr", b""))

    def wait(self, condition: Any, timeout_s: float = 10.0) -> None:
        end_s = time.monotonic() + timeout_s
        while not condition():
            assert time.monotonic() < end_s, self.told
            assert self.error is None, self.error
            time.sleep(0.005)

    def wait_told(self, text: str) -> None:
        self.wait(lambda: any(text in line for line in self.told))

    def wait_until_subscribed(self, topic: str = IMAGES) -> None:
        self.wait(lambda: any(each.topic == topic for each in self.transport.subscribed))

    def wait_for_error(self, timeout_s: float = 5.0) -> BaseException:
        end_s = time.monotonic() + timeout_s
        while self.error is None:
            assert time.monotonic() < end_s, self.told
            time.sleep(0.01)
        return self.error

    def status(self) -> Any:
        """The latest diagnostics, the first of which are waited for."""
        self.wait(lambda: self.transport.published["/diagnostics"])
        return self.messages("diagnostics")[-1].status[0]

    def values(self) -> dict[str, str]:
        """Values of the latest diagnostics."""
        return {each.key: each.value for each in self.status().values}

    def wait_for(self, number: int) -> None:
        self.wait(lambda: len(self.estimates) >= number)


def replayed(run: Running, walk: Path, *, images: int = 12, skip: tuple[str, ...] = ("/ground_truth/pose",)) -> None:
    """Send a walk, and wait for each image to be localized, so that none is overtaken."""
    sent = 0
    run.wait_until_subscribed()
    for raw in messages_of(walk):
        if raw.topic in skip:
            continue
        if raw.topic == IMAGES:
            if sent >= 1:
                run.wait_for(sent)
            if sent == images:
                return
            sent += 1
        run.transport.say(raw)
        time.sleep(0.003)
    run.wait_for(sent)


def knowing(model: KnowingModel) -> LoadedModel:
    return LoadedModel("knowing", Path("knowing.safetensors"), "", model)


@contextmanager
def running(
    walk: Path,
    *,
    model: KnowingModel | LoadedModel | None = None,
    reading: ReadingOptions | None = None,
    without: tuple[str, ...] = (),
    on_estimate: Any = None,
    **settings: Any,
) -> Iterator[Running]:
    """A session in a system that offers the topics of a walk, but for some."""
    transport = offering([raw for raw in messages_of(walk) if raw.topic not in without])
    loaded = model if isinstance(model, LoadedModel) else knowing(model or KnowingModel())
    told: list[str] = []
    localization = LiveSession(loaded, transport, reading or ReadingOptions(), LiveConfig(**settings), told.append)
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
    """Shorten waits of seconds to a tenth."""
    from sequences.live import opening, sensors

    patch.setattr(opening, "_SETTLED_S", 0.03)
    patch.setattr(opening, "_ASK_AGAIN_S", 0.01)
    patch.setattr(opening, "_REPORT_AGAIN_S", 0.1)
    patch.setattr(opening, "_WITHOUT_ODOMETRY_S", 0.5)
    patch.setattr(sensors, "_SILENT_S", 0.5)
    patch.setattr(session, "_TICK_S", 0.05)
    patch.setattr(health, "_SILENT_S", 0.2)
    patch.setattr(health, "_ODOMETRY_SILENT_S", 0.1)
