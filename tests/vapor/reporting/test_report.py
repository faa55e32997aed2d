"""What a run leaves behind: the record, report.json and the table."""

import json
from functools import partial

import numpy as np
import pytest
from rich.console import Console

from filtering.errors import VaporTrackError
from tests.helpers.simulated_run import simulated_record, simulated_steps
from vapor.reporting.record import EvenlySpaced, RunRecorder, choose_keyframes
from vapor.reporting.report import build_report, format_table, is_report, write_report
from vapor.tracking.follow import dead_reckoning


@pytest.fixture(scope="module")
def record():
    return simulated_record(150)


def rendered(report) -> str:
    console = Console(width=120, record=True, file=open("/dev/null", "w"))  # noqa: SIM115
    console.print(format_table(report))
    return console.export_text()


def test_the_record_holds_every_image_in_order(record):
    frames, steps = zip(*simulated_steps(150), strict=True)
    singles = [step.image_modes[0].world_from_camera for step in steps]
    estimates = [step.estimate for step in steps]
    assert record.times_ns.tolist() == [frame.time_ns for frame in frames]
    assert np.array_equal(
        record.methods["single_image"].poses.translation, np.stack([pose.translation for pose in singles])
    )
    assert np.array_equal(
        record.methods["filter"].poses.rotation[70], estimates[70].modes[0].world_from_camera.rotation
    )
    assert record.status == tuple(estimate.status for estimate in estimates)
    assert record.num_modes.tolist() == [len(estimate.modes) for estimate in estimates]
    assert record.step_ms.tolist() == [step.step_ms for step in steps]
    for name in ("agreement", "ood_score"):
        assert getattr(record, name).tolist() == [getattr(estimate, name) for estimate in estimates]
    expected = dead_reckoning(frames[0].world_from_camera, [frame.odometry for frame in frames])
    assert np.allclose(record.methods["dead_reckoning"].poses.as_matrix(), expected.as_matrix(), atol=1e-12)


def test_a_record_of_no_image_is_refused():
    with pytest.raises(VaporTrackError, match="no image was localized, 4 were skipped"):
        RunRecorder().finish(skipped={"undecodable_image": 4})


def test_however_long_the_run_few_keyframes_are_kept_with_the_first_and_last_among_them(record):
    assert len(record.keyframes) == 24
    assert record.keyframes[0].time_ns == record.times_ns[0]
    assert record.keyframes[-1].time_ns == record.times_ns[-1]
    assert all(len(keyframe.cloud) == 300 for keyframe in record.keyframes)


def test_keyframes_show_the_ambiguous_belief_and_the_resolved_one(record):
    chosen = choose_keyframes(list(record.keyframes), 5)
    assert len(chosen) == 5
    assert len(chosen[0].modes) == 5
    collapse_ns = record.times_ns[next(i for i, s in enumerate(record.status) if s == "converged")]
    before = [keyframe for keyframe in chosen if keyframe.time_ns < collapse_ns]
    assert 2 <= len(before) <= 4


def test_thumbnails_are_small_and_do_not_share_the_frames_buffer():
    frame, step = next(simulated_steps(1))
    large = np.full((1000, 2000, 3), 7, np.uint8)
    for image, shape in ((large, (160, 320, 3)), (frame.image.copy(), frame.image.shape)):
        recorder = RunRecorder()
        recorder.add(type(frame)(frame.time_ns, image), step)
        before = image.flat[0]
        image[:] = 99
        thumbnail = recorder.finish().keyframes[0].thumbnail
        assert thumbnail.shape == shape
        assert thumbnail.flat[0] == before != 99


def test_a_report_that_is_no_json_leaves_the_old_one_in_place(tmp_path):
    write_report(tmp_path / "report.json", {"frames": 1})
    with pytest.raises(ValueError, match="JSON"):
        write_report(tmp_path / "report.json", {"frames": float("nan")})
    assert json.loads((tmp_path / "report.json").read_text()) == {"frames": 1}
    assert [path.name for path in tmp_path.iterdir()] == ["report.json"]


def test_the_table_names_every_method_with_its_recall(record):
    report = build_report(record)
    text = rendered(report)
    for label in ("single image", "dead reckoning", "particle filter"):
        assert label in text
    assert f"{100 * report['filter']['recall']['0.3m/20deg']:.0f} %" in text
    assert f"{report['filter']['converged_at_s']:.1f} s" in text


def test_a_file_that_is_too_large_to_be_a_report_is_none(tmp_path):
    path = tmp_path / "report.json"
    path.write_text('{"frames": 1, "more": "' + "x" * 1000 + '"}')
    assert is_report(path, ["frames"])
    assert not is_report(path, ["frames", "images"])
    path.write_text(path.read_text() + " " * (64 << 20))
    assert not is_report(path, ["frames"])
    assert not is_report(tmp_path / "nowhere.json", [])


@pytest.mark.parametrize(("most", "every"), [(300, 4), (23, 64), (150, 8)])
def test_of_a_long_stream_items_are_kept_evenly(most, every):
    kept = EvenlySpaced(most)
    for number in range(1000):
        kept.add(partial(int, number))
    assert kept.items == [number for number, _ in kept.kept] == list(range(0, 1000, every))
