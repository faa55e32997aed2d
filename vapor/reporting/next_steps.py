"""What the user of a run should do next, from its report and its notices."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from vapor.reporting.report import HARDLY, is_mostly_lost, is_placed

MOST_STEPS = 4
MOVE_ON = "Move on until something looks different, or look with more cameras."
"""Where several places remain."""
_CHECK_MODEL = (
    "Check that the model is of this place. If so, record with this camera in this light, and train with it, too."
)
_CHECK_WALK = "Check that the walk is in the place that the model, or the estimator, knows, and shows something unique."
DOUBTS_OF_PLACE = (_CHECK_MODEL, _CHECK_WALK)
"""Where it may be another place."""
TRAINED_ON = "were trained on"
"""In the notice that the model was trained on images of the run."""
_FEW, _FEW_VERIFIED = 0.5, 0.2  # of the images, converged and with landmarks, below which something is amiss
_AMBIGUOUS = 0.5  # of the smoothed poses
_DOUBTFUL = 0.05  # of the smoothed poses, and of the images whose motion is unknown

_OF_NOTICES: tuple[tuple[str, str], ...] = (
    (r"^Only \d+ of \d+ images were used", "Mend the recording, or record again: most of its images are lost."),
    (TRAINED_ON, "Judge by images that the model was not trained on."),
    (r"^images look like .* only when (?P<change>.*?)(?: \(.*)?:", "Correct the images where they are made."),
    (r"^images look like .* does not agree", "Compare clocks and axes: vapor-track inspect, with this recording."),
    (r"^images (are grey|look unlike)", _CHECK_MODEL),
    (r"^hardly any image says which place", _CHECK_WALK),
    (r"camera of unknown intrinsics", "State the focal length: record CameraInfo, or write an intrinsics.json."),
    (r"but their camera info states|^distortion model", "Correct the CameraInfo: it is not used as it is."),
    (r"images are unlike the training|were left out, as they fit nowhere", "Check this camera: mount, clock and lens."),
    (r"where no training image is within", "Record this ground again, and train with it, too."),
    (
        r"sees \d+% of what the camera learned with saw",
        "Train with images of this camera, or use that of the training.",
    ),
    (r"^gravity is off the images", "Check how the inertial unit is mounted: its frame in tf, and its axes."),
    (r"wheels slip, or something moves", "Look at the wheels: where odometry is wrong, use --odometry both."),
    (
        r"^the 90 % regions of .*, those of the filter",
        "Take the filter's poses and covariances where the uncertainty counts.",
    ),
    (r"^the 90 % regions", "Calibrate with a recording of such conditions: vapor-track calibrate."),
)
"""What a notice looks like -> what to do, the most urgent first."""
_OF_RECORDED_ODOMETRY = (
    r"^\d+ of \d+ smoothed poses are doubtful",
    "Check the odometry where images do not fit: vapor-track inspect, or --odometry both.",
)
"""The same of a run that is mostly converged, with more than a few such poses: elsewhere the place is in doubt."""
_OF_ASSUMED_RATE = (
    r"images a second are assumed",
    "State how many images a second were taken, by --rate-hz: at another rate the motion does not fit the images.",
)
"""The same of a run whose motion is in doubt."""
_UNKNOWN_MOTION = r"(\d+) .*do not say how the camera moved"


def next_steps(report: Mapping[str, Any], notices: Sequence[str]) -> tuple[list[tuple[str, str]], list[str]]:
    """Actions with their reasons, the most urgent first, and the notices that ask for none.

    Args:
        report: Content of `report.json`.
        notices: On the run.
    """
    steps, others = [], list(notices)
    for pattern, action in _patterns(report, notices):
        for notice in [each for each in others if re.search(pattern, each)]:
            others.remove(notice)
            steps.append((action, _sentence(notice)))
    steps += _of_report(report)
    return steps[:MOST_STEPS], others + [reason for _, reason in steps[MOST_STEPS:]]


def _patterns(report: Mapping[str, Any], notices: Sequence[str]) -> list[tuple[str, str]]:
    """What notices may look like, and what to do then, by the figures of a run."""
    doubtful, patterns = _is_doubtful(report), [*_OF_NOTICES]
    if doubtful and report["odometry"] in ("recorded", "both"):
        patterns.append(_OF_RECORDED_ODOMETRY)
    unknown = sum(int(found[1]) for found in (re.search(_UNKNOWN_MOTION, notice) for notice in notices) if found)
    motion_is_in_doubt = doubtful or _converged(report) < _FEW or unknown > _DOUBTFUL * report["frames"]
    if motion_is_in_doubt and not is_mostly_lost(report["status"]):
        patterns.insert(0 if is_placed(report["status"]) else len(patterns), _OF_ASSUMED_RATE)
    return patterns


def _of_report(report: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Actions by figures that no notice states."""
    steps, frames = [], report["frames"]
    converged, placed = _converged(report), is_placed(report["status"])
    if placed and converged < _FEW:
        reason = (
            f"Only {100 * converged:.0f} % of the images are converged: from what they show, several places remain."
        )
        steps.append((MOVE_ON, reason))
    elif placed and (back := report["hindsight"]) is not None and back["ambiguous"] > _AMBIGUOUS * frames:
        reason = f"{back['ambiguous']} of {frames} smoothed poses have a second place that is nearly as probable."
        steps.append(("Compare smoothed.tum with smoothed_second.tum before you use either.", reason))
    if converged >= HARDLY and report.get("verified", 1.0) < _FEW_VERIFIED:
        reason = (
            f"Landmarks verified a place in {100 * report['verified']:.0f} % of the images only, and poses are exact to"
            " centimetres only there."
        )
        steps.append(("Record this place again with sharp, well-lit images, and train with them.", reason))
    return steps


def _is_doubtful(report: Mapping[str, Any]) -> bool:
    doubtful = report.get("smoothed_doubtful") or 0
    return _converged(report) >= _FEW and doubtful > _DOUBTFUL * report["frames"]


def _converged(report: Mapping[str, Any]) -> float:
    return report["status"].get("converged", 0.0)


def _sentence(notice: str) -> str:
    return f"{notice[:1].upper()}{notice[1:]}{'' if notice.endswith(('.', '?')) else '.'}"
