"""The viewer that writes a Rerun recording."""

import resource
from contextlib import contextmanager

import numpy as np
import pytest

from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from sequences.frame import Frame, Trajectory
from tests.helpers.pages import entities_of
from tests.helpers.simulated_run import simulated_steps
from vapor.reporting.rerun_place import Place
from vapor.reporting.rerun_viewer import RerunViewer


@pytest.fixture(scope="module")
def steps():
    return list(simulated_steps(25))


def test_a_recording_holds_image_belief_paths_and_plots(tmp_path, steps):
    path = tmp_path / "recording.rrd"
    with RerunViewer(path) as viewer:
        for frame, step in steps:
            viewer.log(frame, step.estimate, step.estimate.particles)
        assert not path.exists()
    assert list(tmp_path.iterdir()) == [path]
    assert path.stat().st_size < 25 * 40_000
    world = (
        "camera",
        "particles",
        "posterior",
        "posterior/cameras",
        "modes",
        "modes/weights",
        "modes/cameras",
        "truth",
    )
    shown = {f"/world/{name}" for name in (*world, "path/filter", "path/truth")}
    shown |= {"/belief/best_weight", "/status", "/error/position/filter", "/error/rotation/filter"}
    assert shown <= entities_of(path)


def test_the_place_and_what_is_known_at_the_end_are_recorded(tmp_path, steps):
    path = tmp_path / "recording.rrd"
    times_ns = np.array([frame.time_ns for frame, _ in steps])
    truth = Trajectory(times_ns, Poses.stack([frame.world_from_camera for frame, _ in steps]))
    with RerunViewer(path, place=Place(truth.poses, "training cameras")) as viewer:
        for frame, step in steps:
            viewer.log(frame, step.estimate, None)
        viewer.log_at_end({"filter": truth, "smoothed": truth, "dead_reckoning": truth, "kalman": truth}, truth)
    entities = entities_of(path)
    assert {"/world/place/training_cameras", "/world/place/training_cameras/looking"} <= entities
    for name in ("smoothed", "dead_reckoning"):
        assert {f"/world/path/{name}", f"/error/position/{name}", f"/error/rotation/{name}"} <= entities
    assert "/error/position/kalman" not in entities


def test_a_live_view_has_a_point_to_follow_and_a_recorded_one_has_none(tmp_path, steps):
    for live in (True, False):
        path = tmp_path / f"{live}.rrd"
        with RerunViewer(path, live=live) as viewer:
            viewer.log(steps[0][0], steps[0][1].estimate, None)
        assert ("/world/followed" in entities_of(path)) == live


def test_without_truth_camera_posterior_and_with_large_images_the_rest_is_recorded(tmp_path, steps):
    path = tmp_path / "recording.rrd"
    with RerunViewer(path) as viewer:
        for i, (_, step) in enumerate(steps[:3]):
            viewer.log(Frame(i * 10**8, np.full((960, 1280, 3), 90, np.uint8)), step.estimate, None)
    entities = entities_of(path)
    assert {"/world/camera", "/world/particles", "/world/path/filter"} <= entities


def test_an_error_in_the_loop_leaves_no_recording_and_keeps_the_old_one(tmp_path, steps):
    path = tmp_path / "recording.rrd"
    path.write_bytes(b"old")

    def fail():
        with RerunViewer(path) as viewer:
            viewer.log(steps[0][0], steps[0][1].estimate, None)
            raise OSError("camera unplugged")

    with pytest.raises(OSError, match="camera unplugged"):
        fail()
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


@contextmanager
def room_for(num_bytes):
    """No file of this process may become larger: as on a disk that is full, but with another word for it."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (num_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("num_bytes", [0, 20_000])
def test_a_recording_for_which_there_is_no_room_is_an_error_and_leaves_nothing(num_bytes, tmp_path, steps):
    path = tmp_path / "recording.rrd"
    viewer = RerunViewer(path)

    def record():
        with viewer:
            for frame, step in 40 * steps:  # more than a pipe holds
                viewer.log(frame, step.estimate, step.estimate.particles)

    said = r"recording\.rrd: the recording cannot be written: File too large.*--no-recording"
    with room_for(num_bytes), pytest.raises(VaporTrackError, match=said):
        record()
    assert list(tmp_path.iterdir()) == []


def test_a_recording_whose_last_bytes_find_no_room_is_an_error_and_leaves_nothing(tmp_path, steps):
    viewer = RerunViewer(tmp_path / "recording.rrd")
    viewer.log(steps[0][0], steps[0][1].estimate, None)
    with room_for(0), pytest.raises(VaporTrackError, match=r"recording\.rrd: the recording cannot be written"):
        viewer.close()
    assert list(tmp_path.iterdir()) == []


def test_a_viewer_of_nothing_and_a_missing_folder_are_refused(tmp_path):
    with pytest.raises(VaporTrackError, match="got neither"):
        RerunViewer()
    with pytest.raises(VaporTrackError, match="nowhere"):
        RerunViewer(tmp_path / "nowhere" / "recording.rrd")
