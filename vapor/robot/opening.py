"""From the topics of a robot to the belief about it: what is found, and what is made of it."""

from __future__ import annotations

import queue
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from filtering.localizer import ParticleLocalizer
from sequences.live.frames import LiveFrames
from sequences.live.opening import open_live
from sequences.live.reader import LiveReader
from sequences.live.transport import Transport
from sequences.options import ReadingOptions
from sequences.recordings.source import RawMessage
from sequences.visual_odometry.frames import TRACKED_HZ, VisualFrames
from sequences.visual_odometry.odometry import VisualOdometry
from vapor.pipeline.config import OdometrySource
from vapor.pipeline.model import LoadedModel
from vapor.pipeline.odometry import USES, Seeing, camera_of_motion, makes_odometry, usual_depth_m
from vapor.pipeline.verticals import Verticals
from vapor.robot.belief import LiveBelief
from vapor.robot.config import LiveConfig


def open_belief(
    model: LoadedModel,
    config: LiveConfig,
    reading: ReadingOptions,
    *,
    transport: Transport,
    events: queue.SimpleQueue[Any],
    admit: Callable[[Any], RawMessage | None],
    waiting: Callable[[str], None],
) -> LiveBelief:
    """Wait until all topics are there, and begin a belief; the last four arguments are as of `open_live`.

    Raises:
        VaporTrackError: the topics cannot be used.
    """
    description, settings = model.observation.description, config.localizer
    reader = open_live(
        transport,
        events,
        reading,
        admit=admit,
        waiting=waiting,
        late_window_s=settings.late_window_s,
        usual_cameras=description.cameras,
        odometry=USES[config.odometry],
    )
    observation = model.observation.seen_by(reader.camera)
    verticals = Verticals(observation.description, config.planar)
    fit = description.calibration.odometry if config.fitted_odometry and reader.has_odometry else None
    visual = _visual_frames(reader, observation.description, config.odometry)
    restated = None if fit is None else fit.restated
    frames = LiveFrames(reader, restated=restated, visual=visual, usual_up=verticals.usual_up)
    if visual is not None and not reader.has_odometry:
        settings = replace(settings, odometry_bias=VisualOdometry.bias)
    elif fit is not None:
        settings = replace(settings, odometry_bias=fit.odometry_bias)
    localizer = ParticleLocalizer(observation, settings, rng=np.random.default_rng(config.seed))
    return LiveBelief(localizer, observation, frames, config.lag, verticals)


def _visual_frames(reader: LiveReader, model: Seeing, source: OdometrySource) -> Callable[[], VisualFrames] | None:
    """What begins to make odometry from images; None where it is not made."""
    if not makes_odometry(source, is_recorded=reader.has_odometry):
        return None
    camera, depth_m = camera_of_motion(reader.path, reader.camera, model, source), usual_depth_m(model)
    if camera is None:
        return None
    return lambda: VisualFrames(camera, beside=source == "both", most_hz=TRACKED_HZ, usual_depth_m=depth_m)


def what_is_used(belief: LiveBelief, usual_cameras: Sequence[str], reading: ReadingOptions) -> list[str]:
    """Sentences for users: the topics and the odometry by which a belief is followed, and what is missing.

    Args:
        belief: The belief.
        usual_cameras: Topics of the cameras that the model learned from.
        reading: As asked for.
    """
    reader, roles = belief.reader, belief.reader.roles
    published = roles.odometry.name if roles.odometry is not None else f"tf from {roles.odometry_frame}"
    from_images = "odometry made from the images" if belief.frames.makes_odometry else "no odometry"
    odometry = f"{published}, and {from_images}" if belief.frames.makes_odometry else published
    infos = [camera.info.name for camera in roles.cameras if camera.info is not None]
    topics = ", ".join([*roles.image_topics, *infos, *reader.sensors.names])
    said = [f"localizes by {topics} and {odometry if reader.has_odometry else from_images}"]
    if not reader.has_odometry:
        said.append("without published odometry there is no transform, and a pose of the base with images only")
    missing = [name for name in usual_cameras if name not in reader.lenses]
    if missing and len(usual_cameras) > 1 and not reading.image_topics:
        said.append(f"without {', '.join(missing)}, which the model learned from, too: not there at the start")
    return said
