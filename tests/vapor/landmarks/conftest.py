import pytest

from tests.helpers.textured_room import CAMERA, Room, walk
from vapor.landmarks.build import build, gather
from vapor.landmarks.landmark_map import ViewCamera
from vapor.landmarks.verify import grey_view


@pytest.fixture(scope="session")
def room():
    return Room()


@pytest.fixture(scope="session")
def material(room):
    """Key images of a walk through the room, and their features."""
    poses = walk(60)
    found = gather(lambda image: grey_view(room.view(poses[image]), CAMERA), poses, CAMERA, scale_m=1.0)
    assert found is not None
    return found


@pytest.fixture(scope="session")
def built(material):
    """The map of the room."""
    found = build(material, ViewCamera(CAMERA))
    assert found is not None
    return found
