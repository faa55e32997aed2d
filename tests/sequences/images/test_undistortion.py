"""Lenses that distort -> pinhole cameras: against renderings, and everything that can be wrong with intrinsics."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from sequences.datasets.frames import posed_frames
from sequences.errors import SequenceError
from sequences.frame import Camera
from sequences.images.undistortion import Lens, pinhole_of, undistorted
from sequences.options import SequenceOptions
from sequences.reader import SequenceReader
from sequences.reading.camera_info import ImageCamera
from sequences.recordings.bag import Bag
from sequences.recordings.message_definitions import decoder, encoder
from sequences.writer import SequenceWriter
from tests.helpers.sequence_files import BASE_FROM_CAMERA, BEGIN_NS, Walk, rewrite, world_from_camera
from tests.helpers.sequence_files import CAMERA as SMALL
from tests.helpers.tf_files import MS, camera_infos, images, mounted, odometry, record, stamps
from tests.helpers.views import taken_by

CAMERA = Camera(160, 120, 110.0, 108.0, 77.0, 62.0)
LENSES = {
    "barrel": Lens(CAMERA, "plumb_bob", (-0.3, 0.1, 0.001, -0.002, 0.0)),
    "pincushion": Lens(CAMERA, "plumb_bob", (0.2, 0.05, 0.0, 0.001)),
    "turns back outside": Lens(CAMERA, "plumb_bob", (-0.35, 0.0, 0.0, 0.0, 0.0)),
    "rational": Lens(CAMERA, "rational_polynomial", (0.1, 0.02, 0.0005, -0.0002, 0.01, 0.4, 0.05, 0.01)),
    "fisheye": Lens(CAMERA, "equidistant", (-0.02, 0.005, 0.0, 0.001)),
}


@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES)
def test_an_undistorted_image_is_what_the_pinhole_camera_takes(lens: Lens) -> None:
    image, pinhole = undistorted(taken_by(lens), lens)
    assert pinhole == pinhole_of(lens)
    assert pinhole is pinhole_of(lens)  # found once for all images
    assert (pinhole.width, pinhole.height, pinhole.cx, pinhole.cy) == (160, 120, 77.0, 62.0)
    difference = np.abs(image.astype(float) - taken_by(pinhole))
    assert difference.mean() < 0.7
    assert np.quantile(difference, 0.999) < 7
    # Without it the same pixels show something else.
    assert np.abs(taken_by(lens).astype(float) - taken_by(pinhole)).mean() > 3


@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES)
def test_the_pinhole_camera_sees_as_much_as_the_lens_does_and_nothing_else(lens: Lens) -> None:
    white, pinhole = np.full((120, 160, 3), 255, np.uint8), pinhole_of(lens)
    maps = cv2.fisheye.initUndistortRectifyMap if lens.model == "equidistant" else cv2.initUndistortRectifyMap

    def matrix(camera: Camera, zoom: float = 1.0) -> np.ndarray:
        return np.array([[zoom * camera.fx, 0, camera.cx], [0, zoom * camera.fy, camera.cy], [0, 0, 1]])

    def black(zoom: float) -> int:
        """Pixels that no pixel of the lens shows, at so much longer a focal length."""
        coefficients, size = np.array(lens.coefficients), (160, 120)
        made = maps(matrix(lens.camera), coefficients, np.eye(3), matrix(pinhole, zoom), size, cv2.CV_32FC1)
        return int((cv2.remap(white, *made, cv2.INTER_NEAREST) == 0).any(axis=-1).sum())

    assert black(1.02) == 0
    assert black(0.97) > 0 or lens is LENSES["turns back outside"]  # it would show things twice


def test_a_lens_that_sees_behind_itself_becomes_a_camera_of_120_degrees() -> None:
    pinhole = pinhole_of(Lens(Camera(640, 480, 200.0, 200.0, 319.5, 239.5), "equidistant", (0.0, 0.0, 0.0, 0.0)))
    assert 2 * np.degrees(np.arctan(320 / pinhole.fx)) == pytest.approx(120, abs=0.2)


def test_images_of_another_size_are_undistorted_alike() -> None:
    lens = LENSES["barrel"]
    half, pinhole = undistorted(cv2.resize(taken_by(lens), (80, 60), interpolation=cv2.INTER_AREA), lens)
    assert pinhole == pinhole_of(lens.scaled(80, 60))
    expected = cv2.resize(taken_by(pinhole.scaled(160, 120)), (80, 60), interpolation=cv2.INTER_AREA)
    assert np.abs(half.astype(float) - expected).mean() < 1.0
    square = np.zeros((100, 100, 3), np.uint8)
    other, camera = undistorted(square, lens)
    assert other is square
    assert camera is None


def test_a_distortion_that_no_lens_has_is_refused() -> None:
    with pytest.raises(SequenceError, match=r"coefficients -400, 0, 0, 0 of plumb_bob fold the image"):
        pinhole_of(Lens(CAMERA, "plumb_bob", (-400.0, 0.0, 0.0, 0.0)))


def write_walk(path: Path, camera: Camera | Lens, num_images: int = 2) -> Path:
    """A recording of the scene, without loss."""
    image = cv2.imencode(".png", taken_by(camera)[..., ::-1])[1].tobytes()
    walk = Walk(num_images=num_images)
    with SequenceWriter(path, camera=camera, base_from_camera=BASE_FROM_CAMERA) as writer:
        for time_ns, pose in walk.odometry:
            writer.write_odometry(time_ns, pose, walk.twist_covariance)
        for time_ns, _ in walk.images:
            writer.write_true_pose(time_ns, world_from_camera(time_ns))
            writer.write_encoded_image(time_ns, image, "png")
    return path


@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES)
def test_a_recording_is_read_as_a_pinhole_camera_would_have_made_it(lens: Lens, tmp_path: Path) -> None:
    path = write_walk(tmp_path / "a.mcap", lens)
    reader = SequenceReader(path)
    frames = list(reader)
    assert reader.camera == frames[0].camera == frames[1].camera == pinhole_of(lens)
    np.testing.assert_array_equal(frames[0].image, undistorted(taken_by(lens), lens)[0])
    assert reader.notices == []
    as_it_is = next(iter(SequenceReader(path, SequenceOptions(undistort=False))))
    assert as_it_is.camera == lens.camera
    np.testing.assert_array_equal(as_it_is.image, taken_by(lens))
    trained_on = next(posed_frames(path, options=SequenceOptions(undistort=False)))
    np.testing.assert_array_equal(trained_on.image, as_it_is.image)


def with_info(source: Path, target: Path, change: Callable[[SimpleNamespace], None]) -> Path:
    """A copy whose CameraInfo says something else."""
    name = "sensor_msgs/CameraInfo"

    def data(topic: str, time_ns: int, data: bytes) -> bytes:
        if topic != "/camera/camera_info":
            return data
        message = decoder(name)(data)
        change(message)
        return encoder(name)({field: value for field, value in vars(message).items() if field != "__msgtype__"})

    return rewrite(source, target, data=data)


def test_a_topic_of_rectified_images_follows_the_rectified_intrinsics(tmp_path: Path) -> None:
    lens = LENSES["barrel"]
    path = rewrite(
        write_walk(tmp_path / "a.mcap", lens),
        tmp_path / "b.mcap",
        topic_names={"/camera/image/compressed": "/camera/image_rect/compressed"},
    )
    frame = next(iter(SequenceReader(path)))
    assert frame.camera == pinhole_of(lens)  # as the writer's P says
    np.testing.assert_array_equal(frame.image, taken_by(lens))


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of a barrel lens, of which tests change what is said."""
    lens = Lens(CAMERA, "plumb_bob", (-0.3, 0.1, 0.0, 0.0, 0.0))
    return write_walk(tmp_path_factory.mktemp("lens") / "walk.mcap", lens)


def camera_of(plain: Path, folder: Path, changes: dict[str, object], *, undistort: bool = True) -> ImageCamera:
    """What is read of a recording whose CameraInfo says something else."""

    def change(message: SimpleNamespace) -> None:
        for name, value in changes.items():
            setattr(message, name, value)

    bag = Bag(with_info(plain, folder / "walk.mcap", change))
    topics = bag.topics
    return ImageCamera(bag, topics["/camera/camera_info"], topics["/camera/image/compressed"], undistort=undistort)


@pytest.mark.parametrize(
    "changes",
    [
        {"d": []},
        {"d": [0.0] * 5},
        {"d": [0.0] * 4, "distortion_model": "equidistant"},
        {"d": [], "distortion_model": ""},
    ],
)
def test_zero_coefficients_are_no_distortion(changes: dict[str, object], plain: Path, tmp_path: Path) -> None:
    camera = camera_of(plain, tmp_path, changes)
    assert camera.camera == CAMERA
    image = taken_by(CAMERA)
    assert camera.seen(image, BEGIN_NS) == (image, CAMERA)


def test_zero_intrinsics_are_an_uncalibrated_camera(plain: Path, tmp_path: Path) -> None:
    camera = camera_of(plain, tmp_path, {"k": [0.0] * 9})
    image = taken_by(CAMERA)
    assert (camera.camera, camera.notices, camera.seen(image, BEGIN_NS)) == (None, [], (image, None))


def test_binned_and_cropped_images_have_intrinsics_of_their_own(plain: Path, tmp_path: Path) -> None:
    roi = {"x_offset": 20, "y_offset": 10, "width": 120, "height": 100, "do_rectify": False}
    camera = camera_of(plain, tmp_path, {"roi": roi, "binning_x": 2, "binning_y": 2, "d": []}).camera
    assert camera == Camera(60, 50, 55.0, 54.0, (57.5 / 2) - 0.5, (52.5 / 2) - 0.5)


def test_an_unknown_distortion_is_said_and_left(plain: Path, tmp_path: Path) -> None:
    camera = camera_of(plain, tmp_path, {"distortion_model": "mei"})
    assert camera.camera is None
    assert camera.notices == [
        "distortion model 'mei' of the camera is not known, expected one of plumb_bob, rational_polynomial,"
        " equidistant, fisheye, kannala_brandt, kannala_brandt4: images are used as they are, and intrinsics not at all"
    ]


def test_images_of_another_aspect_than_their_camera_are_said_once_and_left(plain: Path, tmp_path: Path) -> None:
    camera = camera_of(plain, tmp_path, {})
    for _ in range(3):
        assert camera.seen(np.zeros((90, 160, 3), np.uint8), BEGIN_NS)[1] is None
    assert camera.notices == [
        "images have 160 x 90 pixels, but their camera info states 160 x 120: it is not used, and images are not"
        " undistorted"
    ]


ZOOMED = replace(SMALL, fx=2 * SMALL.fx, fy=2 * SMALL.fy)
STAMPS_NS = [BEGIN_NS + 100 * MS * i for i in range(12)]


@pytest.mark.parametrize("late_ms", [0, 250, -250])
def test_each_image_has_the_intrinsics_of_its_stamp_however_late_they_are_logged(late_ms: int, tmp_path: Path) -> None:
    infos = camera_infos((t, ZOOMED if 5 <= i < 9 else SMALL) for i, t in enumerate(STAMPS_NS))
    infos = [event._replace(time_ns=event.time_ns + late_ms * MS) for event in infos]
    reader = SequenceReader(record(tmp_path / "a.mcap", images(), mounted(), odometry(stamps()), infos))
    assert [frame.camera for frame in reader] == [SMALL] * 5 + [ZOOMED] * 4 + [SMALL] * 3


def test_intrinsics_that_come_only_when_they_change_hold_until_the_next(tmp_path: Path) -> None:
    infos = camera_infos([(STAMPS_NS[0] - 10 * MS, SMALL), (STAMPS_NS[7], ZOOMED)])
    reader = SequenceReader(record(tmp_path / "a.mcap", images(), mounted(), odometry(stamps()), infos))
    assert [frame.camera for frame in reader] == [SMALL] * 7 + [ZOOMED] * 5


def test_intrinsics_that_are_of_no_camera_are_left_out_and_those_before_kept(tmp_path: Path) -> None:
    said: list[float] = []

    def broken(message: SimpleNamespace) -> None:
        said.append(float("nan") if len(said) in (4, 7) else 60.0)
        message.k = matrix(said[-1], 60.0, 79.5)

    path = write_walk(tmp_path / "a.mcap", CAMERA, num_images=12)
    reader = SequenceReader(with_info(path, tmp_path / "broken.mcap", broken))
    assert [frame.camera.fx for frame in reader if frame.camera is not None] == [60.0] * 12
    assert reader.skipped == {"unusable intrinsics": 2}


def matrix(fx: float, fy: float, cx: float) -> list[float]:
    return [fx, 0.0, cx, 0.0, fy, 1.0, 0.0, 0.0, 1.0]


BAD = {
    "NaN in D": ({"d": [0.1, np.nan, 0, 0, 0]}, "distortion coefficient 2 is nan, expected finite numbers"),
    "infinite D": ({"d": [np.inf, 0, 0, 0, 0]}, "distortion coefficient 1 is inf, expected finite numbers"),
    "three": ({"d": [0.1, 0.1, 0.1]}, "3 distortion coefficients of plumb_bob, expected 4 or 5 or 8 or 12 or 14"),
    "fisheye with eight": (
        {"d": [0.1] * 8, "distortion_model": "equidistant"},
        "8 distortion coefficients of equidistant, expected 4",
    ),
    "negative focal length": ({"k": matrix(-5.0, 5.0, 1.0)}, "camera with fx -5.0, expected between"),
    "no second focal length": ({"k": matrix(5.0, 0.0, 1.0)}, "camera with fy 0.0, expected between"),
    "NaN in K": ({"k": matrix(5.0, 5.0, np.nan)}, "camera with cx nan, expected between"),
    "no width": ({"width": 0}, "camera with width 0, expected between"),
    "folded": ({"d": [-400.0, 0, 0, 0, 0]}, "fold the image about its principal point"),
}


@pytest.mark.parametrize(("changes", "said"), BAD.values(), ids=BAD)
def test_what_is_no_camera_is_named(changes: dict[str, object], said: str, plain: Path, tmp_path: Path) -> None:
    with pytest.raises(
        SequenceError, match=rf"walk\.mcap: /camera/camera_info: .*{said}.* \(--no-undistort leaves distortion alone"
    ):
        camera_of(plain, tmp_path, changes)
    if "d" in changes:
        assert camera_of(plain, tmp_path, changes, undistort=False).camera == CAMERA
