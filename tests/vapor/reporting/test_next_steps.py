"""What a page says to do next: the cause that a run shows, with its action, and nothing where nothing is amiss."""

from dataclasses import replace

import numpy as np
import pytest

from filtering.se3 import Poses
from sequences.frame import Camera
from sequences.reading.counts import ImageCounts
from tests.helpers.simulated_run import simulated_record, true_walk
from vapor.cameras import AsTakenBy
from vapor.evaluation.trained_images import said_of_trained_images
from vapor.pipeline.unrecognised import why_unrecognised
from vapor.reporting.calibration import too_sure_notices
from vapor.reporting.next_steps import MOST_STEPS, next_steps
from vapor.reporting.report import camera_notices, doubtful_notice, is_placed, place_notice
from vapor.tracking.hindsight import LookBack
from vapor.training_data.ground import describe_unshown

CAMERA = Camera(width=160, height=120, fx=120.0, fy=120.0, cx=79.5, cy=59.5)
GOOD = {
    "frames": 100,
    "odometry": "recorded",
    "status": {"converged": 0.9, "ambiguous": 0.1, "lost": 0.0},
    "hindsight": {"ambiguous": 0},
    "consistency": {"images": 90, "wrong": 0.0, "coverage": {"90%": 0.92}},
    "verified": 0.8,
}


def actions(*notices: str, **of_report) -> list[str]:
    return [action for action, _ in next_steps({**GOOD, **of_report}, notices)[0]]


def unshown() -> str:
    line = np.zeros((60, 3))
    line[:, 0] = np.linspace(0.0, 6.0, 60)
    training = Poses(np.tile(np.eye(3), (60, 1, 1)), line)
    walked = Poses(training.rotation, line + np.array([0.0, 5.0, 0.0]))
    return describe_unshown(walked, training)


def unknown_intrinsics() -> str:
    seen = AsTakenBy(CAMERA, (64, 48))
    seen(np.zeros((100, 160, 3), np.uint8), None)
    (notice,) = seen.notices
    return notice


def narrower() -> str:
    seen = AsTakenBy(CAMERA, (64, 48))
    seen(np.zeros((120, 160, 3), np.uint8), Camera(width=160, height=120, fx=240.0, fy=240.0, cx=79.5, cy=59.5))
    (notice,) = seen.notices
    return notice


def of_cameras(**changes) -> str:
    good = {"images": 100, "left_out": 0, "out_of_distribution": 0}
    (notice,) = camera_notices({"cameras": {"/front": good, "/rear": {**good, **changes}}})
    return notice


def unrecognised(score) -> str:
    image = np.tile(np.arange(160, dtype=np.uint8)[None, :, None], (120, 1, 3)) + np.array([0, 9, 90], np.uint8)
    return why_unrecognised([(image, None)], score)


def nowhere() -> str:
    notice = place_notice({"status": {"converged": 0.01, "ambiguous": 0.99, "lost": 0.0}})
    assert notice is not None
    return notice


def too_sure(held: float = 0.92, smoothed: float = 0.9, wrong: float = 0.0, images: int = 90) -> list[str]:
    def of(part: float) -> dict[str, object]:
        return {"images": images, "wrong": wrong, "coverage": {"90%": part}}

    return too_sure_notices({"consistency": of(held), "hindsight": {"consistency": of(smoothed)}})


def few() -> str:
    counts = ImageCounts(100, 100, 20)
    counts.skipped["undecodable_image"] = 80
    return counts.warning


def trained() -> str:
    poses = true_walk(3)
    return said_of_trained_images([*poses, None], poses)


@pytest.mark.parametrize(
    ("make", "action"),
    [
        (unshown, "Record this ground again"),
        (unknown_intrinsics, "State the focal length"),
        (narrower, "Train with images of this camera"),
        (lambda: of_cameras(left_out=90), "Check this camera"),
        (lambda: of_cameras(out_of_distribution=90), "Check this camera"),
        (
            lambda: unrecognised(lambda image, camera: 3.0 - 2.9 * (image[0, 0, 0] > image[0, 0, 2])),
            "Correct the images",
        ),
        (lambda: unrecognised(lambda image, camera: 0.1), "Compare clocks and axes"),
        (lambda: unrecognised(lambda image, camera: 3.0), "Check that the model is of this place"),
        (nowhere, "Check that the walk is in the place that the model, or the estimator, knows, and"),
        (few, "Mend the recording"),
        (trained, "Judge by images that the model was not trained on"),
    ],
)
def test_what_a_notice_of_a_run_says_has_its_action(make, action):
    notice = make()
    (step,), others = next_steps(GOOD, ["mind the step", notice])
    assert step[0].startswith(action)
    assert step[1].lower().startswith(notice.lower())
    assert others == ["mind the step"]


def test_regions_that_hold_too_little_are_said_of_the_filter_and_of_smoothed_poses():
    assert too_sure() == too_sure(0.4, 0.4, images=9) == []
    assert too_sure_notices({"consistency": {"images": 0, "wrong": None, "coverage": None}}) == []
    assert too_sure_notices({"hindsight": {"ambiguous": 0}}) == []  # without true poses
    (of_filter,) = too_sure(0.6, wrong=0.3)
    assert of_filter.startswith(
        "the 90 % regions hold 60 % of the true poses, and 30 % of the converged images are wrong"
    )
    assert too_sure(wrong=0.3) != []
    (of_smoothed,) = too_sure(0.97, 0.42)
    assert of_smoothed.startswith(
        "the 90 % regions of smoothed poses hold 42 % of the true poses, those of the filter 97 %"
    )
    assert actions(of_filter)[0].startswith("Calibrate")
    assert actions(of_smoothed)[0].startswith("Take the filter's poses")
    assert [action.split()[0] for action in actions(*too_sure(0.6, 0.42))] == ["Calibrate", "Calibrate"]


def test_what_the_report_shows_has_its_action():
    assert actions() == []
    assert actions(status={"converged": 0.1, "ambiguous": 0.9})[0].startswith("Move on")
    assert actions(status={"converged": 0.1, "lost": 0.9}) == []  # which a notice explains
    assert actions(hindsight={"ambiguous": 80})[0].startswith("Compare smoothed.tum")
    assert actions(hindsight=None) == []
    assert actions(verified=0.1)[0].startswith("Record this place again")


def test_nothing_that_depends_on_positions_is_asked_of_a_run_without_any():
    of_positions = {"hindsight": {"ambiguous": 100}, "smoothed_doubtful": 100, "verified": 0.0}
    lost = {"converged": 0.0, "ambiguous": 0.0, "lost": 1.0}
    notice = unrecognised(lambda image, camera: 3.0)
    steps, _ = next_steps({**GOOD, **of_positions, "status": lost}, [notice])
    (action,) = [action for action, _ in steps]
    assert action.startswith("Check that the model is of this place.")
    assert actions(**of_positions, status={"converged": 0.0, "ambiguous": 1.0, "lost": 0.0}) == []
    assert len(actions(**of_positions)) == 2


def test_the_place_is_doubted_where_hardly_an_image_says_which_it_is():
    assert "is it in the place that the model, or the estimator, knows?" in nowhere()
    assert place_notice({"status": {"converged": 0.05, "ambiguous": 0.95, "lost": 0.0}}) is None
    assert place_notice({"status": {"converged": 0.0, "ambiguous": 0.0, "lost": 1.0}}) is None  # others say why
    assert is_placed({"converged": 0.6, "lost": 0.4})
    assert not is_placed({"converged": 0.4, "lost": 0.6})
    assert not is_placed({"converged": 0.0, "lost": 0.0})


def test_odometry_is_suspected_only_where_the_place_is_known():
    fits_nowhere = LookBack({}, None, np.zeros(20, bool), np.zeros(20), np.zeros(20, bool))
    doubtful = doubtful_notice(replace(simulated_record(20), look_back=fits_nowhere))
    many = {"smoothed_doubtful": 20}
    (action,) = actions(doubtful, **many)
    assert action == "Check the odometry where images do not fit: vapor-track inspect, or --odometry both."
    assert next_steps({**GOOD, "smoothed_doubtful": 3}, [doubtful]) == ([], [doubtful])
    (step,), others = next_steps({**GOOD, **many, "status": {"converged": 0.1, "ambiguous": 0.9}}, [doubtful])
    assert step[0].startswith("Move on")
    assert others == [doubtful]
    for origin in ("visual", None):  # there is none to check
        assert next_steps({**GOOD, **many, "odometry": origin}, [doubtful]) == ([], [doubtful])
    assert actions(doubtful, **many, odometry="both") == [action]


ASSUMED = "no time stamps: 30 images a second are assumed (--rate-hz)"
STATE = "State how many images a second were taken, by --rate-hz"


def test_a_rate_that_was_assumed_is_asked_for_first_where_the_motion_is_in_doubt():
    fits_nowhere = LookBack({}, None, np.zeros(20, bool), np.zeros(20), np.zeros(20, bool))
    doubtful = doubtful_notice(replace(simulated_record(20), look_back=fits_nowhere))
    images_alone = {**GOOD, "odometry": "visual"}

    def first(*notices: str, **of_report) -> str | None:
        steps, _ = next_steps({**images_alone, **of_report}, [*notices, ASSUMED])
        return next((action.partition(":")[0] for action, _ in steps), None)

    assert first() is None
    assert first("before 2 images the images do not say how the camera moved") is None
    assert first("before 28 images the images do not say how the camera moved") == STATE
    assert first(doubtful, narrower(), smoothed_doubtful=20) == STATE
    assert first(status={"converged": 0.4, "ambiguous": 0.6, "lost": 0.0}) == STATE
    steps, others = next_steps({**images_alone, "smoothed_doubtful": 20}, [doubtful, ASSUMED])
    assert [reason for _, reason in steps] == [f"N{ASSUMED[1:]}."]
    assert others == [doubtful]


def test_where_the_place_is_in_doubt_that_comes_before_the_rate_and_where_most_are_lost_the_rate_is_not_asked():
    lost = {"converged": 0.0, "ambiguous": 0.0, "lost": 1.0}
    (action,) = actions(ASSUMED, unrecognised(lambda image, camera: 3.0), odometry="visual", status=lost)
    assert action.startswith("Check that the model is of this place.")
    ambiguous = {"converged": 0.0, "ambiguous": 1.0, "lost": 0.0}
    asked = actions(ASSUMED, nowhere(), odometry="visual", status=ambiguous)
    assert [action.partition(":")[0].split(" in ")[0] for action in asked] == ["Check that the walk is", STATE]


def test_steps_are_few_and_those_left_out_are_notices():
    notices = [few(), unknown_intrinsics(), of_cameras(left_out=90), unshown(), narrower()]
    steps, others = next_steps(GOOD, notices[::-1])
    assert [each[0].split(",")[0].split(":")[0] for each in steps] == [
        "Mend the recording",
        "State the focal length",
        "Check this camera",
        "Record this ground again",
    ]
    assert len(steps) == MOST_STEPS
    assert len(others) == 1
    assert "sees" in others[0]
