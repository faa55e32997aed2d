"""Live localization by several cameras."""

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from filtering.measurement_noise import MeasurementNoise
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from filtering.vertical import KnownHeight, Vertical
from sequences.recordings.source import RawMessage
from tests.helpers.fake_transport import messages_of
from tests.helpers.live_session import KnowingModel, Running, hurry, running
from tests.helpers.rigs import FRONT, LEFT, RIGHT, Rig, pose_shown
from tests.helpers.sequence_files import BEGIN_NS, Walk, world_from_camera
from vapor.pipeline.verticals import Verticals
from vapor.robot import health, opening

NOISE = MeasurementNoise(length_m=0.03, length_rad=0.03)


class Knowing(KnowingModel):
    """Knows the pose of the left camera, too, which has wider images; what it learned from is `cameras`."""

    def __init__(self, cameras: tuple[str, ...], turned_rad: float = 0.0) -> None:
        super().__init__()
        self.description.cameras = cameras
        self.turned = Poses.exp(np.array([0.0, 0.0, 0.0, 0.0, turned_rad, 0.0]))

    def observe(self, image: np.ndarray, *, rng: np.random.Generator) -> PosePosterior:
        truth = pose_shown(image, self.turned)
        samples = Poses.stack([truth] * 100) @ Poses.exp(rng.normal(0.0, 0.005, (100, 6)))
        return PosePosterior.from_samples(samples, NOISE)


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    hurry(monkeypatch)


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return Rig({"left": 0, "right": 0}, {}).write(tmp_path_factory.mktemp("rig") / "rig.mcap", Walk(12))


def say(run: Running, raws: list[RawMessage], *, without: Any = ()) -> None:
    """Say all messages, and wait for each image that is localized."""
    number = 0
    for raw in raws:
        if raw.topic in without:
            continue
        run.transport.say(raw)
        if raw.topic in (FRONT, LEFT):
            run.wait(lambda least=number - 1: run.session.localized + sum(run.session.skipped.values()) >= least)
            number += 1


def opened(run: Running, raws: list[RawMessage]) -> None:
    for topic in (FRONT, LEFT, "/odom", "/tf_static"):
        run.wait_until_subscribed(topic)
    for raw in raws:
        if raw.topic == "/tf_static" or raw.topic.endswith("info"):
            run.transport.say(raw)
    first = {topic: next(raw for raw in raws if raw.topic == topic) for topic in (FRONT, LEFT, "/odom")}
    for raw in first.values():
        run.transport.say(raw)
    run.wait_told("localizes by")


def test_the_cameras_that_a_model_knows_localize_the_first_one(rig: Path) -> None:
    raws = messages_of(rig)
    with running(rig, model=Knowing((FRONT, LEFT))) as run:
        opened(run, raws)
        say(run, raws)
        run.wait(lambda: {each.frame.camera_name for each in run.estimates} == {FRONT, LEFT})
        run.wait(lambda: len(run.estimates) > 8)
        assert RIGHT not in {each.topic for each in run.transport.subscribed}
        for each in run.estimates:
            if each.time_ns >= BEGIN_NS:
                taken_ns = each.time_ns // 1000 * 1000 + 789
                found = each.estimate.modes[0].world_from_camera
                assert found.distance(world_from_camera(taken_ns))[0] < 0.05
        assert any(f"localizes by {FRONT}, {LEFT}" in line for line in run.told)


def test_a_camera_that_falls_silent_is_told_and_the_other_goes_on(rig: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(health, "_CAMERA_SILENT_S", 0.2)
    raws = messages_of(rig)
    with running(rig, model=Knowing((FRONT, LEFT))) as run:
        opened(run, raws)
        images = [raw for raw in raws if raw.topic == FRONT]
        for number in range(200):
            run.transport.say(images[number % len(images)])
            time.sleep(0.02)
            if any("no image of" in line for line in run.told):
                break
        run.wait_told(f"no image of {LEFT} for 0.2 s: the other cameras go on")


def test_a_camera_of_the_model_that_is_not_there_is_told(rig: Path) -> None:
    raws = messages_of(rig)
    with running(rig, model=Knowing((FRONT, LEFT, "/rear/image"))) as run:
        opened(run, raws)
        run.wait_told("without /rear/image, which the model learned from, too: not there at the start")


def test_a_robots_tilt_is_known_of_the_camera_that_is_localized(rig: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[bool, float]] = []

    class Robot(Verticals):
        def step(self, posterior: PosePosterior, gravity: Any = None, *, is_localized: bool = True) -> Vertical | None:
            off_m = posterior.means[0].distance(world_from_camera(BEGIN_NS))[0]
            asked.append((is_localized, float(off_m)))
            return Vertical(heights=KnownHeight(1.0, 100.0))

    monkeypatch.setattr(opening, "Verticals", Robot)
    raws = messages_of(rig)
    with running(rig, model=Knowing((FRONT, LEFT))) as run:
        opened(run, raws)
        say(run, raws)
        run.wait(lambda: len(run.estimates) > 6)
    assert {is_localized for is_localized, _ in asked} == {True, False}
    assert max(off_m for _, off_m in asked) < 1.0  # of the camera that is localized, whichever took the image
    assert run.estimates[-1].estimate.status == "converged"
