"""Watch a run in Rerun: live, or as a recording to open later."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType, TracebackType
from typing import TYPE_CHECKING

import numpy as np

from filtering.errors import VaporTrackError
from filtering.estimate import Estimate, Status
from filtering.se3 import Poses
from sequences.frame import Camera, Frame
from vapor.reporting.rerun_layout import blueprint, log_styles, rgb, weight_colors
from vapor.reporting.rerun_recording import Recording
from vapor.reporting.rerun_rows import Rows
from vapor.reporting.rerun_shapes import as_jpeg, ellipsoid, frusta, stand_in_camera, thinned

if TYPE_CHECKING:
    import rerun as rr

_CLOUD_SIZE = 300
_FRUSTA = 40  # samples of an image's posterior that are shown as cameras
_IMAGES_AT_ONCE = 32  # are sent, where nobody watches
_FLUSH_S = 2.0  # that a viewer elsewhere gets to take what is under way
_JUMP_M = 0.5  # an estimate that moves so much farther than the odometry changed its mind
_STATUS_LEVEL: dict[Status, float] = {"lost": 0.0, "ambiguous": 0.5, "converged": 1.0}


class RerunViewer:
    """Writes a Rerun recording, shows it live, or both.

    Args:
        path: The recording to write, `.rrd`; it appears under its name on `close`. None for none.
        spawn: Whether to open the viewer's window now and stream into it.
        connect: Address of a viewer that is open, to stream into, such as rerun+http://127.0.0.1:9876/proxy.
        title: Name of the run in the viewer.
        live: Whether what is shown goes on without an end, and without true poses.

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
        self._stream.set_sinks(*sinks, default_blueprint=blueprint(live=live))
        self._rows = Rows(self._stream, 1 if (sinks and path is None) or spawn else _IMAGES_AT_ONCE)
        self._camera: Camera | None = None
        self._last_best: Poses | None = None
        self._last_truth: Poses | None = None
        log_styles(self._stream)

    def __enter__(self) -> RerunViewer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._finish(keep=error is None)

    def close(self) -> None:
        """Finish; the recording appears under its name."""
        self._finish(keep=True)

    def log(self, frame: Frame, estimate: Estimate, posterior_poses: Poses | None) -> None:
        """Show one image, the belief after it, and samples (m,) of the image's own posterior.

        Raises:
            VaporTrackError: what came before could not be written.
        """
        if self._recording is not None and self._recording.error is not None:
            raise self._recording.error
        self._rows.begin(frame.time_ns)
        self._log_camera(frame, estimate)
        self._log_belief(estimate, posterior_poses)
        self._log_plots(frame, estimate)
        self._last_best = estimate.modes[0].world_from_camera
        self._last_truth = frame.world_from_camera

    def _log_camera(self, frame: Frame, estimate: Estimate) -> None:
        import rerun as rr

        best, truth = estimate.modes[0].world_from_camera, frame.world_from_camera
        self._log_image(frame)
        self._rows.add(
            "world/camera", rr.Transform3D, translation=best.translation[None], mat3x3=best.rotation.reshape(1, 9)
        )
        moved = np.zeros(3) if frame.odometry is None else frame.odometry.previous_from_current.translation
        limit_m = _JUMP_M + 1.5 * float(np.linalg.norm(moved))
        self._log_step("world/path/filter", self._last_best, best, limit_m=limit_m)
        if truth is not None:
            ahead = 0.5 * truth.rotation[:, 2]
            self._rows.add("world/truth", rr.Arrows3D, origins=truth.translation[None], vectors=ahead[None])
            self._log_step("world/path/truth", self._last_truth, truth, limit_m=np.inf)

    def _log_image(self, frame: Frame) -> None:
        import rerun as rr

        if frame.image.size == 0:  # estimates without images
            return
        jpeg, width, height = as_jpeg(frame.image)
        camera = frame.camera or stand_in_camera(frame.image)
        if camera != self._camera:
            self._camera = camera
            scale = np.array([width / camera.width, height / camera.height])
            fx, fy = scale * (camera.fx, camera.fy)
            cx, cy = scale * (camera.cx + 0.5, camera.cy + 0.5)  # Rerun's pixels begin at integers, ours lie on them
            self._rows.add(
                "world/camera",
                rr.Pinhole,
                image_from_camera=[[[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]],
                resolution=[[width, height]],
                image_plane_distance=[0.5],
                color=[rgb("filter")],
            )
        self._rows.add("world/camera", rr.EncodedImage, blob=[jpeg], media_type=["image/jpeg"])

    def _log_step(self, entity: str, last: Poses | None, now: Poses, *, limit_m: float) -> None:
        """One segment an image: the view adds them up, and the recording grows with the path, not its square."""
        import rerun as rr

        moved = last is not None and float(np.linalg.norm(now.translation - last.translation)) <= limit_m
        segment = np.stack([now.translation if last is None or not moved else last.translation, now.translation])
        self._rows.add(entity, rr.LineStrips3D, strips=segment[None].astype(np.float32))

    def _log_belief(self, estimate: Estimate, posterior_poses: Poses | None) -> None:
        import rerun as rr

        points = estimate.cloud(_CLOUD_SIZE).translation
        modes = Poses.stack([mode.world_from_camera for mode in estimate.modes])
        weights = np.array([mode.weight for mode in estimate.modes])
        nearest = np.linalg.norm(points[:, None] - modes.translation, axis=-1).argmin(axis=1)
        colors = weight_colors(weights)
        self._rows.add("world/particles", rr.Points3D, positions=points.astype(np.float32), colors=colors[nearest])
        sigma, axes = zip(*(ellipsoid(mode.covariance[:3, :3]) for mode in estimate.modes), strict=True)
        self._rows.add(
            "world/modes",
            rr.Ellipsoids3D,
            centers=modes.translation,
            half_sizes=2.0 * np.stack(sigma),
            quaternions=Poses(modes.rotation @ np.stack(axes), modes.translation).as_quat_xyzw(),
            colors=colors,
            labels=[f"{100 * weight:.0f} %" for weight in weights],
        )
        if posterior_poses is not None and len(posterior_poses):
            samples = thinned(posterior_poses, _CLOUD_SIZE).translation.astype(np.float32)
            self._rows.add("world/posterior", rr.Points3D, positions=samples)
            some = thinned(posterior_poses, _FRUSTA)
            self._rows.add("world/posterior/cameras", rr.LineStrips3D, strips=frusta(some))

    def _log_plots(self, frame: Frame, estimate: Estimate) -> None:
        best = estimate.modes[0]
        self._plot("belief/best_weight", best.weight)
        self._plot("belief/agreement", estimate.agreement)
        self._plot("belief/status", _STATUS_LEVEL[estimate.status])
        if frame.world_from_camera is not None:
            translation_m, rotation_rad = best.world_from_camera.distance(frame.world_from_camera)
            self._plot("error/translation_m", float(translation_m))
            self._plot("error/rotation_deg", float(np.degrees(rotation_rad)))

    def _plot(self, entity: str, value: float) -> None:
        import rerun as rr

        self._rows.add(entity, rr.Scalars, scalars=[value])

    def _finish(self, *, keep: bool) -> None:
        """Close the streams; the recording gets its name, or goes."""
        try:
            if keep:
                self._rows.send()
            self._stream.flush(timeout_sec=_FLUSH_S if self._recording is None else math.inf)
        except RuntimeError as error:  # it says no more than that there was one
            if keep:
                keep = False
                raise VaporTrackError(f"the Rerun viewer cannot be written to: {error}") from error
        finally:
            self._stream.disconnect()
            if self._recording is not None:
                recording, self._recording = self._recording, None
                recording.close(keep=keep)


def _require_display() -> None:
    """Raise VaporTrackError where no window can open: the viewer would end, and be waited for."""
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise VaporTrackError("the Rerun viewer needs a display, expected DISPLAY or WAYLAND_DISPLAY to be set")


@contextmanager
def _scripts_on_path() -> Iterator[None]:
    """Have the viewer found that was installed beside this Python, also where its environment is not activated."""
    path = os.environ.get("PATH", "")
    os.environ["PATH"] = os.pathsep.join([path, os.path.dirname(sys.executable)])
    try:
        yield
    finally:
        os.environ["PATH"] = path


def load_rerun() -> ModuleType:
    """Rerun, which takes a while, and does not print of errors what is told of them here."""
    level = os.environ.get("RUST_LOG")
    os.environ["RUST_LOG"] = level or "off"  # read when it is imported
    try:
        import rerun
        import rerun.blueprint

        return rerun
    finally:
        if level is None:
            del os.environ["RUST_LOG"]
