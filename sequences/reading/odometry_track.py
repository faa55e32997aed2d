"""Only the odometry of a recording, to find a time offset with."""

from __future__ import annotations

from array import array
from collections.abc import Collection

import numpy as np

from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.frame import Trajectory
from sequences.reading.pose_source import PoseSource
from sequences.reading.timeline import Key, Timeline
from sequences.recordings.source import MessageSource

_OFFSET_SEGMENT_S, _OFFSET_STEP_S = 1800.0, 0.02  # of odometry, to find a time offset in


def odometry_track(bag: MessageSource, source: PoseSource, links: Collection[Key] | None) -> Trajectory:
    """The first half hour of odometry, at most fifty poses a second, by one steady clock.

    Args:
        bag: The recording.
        source: The odometry.
        links: Those of tf that tell it, None where a topic of its own does.

    Raises:
        SequenceError: there is none, or the recording is damaged.
    """
    times_ns, numbers = array("q"), array("d")
    step_ns = round(_OFFSET_STEP_S * 1e9)
    for dated in Timeline(bag, {source.topic: links}).messages(source.topic):
        if dated.message is None or not dated.stamps_ns:
            continue
        for sample in source.samples(dated.message)[0]:
            source.append(sample)
        span = source.span_ns
        if span is None or (times_ns and span[1] - times_ns[-1] < step_ns):
            continue
        pose = source.at(span[1])
        source.forget_before(span[1])
        if pose is None:
            continue
        times_ns.append(span[1])
        numbers.extend([*pose.translation, *pose.as_quat_xyzw()])
        if (times_ns[-1] - times_ns[0]) * 1e-9 > _OFFSET_SEGMENT_S:
            break
    if len(times_ns) < 2:
        raise SequenceError(f"{bag.path}: {source.topic}: no odometry, expected some to find a time offset by")
    table = np.array(numbers).reshape(-1, 7)
    return Trajectory(np.array(times_ns, np.int64), Poses.from_quat_xyzw(table[:, :3], table[:, 3:]))
