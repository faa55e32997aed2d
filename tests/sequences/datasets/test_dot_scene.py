"""The scene of dots, by which conventions of data sets are told apart."""

import numpy as np

from filtering.se3 import Poses
from sequences.frame import Camera, Frame
from tests.helpers import dot_scene
from tests.helpers.dot_scene import CX, CY, FX, FY, HEIGHT, WIDTH, drawn, misses, opencv, opencv_pixels, opengl


def test_the_dots_tell_one_convention_from_another() -> None:
    """The check itself can fail: other axes, another pose or the inverse put no dot where it is."""
    image = drawn(opencv(1), opencv_pixels)[..., ::-1]
    camera = Camera(WIDTH, HEIGHT, FX, FY, CX, CY)
    assert misses(Frame(0, image, None, dot_scene.true_pose(1), camera)).max() < 0.3
    for matrix in (opengl(1), opencv(2), np.linalg.inv(opencv(1))):
        assert misses(Frame(0, image, None, Poses.from_matrix(matrix), camera)).max() > 2.0
