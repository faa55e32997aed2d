"""Every public name shows in `help` how it is used, and that runs."""

import doctest
import json
import threading
import time
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path

import cv2
import matplotlib
import numpy as np
import pytest
import torch
from matplotlib import pyplot

import vapor
from filtering.measurement_noise import MeasurementNoise
from filtering.se3 import Poses
from sequences.outputs import results_folder
from tests.helpers import live_session, textured_room
from tests.helpers.fake_transport import messages_of, offering
from tests.helpers.sequence_files import Walk, picture
from tests.helpers.simulated_run import simulated_record, simulated_steps
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.checkpoints.file_format import load_checkpoint, save_checkpoint
from vapor.landmarks.build import build, gather
from vapor.landmarks.landmark_map import ViewCamera
from vapor.landmarks.verify import Landmarks, grey_view
from vapor.pipeline.results import RESULTS, write_results
from vapor.reporting.modes_file import COLUMNS, write_modes
from vapor.robot import live

matplotlib.use("Agg")
OPTIONS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
DATA = {"PRESETS"}  # `help` of a mapping says what a mapping is; docs/api.md describes it


@pytest.fixture(scope="module")
def place(tmp_path_factory, tiny_model) -> Path:
    """A folder with what the examples name: a walk, a place's model, a room with landmarks, a run, poses."""
    folder = tmp_path_factory.mktemp("place")
    (folder / "place.safetensors").write_bytes(tiny_model.read_bytes())
    for name, count in {"walk": 25, "walk1": 8, "walk2": 8, "walk3": 21}.items():
        Walk(count).write(folder / f"{name}.mcap")
    _write_poses(folder)
    _write_images(folder / "images", [picture(0), picture(1)])
    _write_room(folder)
    with results_folder(folder / "result", "run", writes=RESULTS) as results:
        write_results(simulated_record(20), results, {}, title="simulated")
        with (results / "modes.csv").open("w") as modes:
            modes.write(f"{COLUMNS}\n")
            for frame, step in simulated_steps(20):
                write_modes(modes, frame.time_ns, step.estimate.modes)
    return folder


def _write_poses(folder: Path) -> None:
    times_ns, poses = zip(*Walk(25).truth, strict=True)
    truth = vapor.Trajectory(np.array(times_ns), Poses.stack(poses))
    noise = Poses.exp(0.01 * np.random.default_rng(0).standard_normal((25, 6)))
    vapor.write_tum(folder / "truth.tum", truth)
    vapor.write_tum(folder / "odometry.tum", replace(truth, poses=truth.poses[0].inverse() @ truth.poses))
    vapor.write_tum(folder / "estimates.tum", replace(truth, poses=truth.poses @ noise))


def _write_images(folder: Path, images) -> None:
    folder.mkdir()
    for number, image in enumerate(images):
        cv2.imwrite(str(folder / f"{number:04d}.png"), image[..., ::-1])


def _write_room(folder: Path) -> None:
    """Images of a room, and a network that knows nothing with a map of its landmarks."""
    room, camera, poses = textured_room.Room(), textured_room.CAMERA, textured_room.walk(30)
    _write_images(folder / "room", [room.view(pose) for pose in textured_room.walk(8, seed=5)])
    (folder / "room" / "intrinsics.json").write_text(json.dumps(asdict(camera)))
    material = gather(lambda image: grey_view(room.view(poses[image]), camera), poses, camera, scale_m=1.0)
    assert material is not None
    built = build(material, ViewCamera(camera))
    assert built is not None
    stored = load_checkpoint(folder / "place.safetensors")
    errors = replace(stored.calibration.errors, verified=MeasurementNoise())
    calibration = replace(stored.calibration, errors=errors)
    with_landmarks = replace(stored, camera=camera, calibration=calibration, landmarks=Landmarks(built.landmarks))
    assert isinstance(with_landmarks, Checkpoint)
    save_checkpoint(folder / "room.safetensors", with_landmarks, store_float16=True)


@pytest.fixture
def robot(place, monkeypatch) -> Iterator[None]:
    """A robot, for those who join its system: it drives the walk again and again."""
    live_session.hurry(monkeypatch)
    stopped = threading.Event()
    threads = []

    def join(_):
        transport = offering(messages_of(place / "walk.mcap"))

        def drive() -> None:
            while not stopped.is_set() and not transport.is_closed:
                for raw in messages_of(place / "walk.mcap"):
                    transport.say(raw)
                    time.sleep(0.002)

        threads.append(threading.Thread(target=drive))
        threads[-1].start()
        return transport

    monkeypatch.setattr(live, "join", join)
    yield
    stopped.set()
    for thread in threads:
        thread.join()


def test_only_data_has_no_example_of_its_own():
    assert not any(callable(getattr(vapor, name)) for name in DATA)


@pytest.mark.parametrize("name", [name for name in vapor.__all__ if name not in DATA])
def test_the_example_of_a_public_name_runs(name, place, robot, monkeypatch, unchecked, knowing):
    monkeypatch.chdir(place)
    found = doctest.DocTestFinder().find(getattr(vapor, name), name, module=False, globs={})
    assert any(test.examples for test in found), f"{name} has no example"
    torch.manual_seed(0)
    runner = doctest.DocTestRunner(optionflags=OPTIONS)
    said: list[str] = []
    for test in found:
        runner.run(test, out=said.append)
    pyplot.close("all")
    assert not runner.failures, "".join(said)
