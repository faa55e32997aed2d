"""Where is the camera, and how sure is that? Learned pose posteriors and odometry -> a particle filter on SE(3).

Names in `__all__` are public: their meaning changes only with a line in CHANGELOG.md. They are imported on use, so that
`import vapor` takes no time and loads no torch.
"""

# Nothing is imported here: the command starts by this file, and takes the signals before it imports anything.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from filtering.config import LocalizerConfig as LocalizerConfig
    from filtering.errors import VaporTrackError as VaporTrackError
    from filtering.estimate import Estimate as Estimate
    from filtering.estimate import Innovation as Innovation
    from filtering.estimate import Mode as Mode
    from filtering.localizer import ParticleLocalizer as ParticleLocalizer
    from filtering.measurement_noise import MeasurementNoise as MeasurementNoise
    from filtering.motion import Odometry as Odometry
    from filtering.observation import Observation as Observation
    from filtering.observation import View as View
    from filtering.planar import HeightMap as HeightMap
    from filtering.posterior import ObservationModel as ObservationModel
    from filtering.posterior import PosePosterior as PosePosterior
    from filtering.se3 import Poses as Poses
    from filtering.storeys import Storeys as Storeys
    from filtering.vertical import KnownHeight as KnownHeight
    from filtering.vertical import Vertical as Vertical
    from sequences.frame import Trajectory as Trajectory
    from sequences.image_sequence import ImageSequence as ImageSequence
    from sequences.reader import SequenceReader as SequenceReader
    from sequences.trajectories.tum import read_tum as read_tum
    from sequences.trajectories.tum import write_tum as write_tum
    from sequences.visual_odometry.odometry import VisualOdometry as VisualOdometry
    from vapor.calibration.calibrate_model import calibrate_model as calibrate_model
    from vapor.landmarks.verify import LandmarkVerifier as LandmarkVerifier
    from vapor.observation import VaporObservationModel as VaporObservationModel
    from vapor.pipeline.config import RunConfig as RunConfig
    from vapor.pipeline.fuse import fuse as fuse
    from vapor.pipeline.run import run as run
    from vapor.reporting.modes_file import read_mode_trajectories as read_mode_trajectories
    from vapor.reporting.stored_run import StoredRun as StoredRun
    from vapor.reporting.stored_run import read_run as read_run
    from vapor.reporting.trajectory_plot import plot_trajectories as plot_trajectories
    from vapor.robot.belief import LiveEstimate as LiveEstimate
    from vapor.robot.config import LiveConfig as LiveConfig
    from vapor.robot.live import live as live
    from vapor.tracking.mode_trajectories import ModeTrajectory as ModeTrajectory
    from vapor.tracking.mode_trajectories import mode_trajectories as mode_trajectories
    from vapor.tracking.streams import StreamEstimate as StreamEstimate
    from vapor.tracking.streams import StreamLocalizer as StreamLocalizer
    from vapor.training.config import TrainConfig as TrainConfig
    from vapor.training.presets import PRESETS as PRESETS
    from vapor.training.train import train as train

_MODULES = {
    "MeasurementNoise": "filtering.measurement_noise",
    "Estimate": "filtering.estimate",
    "Innovation": "filtering.estimate",
    "ModeTrajectory": "vapor.tracking.mode_trajectories",
    "Storeys": "filtering.storeys",
    "HeightMap": "filtering.planar",
    "ImageSequence": "sequences.image_sequence",
    "KnownHeight": "filtering.vertical",
    "LandmarkVerifier": "vapor.landmarks.verify",
    "LiveConfig": "vapor.robot.config",
    "LiveEstimate": "vapor.robot.belief",
    "LocalizerConfig": "filtering.config",
    "Mode": "filtering.estimate",
    "Observation": "filtering.observation",
    "ObservationModel": "filtering.posterior",
    "Odometry": "filtering.motion",
    "ParticleLocalizer": "filtering.localizer",
    "PRESETS": "vapor.training.presets",
    "PosePosterior": "filtering.posterior",
    "Poses": "filtering.se3",
    "RunConfig": "vapor.pipeline.config",
    "SequenceReader": "sequences.reader",
    "TrainConfig": "vapor.training.config",
    "VaporObservationModel": "vapor.observation",
    "VaporTrackError": "filtering.errors",
    "Vertical": "filtering.vertical",
    "View": "filtering.observation",
    "VisualOdometry": "sequences.visual_odometry.odometry",
    "calibrate_model": "vapor.calibration.calibrate_model",
    "fuse": "vapor.pipeline.fuse",
    "live": "vapor.robot.live",
    "mode_trajectories": "vapor.tracking.mode_trajectories",
    "read_mode_trajectories": "vapor.reporting.modes_file",
    "run": "vapor.pipeline.run",
    "StoredRun": "vapor.reporting.stored_run",
    "StreamEstimate": "vapor.tracking.streams",
    "StreamLocalizer": "vapor.tracking.streams",
    "Trajectory": "sequences.frame",
    "plot_trajectories": "vapor.reporting.trajectory_plot",
    "read_run": "vapor.reporting.stored_run",
    "read_tum": "sequences.trajectories.tum",
    "write_tum": "sequences.trajectories.tum",
    "train": "vapor.training.train",
}

__all__ = [*_MODULES]  # pyright: ignore[reportUnsupportedDunderAll]


if not TYPE_CHECKING:  # a checker reports misspelt names

    def __getattr__(name: str) -> object:
        if name not in _MODULES:
            raise AttributeError(f"module 'vapor' has no attribute {name!r}")
        from importlib import import_module

        value = globals()[name] = getattr(import_module(_MODULES[name]), name)
        return value


def __dir__() -> list[str]:
    return sorted({*(name for name in globals() if name.startswith("__")), *_MODULES})
