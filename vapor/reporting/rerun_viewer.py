"""Watch a run in Rerun: live, or as a recording to open later."""

from __future__ import annotations

import os
import shutil
import threading
from pathlib import Path
from types import ModuleType, TracebackType
from typing import TYPE_CHECKING, Protocol

import numpy as np
from jaxtyping import Float32, Float64, UInt8

from filtering.errors import VaporTrackError
from filtering.estimate import Estimate, Status
from filtering.se3 import Poses
from sequences.atomic import atomic_output
from sequences.frame import Camera, Frame
from vapor.reporting.pictures import COLORS

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

_CLOUD_SIZE = 300
_FRUSTA = 40  # samples of an image's posterior that are shown as cameras
_IMAGE_SIDE = 480  # pixels
_JPEG_QUALITY = 75
_EPOCH_NS = 10**17  # stamps below are seconds since some start, not since 1970
_JUMP_M = 0.5  # an estimate that moves so much farther than the odometry changed its mind
_STATUS_LEVEL: dict[Status, float] = {"lost": 0.0, "ambiguous": 0.5, "converged": 1.0}


class Viewer(Protocol):
    """Watches a run; used in a `with` block, so that an error leaves no half-written recording."""

    def log(self, frame: Frame, estimate: Estimate, posterior_poses: Poses | None) -> None:
        """Show one image, the belief after it, and samples (m,) of the image's own posterior."""
        ...

    def close(self) -> None:
        """Finish; a recording appears under its name."""
        ...

    def __enter__(self) -> Viewer: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


class NullViewer:
    """Shows nothing, so that the loop never asks."""

    def log(self, frame: Frame, estimate: Estimate, posterior_poses: Poses | None) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""

    def __enter__(self) -> NullViewer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        pass


class RerunViewer:
    """Writes a Rerun recording, shows it live, or both.

    Args:
        path: The recording to write, `.rrd`; it appears under its name on `close`. None for none.
        spawn: Whether to open the viewer's window now and stream into it.
        title: Name of the run in the viewer.

    Raises:
        SequenceError: the folder is missing.
        VaporTrackError: the viewer cannot be started, or nothing was asked for.
    """

    def __init__(self, path: Path | None = None, *, spawn: bool = False, title: str = "vapor-track") -> None:
        rr = _quiet_rerun()
        if path is None and not spawn:
            raise VaporTrackError("a viewer needs a recording to write or a window to open, got neither")
        self._recording: _Recording | None = None
        self._stream = rr.RecordingStream("vapor-track", recording_id=title)
        sinks: list[rr.FileSink | rr.GrpcSink] = []
        if spawn:
            try:
                self._stream.spawn(connect=False, hide_welcome_screen=True)
            except RuntimeError as error:
                raise VaporTrackError(f"the Rerun viewer cannot be started: {error}") from error
            sinks.append(rr.GrpcSink())
        if path is not None:
            self._recording = _Recording(path)
            sinks.append(rr.FileSink(self._recording.pipe))
        self._stream.set_sinks(*sinks, default_blueprint=_blueprint())
        self._camera: Camera | None = None
        self._last_best: Poses | None = None
        self._last_truth: Poses | None = None
        _log_styles(self._stream)

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
        if frame.time_ns >= _EPOCH_NS:
            self._stream.set_time("time", timestamp=np.datetime64(frame.time_ns, "ns"))
        else:
            self._stream.set_time("time", duration=np.timedelta64(frame.time_ns, "ns"))
        self._log_camera(frame, estimate)
        self._log_belief(estimate, posterior_poses)
        self._log_plots(frame, estimate)
        self._last_best = estimate.modes[0].world_from_camera
        self._last_truth = frame.world_from_camera

    def _log_camera(self, frame: Frame, estimate: Estimate) -> None:
        import rerun as rr

        best, truth = estimate.modes[0].world_from_camera, frame.world_from_camera
        self._log_image(frame)
        self._stream.log("world/camera", rr.Transform3D(translation=best.translation, mat3x3=best.rotation))
        moved = np.zeros(3) if frame.odometry is None else frame.odometry.previous_from_current.translation
        limit_m = _JUMP_M + 1.5 * float(np.linalg.norm(moved))
        self._log_step("world/path/filter", self._last_best, best, limit_m=limit_m)
        if truth is not None:
            ahead = rr.Arrows3D(origins=[truth.translation], vectors=[0.5 * truth.rotation[:, 2]])
            self._stream.log("world/truth", ahead)
            self._log_step("world/path/truth", self._last_truth, truth, limit_m=np.inf)

    def _log_image(self, frame: Frame) -> None:
        import rerun as rr

        if frame.image.size == 0:  # estimates without images
            return
        jpeg, width, height = _jpeg(frame.image)
        camera = frame.camera or _stand_in_camera(frame.image)
        if camera != self._camera:
            self._camera = camera
            scale = np.array([width / camera.width, height / camera.height])
            focal = scale * (camera.fx, camera.fy)
            centre = scale * (camera.cx + 0.5, camera.cy + 0.5)  # Rerun's pixels begin at integers, ours lie on them
            size = {"width": width, "height": height, "image_plane_distance": 0.5}
            pinhole = rr.Pinhole(focal_length=focal, principal_point=centre, **size, color=_rgb("filter"))
            self._stream.log("world/camera", pinhole)
        self._stream.log("world/camera", rr.EncodedImage(contents=jpeg, media_type="image/jpeg"))

    def _log_step(self, entity: str, last: Poses | None, now: Poses, *, limit_m: float) -> None:
        """One segment an image: the view adds them up, and the recording grows with the path, not its square."""
        import rerun as rr

        moved = last is not None and float(np.linalg.norm(now.translation - last.translation)) <= limit_m
        segment = np.stack([now.translation if last is None or not moved else last.translation, now.translation])
        self._stream.log(entity, rr.LineStrips3D([segment.astype(np.float32)]))

    def _log_belief(self, estimate: Estimate, posterior_poses: Poses | None) -> None:
        import rerun as rr

        points = estimate.cloud(_CLOUD_SIZE).translation
        modes = Poses.stack([mode.world_from_camera for mode in estimate.modes])
        weights = np.array([mode.weight for mode in estimate.modes])
        nearest = np.linalg.norm(points[:, None] - modes.translation, axis=-1).argmin(axis=1)
        cloud = rr.Points3D(points.astype(np.float32), colors=_weight_colors(weights)[nearest])
        self._stream.log("world/particles", cloud)
        sigma, axes = zip(*(_ellipsoid(mode.covariance[:3, :3]) for mode in estimate.modes), strict=True)
        ellipsoids = rr.Ellipsoids3D(
            centers=modes.translation,
            half_sizes=2.0 * np.stack(sigma),
            quaternions=Poses(modes.rotation @ np.stack(axes), modes.translation).as_quat_xyzw(),
            colors=_weight_colors(weights),
            labels=[f"{100 * weight:.0f} %" for weight in weights],
        )
        self._stream.log("world/modes", ellipsoids)
        if posterior_poses is not None and len(posterior_poses):
            samples = _some(posterior_poses, _CLOUD_SIZE).translation.astype(np.float32)
            self._stream.log("world/posterior", rr.Points3D(samples))
            some = _some(posterior_poses, _FRUSTA)
            self._stream.log("world/posterior/cameras", rr.LineStrips3D(frusta(some)))

    def _log_plots(self, frame: Frame, estimate: Estimate) -> None:
        import rerun as rr

        log = self._stream.log
        log("belief/best_weight", rr.Scalars(estimate.modes[0].weight))
        log("belief/agreement", rr.Scalars(estimate.agreement))
        log("belief/status", rr.Scalars(_STATUS_LEVEL[estimate.status]))
        if frame.world_from_camera is not None:
            translation_m, rotation_rad = estimate.modes[0].world_from_camera.distance(frame.world_from_camera)
            log("error/translation_m", rr.Scalars(float(translation_m)))
            log("error/rotation_deg", rr.Scalars(float(np.degrees(rotation_rad))))

    def _finish(self, *, keep: bool) -> None:
        """Close the streams; the recording gets its name, or goes."""
        try:
            self._stream.flush()
        except RuntimeError as error:  # it says no more than that there was one
            if keep:
                keep = False
                raise VaporTrackError(f"the Rerun viewer cannot be written to: {error}") from error
        finally:
            self._stream.disconnect()
            if self._recording is not None:
                recording, self._recording = self._recording, None
                recording.close(keep=keep)


class _Recording:
    """A file that Rerun writes through a pipe: where there is no room, Rerun itself would wait for ever.

    Attributes:
        pipe: What Rerun is to write to.
        error: Why the file could not be written; None while it can. What is written to the pipe then is lost.

    Raises:
        SequenceError: the folder is missing or cannot be written to.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._output = atomic_output(path)
        partial = self._output.__enter__()
        pipe, self._end = os.pipe()
        self.pipe = f"/dev/fd/{self._end}"
        self.error: VaporTrackError | None = None
        self._thread = threading.Thread(target=self._copy, args=(pipe, partial), daemon=True)
        self._thread.start()

    def _copy(self, pipe: int, partial: Path) -> None:
        with open(pipe, "rb") as stream:
            try:
                with partial.open("wb") as file:
                    shutil.copyfileobj(stream, file)
            except OSError as error:
                self.error = VaporTrackError(
                    f"{self._path}: the recording cannot be written: {error.strerror or error}; expected room for it on"
                    " the disk, a run with --no-recording needs none"
                )
            while stream.read(1 << 16):  # so that nobody waits for room in the pipe
                pass

    def close(self, *, keep: bool) -> None:
        """Give the file its name, or remove it, once Rerun has closed the pipe.

        Raises:
            VaporTrackError: the file was to be kept, and could not be written.
        """
        os.close(self._end)
        self._thread.join()
        failed = self.error or (None if keep else VaporTrackError("the run failed"))
        self._output.__exit__(failed and type(failed), failed, None)
        if keep and failed:
            raise failed


def _quiet_rerun() -> ModuleType:
    """Rerun, which does not print of errors what is told of them here."""
    level = os.environ.get("RUST_LOG")
    os.environ["RUST_LOG"] = level or "off"  # read when it is imported
    try:
        import rerun

        return rerun
    finally:
        if level is None:
            del os.environ["RUST_LOG"]


def _some(poses: Poses, count: int) -> Poses:
    """At most `count` of the poses (n,), evenly spaced in their order."""
    return poses[np.linspace(0, len(poses) - 1, min(count, len(poses))).round().astype(np.int64)]


def _log_styles(stream: rr.RecordingStream) -> None:
    """What never changes: axes, colours, sizes, names of the plotted lines."""
    import rerun as rr

    stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    stream.log("world/particles", rr.Points3D.from_fields(radii=[0.03]), static=True)
    stream.log(
        "world/posterior", rr.Points3D.from_fields(radii=[0.015], colors=[(*_rgb("single_image"), 90)]), static=True
    )
    thin_lines = rr.LineStrips3D.from_fields(radii=[0.004], colors=[(*_rgb("single_image"), 90)])
    stream.log("world/posterior/cameras", thin_lines, static=True)
    stream.log("world/truth", rr.Arrows3D.from_fields(radii=[0.03], colors=[(255, 255, 255)]), static=True)
    for name, color, radius in (("filter", _rgb("filter"), 0.02), ("truth", (220, 220, 220), 0.008)):
        stream.log(f"world/path/{name}", rr.LineStrips3D.from_fields(radii=[radius], colors=[color]), static=True)
    for entity, name, color in (
        ("belief/best_weight", "weight of the best hypothesis", _rgb("filter")),
        ("belief/agreement", "agreement of the images", _rgb("smoothed")),
        ("belief/status", "0 lost · ½ ambiguous · 1 converged", _rgb("kalman")),
        ("error/translation_m", "translation error [m]", _rgb("filter")),
        ("error/rotation_deg", "rotation error [°]", _rgb("filter")),
    ):
        stream.log(entity, rr.SeriesLines(names=name, colors=color, widths=1.5), static=True)


def _blueprint() -> rrb.Blueprint:
    """The belief in space, large; beside it the image and the plots."""
    import rerun.blueprint as rrb

    so_far = rrb.VisibleTimeRange(
        "time", start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.cursor_relative()
    )
    paths = {f"world/path/{name}": rrb.VisibleTimeRanges([so_far]) for name in ("filter", "truth")}
    legend, none = rrb.PlotLegend(rrb.Corner2D.RightBottom), rrb.PlotLegend(visible=False)
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Spatial3DView(origin="world", name="belief", overrides=paths),  # pyright: ignore[reportArgumentType]
            rrb.Vertical(
                rrb.Spatial2DView(origin="world/camera", contents="world/camera", name="image"),
                rrb.TimeSeriesView(
                    origin="belief", name="belief", axis_y=rrb.ScalarAxis(range=(0.0, 1.05)), plot_legend=legend
                ),
                rrb.TimeSeriesView(origin="error/translation_m", name="translation error [m]", plot_legend=none),
                rrb.TimeSeriesView(origin="error/rotation_deg", name="rotation error [°]", plot_legend=none),
                row_shares=[3, 2, 2, 2],
            ),
            column_shares=[3, 2],
        ),
        rrb.TimePanel(state="collapsed", timeline="time"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        auto_views=False,
    )


def frusta(poses: Poses, size_m: float = 0.2) -> Float32[np.ndarray, "n 10 3"]:
    """Cameras (n,) as one line each, which goes along every edge of the pyramid from the centre to the image."""
    x, y = 0.5 * size_m, 0.375 * size_m
    corners = np.array([[-x, -y, size_m], [x, -y, size_m], [x, y, size_m], [-x, y, size_m]])
    line = np.concatenate([corners, np.zeros((1, 3))])[[1, 0, 3, 4, 0, 3, 2, 4, 1, 2]]
    points = line @ np.swapaxes(poses.rotation, 1, 2) + poses.translation[:, None]
    return points.astype(np.float32)


def _jpeg(image: UInt8[np.ndarray, "height width 3"]) -> tuple[bytes, int, int]:
    """The image as JPEG with its longer side at most 480 pixels, its width and its height."""
    import cv2

    height, width = image.shape[:2]
    scale = min(1.0, _IMAGE_SIDE / max(height, width))
    if scale < 1.0:
        width, height = max(1, round(width * scale)), max(1, round(height * scale))
        image = np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
    _, jpeg = cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return jpeg.tobytes(), width, height


def _stand_in_camera(image: UInt8[np.ndarray, "height width 3"]) -> Camera:
    """60° across, for the frustum's shape only, where the sequence does not tell the intrinsics."""
    height, width = image.shape[:2]
    focal = width / (2.0 * np.tan(np.radians(30.0)))
    return Camera(width, height, float(focal), float(focal), (width - 1) / 2, (height - 1) / 2)


def _ellipsoid(covariance: Float64[np.ndarray, "3 3"]) -> tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3 3"]]:
    """Standard deviations along the principal axes, and the axes as a right-handed rotation."""
    variance, axes = np.linalg.eigh((covariance + covariance.T) / 2)
    axes[:, 2] *= np.linalg.det(axes)
    return np.sqrt(np.maximum(variance, 1e-8)), axes


def _weight_colors(weights: Float64[np.ndarray, " n"]) -> UInt8[np.ndarray, "n 3"]:
    """Blue for a hypothesis that holds the whole belief, vermilion for one that holds none."""
    none, all_ = np.array(_rgb("other")), np.array(_rgb("filter"))
    share = np.clip(weights, 0.0, 1.0)[:, None]
    return np.round(none + share * (all_ - none)).astype(np.uint8)


def _rgb(name: str) -> tuple[int, int, int]:
    code = COLORS[name]
    return int(code[1:3], 16), int(code[3:5], 16), int(code[5:7], 16)
