"""Watch a run in Rerun: live, or as a recording to open later."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float64

from filtering.errors import VaporTrackError
from filtering.estimate import Estimate, Status
from filtering.se3 import Poses
from sequences.frame import Frame, Trajectory
from vapor.reporting.rerun_layout import ERROR_CURVES, FOLLOWED, log_run_styles, run_blueprint
from vapor.reporting.rerun_place import Place
from vapor.reporting.rerun_recording import Recording, Rows, load_rerun, time_column
from vapor.reporting.rerun_shapes import BEST, HypothesisColors, Photograph, frusta, shown_modes, steps, thinned

if TYPE_CHECKING:
    import rerun as rr


_SAMPLES = 300  # of an image's posterior that are shown as points
_FRUSTA = 40  # samples of an image's posterior that are shown as cameras
_IMAGES_AT_ONCE = 32  # are sent, where nobody watches
_FLUSH_S = 2.0  # that a remote viewer has for messages under way
_JUMP_M = 0.5  # an estimate that moves so much farther than the odometry changed its mind
_UNKNOWN_M, _UNKNOWN_SMALL_M = 0.5, 0.12  # sizes of cameras, where nothing is known of the place


class RerunViewer:
    """Writes a Rerun recording, shows it live, or both.

    Args:
        path: The recording to write, `.rrd`; it appears under its name on `close`. None for none.
        spawn: Whether to open the viewer's window and stream into it.
        connect: Address of an open viewer to stream into, such as rerun+http://127.0.0.1:9876/proxy.
        title: Name of the run in the viewer.
        place: Where it happens; the first view shows all of it, and cameras are in proportion to it.
        live: See `run_blueprint`.

    Raises:
        SequenceError: the folder is missing.
        VaporTrackError: the viewer cannot be started, or nothing was asked for.
    """

    def __init__(
        self,
        path: Path | None = None,
        *,
        spawn: bool = False,
        connect: str | None = None,
        title: str = "vapor-track",
        place: Place | None = None,
        live: bool = False,
    ) -> None:
        rr = load_rerun()
        if path is None and not spawn and connect is None:
            raise VaporTrackError("a viewer needs a recording to write or a window to open, got neither")
        self._recording: Recording | None = None
        self._stream = rr.RecordingStream("vapor-track", recording_id=title)
        sinks: list[rr.FileSink | rr.GrpcSink] = []
        if spawn:
            _require_display()
            try:
                with _scripts_on_path():
                    self._stream.spawn(connect=False, hide_welcome_screen=True)
            except RuntimeError as error:
                raise VaporTrackError(f"the Rerun viewer cannot be started: {' '.join(str(error).split())}") from error
            sinks.append(rr.GrpcSink())
        if connect is not None:
            try:
                sinks.append(rr.GrpcSink(connect))
            except (RuntimeError, ValueError) as error:
                raise VaporTrackError(f"no Rerun viewer can be reached at {connect!r}: {error}") from error
        if path is not None:
            self._recording = Recording(path)
            sinks.append(rr.FileSink(self._recording.pipe))
        self._stream.set_sinks(*sinks)
        self._stream.send_blueprint(run_blueprint(place, live=live))  # else a viewer keeps that of the place before
        self._rows = Rows(self._stream, 1 if (sinks and path is None) or spawn else _IMAGES_AT_ONCE)
        self._image_from_camera: dict[str, list[list[float]]] = {}  # by entity
        self._last_best: Poses | None = None
        self._last_truth: Poses | None = None
        self._last_status: Status | None = None
        self._live = live
        self._camera_m = _UNKNOWN_M if place is None else place.camera_m
        self._small_camera_m = _UNKNOWN_SMALL_M if place is None else place.small_camera_m
        self._colors = HypothesisColors(self._camera_m)
        log_run_styles(self._stream, place, live=live)

    def __enter__(self) -> RerunViewer:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self.close(keep=kind is None)

    def log(self, frame: Frame, estimate: Estimate, posterior_poses: Poses | None) -> None:
        """Show one image, the belief after it, and samples (m,) of the image's own posterior.

        Raises:
            VaporTrackError: an earlier message could not be written.
        """
        import rerun as rr

        if self._recording is not None and self._recording.error is not None:
            raise self._recording.error
        self._rows.begin(frame.time_ns)
        self._log_camera(frame, estimate)
        self._log_belief(frame, estimate)
        if posterior_poses is not None and len(posterior_poses):
            points = thinned(posterior_poses, _SAMPLES).translation.astype(np.float32)
            self._rows.add("world/posterior", rr.Points3D, positions=points)
            cameras = frusta(thinned(posterior_poses, _FRUSTA), self._small_camera_m)
            self._rows.add("world/posterior/cameras", rr.LineStrips3D, strips=cameras)
        self._log_plots(frame, estimate)
        self._last_best = estimate.modes[0].world_from_camera
        self._last_truth = frame.world_from_reference

    def _log_camera(self, frame: Frame, estimate: Estimate) -> None:
        import rerun as rr

        best, truth = estimate.modes[0].world_from_camera, frame.world_from_reference
        if frame.image.size:  # none with estimates of others
            self._log_image(frame, best)
        self._rows.add(
            "world/camera", rr.Transform3D, translation=best.translation[None], mat3x3=best.rotation.reshape(1, 9)
        )
        if self._live:
            self._rows.add(FOLLOWED, rr.Points3D, positions=best.translation[None].astype(np.float32))
        moved = np.zeros(3) if frame.odometry is None else frame.odometry.previous_from_current.translation
        limit_m = _JUMP_M + 1.5 * float(np.linalg.norm(moved))
        self._log_step("world/path/filter", self._last_best, best, limit_m=limit_m)
        if truth is not None:
            camera = frusta(Poses.stack([truth]), 0.8 * self._camera_m)
            self._rows.add("world/truth", rr.LineStrips3D, strips=camera)
            self._log_step("world/path/truth", self._last_truth, truth, limit_m=np.inf)

    def _log_image(self, frame: Frame, best: Poses) -> None:
        import rerun as rr

        shown, entity, mount = Photograph.of(frame), "world/camera", frame.reference_from_camera
        if mount is not None:
            entity, pose = f"world/cameras/{rr.escape_entity_path_part(frame.camera_name)}", best @ mount
            at, turned = pose.translation[None], pose.rotation.reshape(1, 9)
            self._rows.add(entity, rr.Transform3D, translation=at, mat3x3=turned)
        if shown.image_from_camera != self._image_from_camera.get(entity):
            self._image_from_camera[entity] = shown.image_from_camera
            self._rows.add(
                entity,
                rr.Pinhole,
                image_from_camera=[shown.image_from_camera],
                resolution=[[shown.width, shown.height]],
                image_plane_distance=[self._camera_m],
                color=[BEST],
            )
        self._rows.add(entity, rr.EncodedImage, blob=[shown.jpeg], media_type=["image/jpeg"])

    def _log_step(self, entity: str, last: Poses | None, now: Poses, *, limit_m: float) -> None:
        """One segment an image: the view adds them up, and the recording grows with the path, not its square."""
        import rerun as rr

        moved = last is not None and float(np.linalg.norm(now.translation - last.translation)) <= limit_m
        segment = np.stack([now.translation if last is None or not moved else last.translation, now.translation])
        self._rows.add(entity, rr.LineStrips3D, strips=segment[None].astype(np.float32))

    def _log_belief(self, frame: Frame, estimate: Estimate) -> None:
        import rerun as rr

        points = estimate.shown.translation
        modes = Poses.stack([mode.world_from_camera for mode in estimate.modes])
        nearest = np.linalg.norm(points[:, None] - modes.translation, axis=-1).argmin(axis=1)
        colors = self._colors.of(modes, frame.odometry)
        self._rows.add("world/particles", rr.Points3D, positions=points.astype(np.float32), colors=colors[nearest])
        for entity, archetype, components in shown_modes(estimate.modes, colors, camera_m=0.8 * self._camera_m):
            self._rows.add(entity, archetype, **components)

    def _log_plots(self, frame: Frame, estimate: Estimate) -> None:
        import rerun as rr

        plotted = {
            "belief/best_weight": estimate.modes[0].weight,
            "belief/unassigned": estimate.unassigned,
            "belief/agreement": estimate.agreement,
        }
        if frame.world_from_reference is not None:
            position, rotation = _log_errors(estimate.modes[0].world_from_camera, frame.world_from_reference)
            plotted |= {"error/position/filter": float(position), "error/rotation/filter": float(rotation)}
        for entity, value in plotted.items():
            self._rows.add(entity, rr.Scalars, scalars=[value])
        if estimate.status != self._last_status:
            self._last_status = estimate.status
            self._rows.add("status", rr.StateChange, state=[estimate.status])

    def log_at_end(self, methods: Mapping[str, Trajectory], truth: Trajectory | None) -> None:
        """Show paths of methods at the stamps of the images, and their errors against known true poses, at the end."""
        import rerun as rr

        for name in ERROR_CURVES:
            if name == "filter" or name not in methods:
                continue
            times_ns, poses = methods[name].times_ns, methods[name].poses
            strips = steps(poses.translation, _longest_step_m(poses))
            columns = rr.LineStrips3D.columns(strips=strips).partition(np.ones(len(strips), np.int64))
            self._stream.send_columns(f"world/path/{name}", [time_column(times_ns)], columns)
            if truth is not None:
                known = np.searchsorted(times_ns, truth.times_ns)
                for kind, errors in zip(("position", "rotation"), _log_errors(poses[known], truth.poses), strict=True):
                    columns = rr.Scalars.columns(scalars=errors)
                    self._stream.send_columns(f"error/{kind}/{name}", [time_column(truth.times_ns)], columns)

    def close(self, *, keep: bool = True) -> None:
        """Finish; the recording appears under its name, or is removed."""
        try:
            if keep:
                self._rows.send()
            self._stream.flush(timeout_sec=_FLUSH_S if self._recording is None else math.inf)
        except RuntimeError as error:
            if keep:
                keep = False
                raise VaporTrackError(f"the Rerun viewer cannot be written to: {error}") from error
        finally:
            self._stream.disconnect()
            if self._recording is not None:
                recording, self._recording = self._recording, None
                recording.close(keep=keep)


def _log_errors(poses: Poses, truth: Poses) -> tuple[Float64[np.ndarray, "*n"], Float64[np.ndarray, "*n"]]:
    """Decimal logarithms of errors in position, metres, and in rotation, degrees; NaN, a gap, where there is none."""
    metres, radians = poses.distance(truth)
    with np.errstate(divide="ignore"):
        logs = np.log10(metres), np.log10(np.degrees(radians))
    position, rotation = (np.where(np.isfinite(log), log, np.nan) for log in logs)
    return position, rotation


def _longest_step_m(poses: Poses) -> float:
    moved = np.linalg.norm(np.diff(poses.translation, axis=0), axis=1)
    return _JUMP_M + 6.0 * float(np.median(moved)) if len(moved) else np.inf


def _require_display() -> None:
    # Without a display the viewer ends at once, and Rerun waits for it.
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise VaporTrackError("the Rerun viewer needs a display, expected DISPLAY or WAYLAND_DISPLAY to be set")


@contextmanager
def _scripts_on_path() -> Iterator[None]:
    """Let Rerun find its viewer beside this Python also where its environment is not activated."""
    path = os.environ.get("PATH", "")
    os.environ["PATH"] = os.pathsep.join([path, os.path.dirname(sys.executable)])
    try:
        yield
    finally:
        os.environ["PATH"] = path
