"""The walk of `sequence_files`, recorded by several cameras."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from filtering.se3 import Poses
from sequences.frame import Camera
from sequences.writer import MountedCamera, SequenceWriter
from tests.helpers.sequence_files import BASE_FROM_CAMERA, BEGIN_NS, CAMERA, Walk, picture, world_from_camera

FRONT, LEFT, RIGHT = (f"/{name}/image/compressed" for name in ("camera", "left", "right"))
WIDE = Camera(64, 32, 30.0, 31.0, 31.5, 15.5)
CAMERA_FROM_LEFT = Poses.exp(np.array([-0.2, 0.05, -0.1, 0.1, -1.4, 0.2]))
CAMERA_FROM_RIGHT = Poses.exp(np.array([0.2, 0.05, -0.1, 0.1, 1.3, 0.1]))
MOUNTS = {"left": CAMERA_FROM_LEFT, "right": CAMERA_FROM_RIGHT}
NARROW = Camera(40, 32, 40.0, 41.0, 19.5, 15.5)
LENSES = {"left": WIDE, "right": NARROW}


def pose_shown(image: np.ndarray, left_turned: Poses) -> Poses:
    """world_from_camera by the colour of an image and its width, one pose; that of the left camera is turned."""
    index = int(np.argmin([np.abs(picture(i)[0, 0].astype(int) - image[5, 5]).sum() for i in range(12)]))
    mounts = {WIDE.width: CAMERA_FROM_LEFT @ left_turned, NARROW.width: CAMERA_FROM_RIGHT}
    truth = world_from_camera(BEGIN_NS + 100_000_000 * index)
    return truth @ mounts[image.shape[1]] if image.shape[1] in mounts else truth


@dataclass
class Rig:
    """What the other cameras do: the images of each that it takes, and how much later than the first camera."""

    later_ns: Mapping[str, int]
    every: Mapping[str, int]

    def write(self, path: Path, walk: Walk | None = None, spoilt: str = "", beside: Walk | None = None) -> Path:
        """Write the walk; images of a spoilt camera cannot be decoded, and other cameras may have another walk's."""
        walk = walk or Walk()
        stamps = [t for t, _ in (beside or walk).images]
        others = {name: MountedCamera(LENSES[name], BASE_FROM_CAMERA @ MOUNTS[name]) for name in sorted(self.later_ns)}
        with SequenceWriter(path, camera=CAMERA, base_from_camera=BASE_FROM_CAMERA, others=others) as writer:
            events = []
            for n, (t, pose) in enumerate(walk.odometry):
                events.append((t, n, lambda t=t, p=pose: writer.write_odometry(t, p, walk.twist_covariance)))
            for n, (t, pose) in enumerate(walk.truth):
                events.append((t, n, lambda t=t, p=pose: writer.write_true_pose(t, p)))
            for n, (t, data) in enumerate(walk.images):
                events.append((t, n, lambda t=t, d=data: writer.write_encoded_image(t, d, "png")))
            for n, t in enumerate(stamps):
                for name in others:
                    if n % self.every.get(name, 1) == 0 and t + self.later_ns[name] <= walk.truth[-1][0]:
                        events.append((t + self.later_ns[name], n, self._writing(writer, t, n, name, spoilt)))
            for _, _, write in sorted(events, key=lambda event: event[:2]):
                write()
        return path

    def _writing(self, writer, t, n, name, spoilt):
        size = LENSES[name].width, LENSES[name].height
        data = cv2.imencode(".png", np.ascontiguousarray(cv2.resize(picture(n % 12), size)[..., ::-1]))[1].tobytes()
        if name == spoilt:
            data = data[: len(data) // 2]
        return lambda: writer.write_encoded_image(t + self.later_ns[name], data, "png", name)
