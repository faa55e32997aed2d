"""Recordings of one walk with random faults from the field, some together."""

import copy
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.helpers.sequence_files import BEGIN_NS, CAMERA
from tests.helpers.tf_files import MS, Event, camera_infos, images, mounted, odometry, stamps, told_by, write_events

NUM_IMAGES = 24
SECOND = 10**9
END_NS = BEGIN_NS + NUM_IMAGES * 100 * MS
TOPICS = ("/image/compressed", "/odom", "/truth")

Change = Callable[[list[Event], random.Random], list[Event]]


def write_random(path: Path, seed: int) -> list[str]:
    """Write the walk with one to four faults; returns their names."""
    rng = random.Random(seed)
    events = [
        *mounted(),
        *images(NUM_IMAGES),
        *camera_infos((BEGIN_NS + 100 * MS * i, CAMERA) for i in range(NUM_IMAGES)),
        *odometry(stamps(NUM_IMAGES)),
        *told_by("geometry_msgs/PoseStamped", stamps(NUM_IMAGES, every_ms=50), child="camera"),
    ]
    faults = rng.choices(FAULTS, k=rng.randint(1, 4))
    events = sorted(copy.deepcopy(events), key=lambda event: event.time_ns)
    for fault in faults:
        events = fault(events, rng)
    write_events(path, [event._replace(time_ns=max(event.time_ns, 0)) for event in events])
    return [fault.__name__ for fault in faults]


def _topic(rng: random.Random) -> tuple[str, ...]:
    return rng.choice([*((topic,) for topic in TOPICS), TOPICS])


def _drop(events: list[Event], rng: random.Random) -> list[Event]:
    topics, share = _topic(rng), rng.choice([0.1, 0.5, 0.9])
    return [event for event in events if event.topic not in topics or rng.random() >= share]


def _gap(events: list[Event], rng: random.Random) -> list[Event]:
    """Nothing comes for some time, or not any more."""
    topics, begin = _topic(rng), rng.randint(BEGIN_NS - SECOND, END_NS)
    end = begin + rng.choice([SECOND // 4, SECOND, 10 * SECOND])
    return [event for event in events if event.topic not in topics or not begin <= event.time_ns < end]


def _jump(events: list[Event], rng: random.Random) -> list[Event]:
    """A clock is set: of stamps, and perhaps of the recorder too."""
    topics, at_ns = _topic(rng), rng.randint(BEGIN_NS, END_NS)
    by_ns = round(rng.choice([-1, 1]) * 10 ** rng.uniform(-0.5, 9) * SECOND)
    before, log_too = rng.random() < 0.5, rng.random() < 0.5
    found = []
    for event in events:
        if event.topic in topics and (event.time_ns < at_ns) == before:
            event = event._replace(message=_shifted(event.message, by_ns))
            event = event._replace(time_ns=event.time_ns + by_ns * log_too)
        found.append(event)
    return found


def _odd_stamp(events: list[Event], rng: random.Random) -> list[Event]:
    """Single stamps are anything."""
    chosen = {rng.randrange(len(events)) for _ in range(rng.randint(1, 4))}
    return [
        event._replace(message=_shifted(event.message, rng.randint(-(10**19), 10**19))) if i in chosen else event
        for i, event in enumerate(events)
    ]


def _not_a_number(events: list[Event], rng: random.Random) -> list[Event]:
    """Numbers of some poses are NaN, infinite or too large; or the quaternion is zero."""
    chosen = {rng.randrange(len(events)) for _ in range(rng.choice([1, 3, len(events) // 2]))}
    value = rng.choice([float("nan"), float("inf"), 1e300, None])

    def spoilt(part: Any) -> Any:
        if not isinstance(part, dict) or part.keys() not in ({*"xyz"}, {*"xyzw"}):
            return part
        if value is not None:
            return {**part, rng.choice([*part]): value}
        return dict.fromkeys("xyzw", 0.0) if "w" in part else part

    return [
        event._replace(message=_changed(event.message, spoilt)) if i in chosen else event
        for i, event in enumerate(events)
    ]


def _late(events: list[Event], rng: random.Random) -> list[Event]:
    """One topic is logged later, or earlier, than it was stamped."""
    topics, by_ns = _topic(rng), round(rng.uniform(-3, 3) * SECOND)
    moved = [event._replace(time_ns=event.time_ns + by_ns * (event.topic in topics)) for event in events]
    return sorted(moved, key=lambda event: event.time_ns)


def _twice(events: list[Event], rng: random.Random) -> list[Event]:
    """Messages come twice, at once or much later."""
    again = [event for event in events if rng.random() < 0.3]
    if rng.random() < 0.5:
        return [each for event in events for each in ([event, event] if event in again else [event])]
    return [*events, *again]


def _reordered(events: list[Event], rng: random.Random) -> list[Event]:
    """Messages are written in another order than they were logged in."""
    window_ns = rng.choice([SECOND // 10, SECOND, 100 * SECOND])
    return sorted(events, key=lambda event: event.time_ns + rng.randint(0, window_ns))


def _renamed(events: list[Event], rng: random.Random) -> list[Event]:
    """A topic or a frame has another name, or is shared by two."""
    if rng.random() < 0.5:
        old = rng.choice([*TOPICS, "/tf_static"])
        new = rng.choice(["/other", "", "/tf", old.upper(), rng.choice(TOPICS)])
        return [event._replace(topic=new) if event.topic == old else event for event in events]
    old, new = rng.choice(["camera", "base_link", "odom", "map"]), rng.choice(["", "x" * 300, "camera", "odom"])

    def renamed(part: Any) -> Any:
        return new if part == old else part

    return [event._replace(message=_changed(event.message, renamed)) for event in events]


def _broken_image(events: list[Event], rng: random.Random) -> list[Event]:
    """Images are empty, cut off or random bytes."""
    for event in events:
        if event.topic == "/image/compressed" and rng.random() < 0.4:
            data = event.message["data"]
            event.message["data"] = rng.choice([b"", data[: len(data) // 2], rng.randbytes(100)])
    return events


def _other_camera(events: list[Event], rng: random.Random) -> list[Event]:
    """The camera zooms, or its focal length is impossible."""
    at_ns, focal = rng.randint(BEGIN_NS, END_NS), rng.choice([0.0, 1.0, 2 * CAMERA.fx, float("nan"), -CAMERA.fx])
    for event in events:
        if event.type == "sensor_msgs/CameraInfo" and event.time_ns >= at_ns:
            event.message["k"] = [focal, *event.message["k"][1:]]
    return events


FAULTS: list[Change] = [
    _drop,
    _gap,
    _jump,
    _odd_stamp,
    _not_a_number,
    _late,
    _twice,
    _reordered,
    _renamed,
    _broken_image,
    _other_camera,
]


def _changed(message: Any, change: Callable[[Any], Any]) -> Any:
    """A message of which every part was changed, the innermost first."""
    if isinstance(message, list):
        return [_changed(each, change) for each in message]
    if isinstance(message, dict):
        message = {name: _changed(value, change) for name, value in message.items()}
    return change(message)


def _shifted(message: Any, by_ns: int) -> Any:
    """A message with all stamps shifted, within the range of stamps."""

    def shift(part: Any) -> Any:
        if not isinstance(part, dict) or part.keys() != {"sec", "nanosec"}:
            return part
        sec, nanosec = divmod(part["sec"] * SECOND + part["nanosec"] + by_ns, SECOND)
        return {"sec": min(max(sec, -(2**31)), 2**31 - 1), "nanosec": nanosec}

    return _changed(message, shift)
