"""`vapor-benchmark real`: on data made up here, and what it makes of recorded data where these are present."""

import json
from dataclasses import replace

import numpy as np
import pytest

from filtering.se3 import Poses
from sequences.datasets.listing import list_images
from tests.helpers.data_sets import make_7scenes
from tests.helpers.full import full
from tests.helpers.measured import tables_on_the_page
from tests.helpers.pose_files import noisy, walk, write_named
from vapor.benchmark.__main__ import main
from vapor.benchmark.real import benchmark as real_benchmark
from vapor.benchmark.real import trained_network
from vapor.benchmark.real.copied_places import CopiedPlaces
from vapor.benchmark.real.published import poses_of
from vapor.benchmark.real.row import RealConfig, RowContext, simulated_motions
from vapor.benchmark.real.rows import ROWS
from vapor.benchmark.real.trained_network import TrainedNetwork
from vapor.regressors.loss_config import LossConfig
from vapor.regressors.network_config import NetworkConfig
from vapor.training.config import TrainConfig

TINY = TrainedNetwork(
    "tiny",
    ("scene/seq-01@0:8",),
    "scene/seq-01",
    (2, None),
    evaluated={"": lambda n: np.arange(n) % 2 == 1, "all": lambda n: np.ones(n, bool)},
    config=TrainConfig(
        network=NetworkConfig(image_width=32, image_height=32, shortest_edge=36, feature_dim=16, latent_dim=4),
        loss=LossConfig(num_samples=16),
        epochs=1,
        batch_size=4,
        calibrate=False,
        precision="float32",
        device="cpu",
    ),
)


@pytest.fixture(scope="module")
def stairs(tmp_path_factory):
    """A folder with true poses of two short sequences, and one method's estimates of them."""
    data = tmp_path_factory.mktemp("data")
    (data / "7scenes_stairs" / "estimates").mkdir(parents=True)
    poses = {name: pose for name, pose in walk().items() if "frame-00000" in name}
    write_named(data / "7scenes_stairs" / "stairs_test.txt", poses, world_to_camera=True)
    estimates = data / "7scenes_stairs" / "estimates" / "stairs_hloc.txt"
    write_named(estimates, noisy(poses, 0.04, 0.01), world_to_camera=True)
    return data


def run(data, output, *more: str) -> int:
    words = ["real", "--data", str(data), "--output", str(output), "--num-samples", "30"]
    return main([*words, "--localizer.max-hypotheses", "20", *more])


def summary_of(output):
    return json.loads((output / "summary.json").read_text())


@pytest.mark.usefixtures("unchecked")
def test_a_place_30_times_as_large_gives_the_same_table_times_30(stairs, tmp_path, capsys):
    assert run(stairs, tmp_path, "--seeds", "2") == 0
    out, summary = capsys.readouterr().out, summary_of(tmp_path)
    assert "left out: tum_fr1, for want of tum_fr1/rgbd_dataset_freiburg1_rpy" in out
    assert len(summary["settings"]["left_out"]) == len(ROWS) - 2
    rows = summary["summary"]
    assert rows.keys() == {"stairs_hloc", "stairs_x30_hloc"}
    small, large = rows["stairs_hloc"], rows["stairs_x30_hloc"]
    assert (small["draws"], small["images"], small["unit_m"], large["unit_m"]) == (2, 20, 1.0, 30.0)
    assert out.count("20 images × 2") == 4 * 2
    for method, figures in small["methods"].items():
        scaled = large["methods"][method]
        assert scaled["median_translation_m"][0] == pytest.approx(30 * figures["median_translation_m"][0], rel=1e-4)
        for name in ("median_rotation_deg", "right", "worse_than_0.25m"):
            assert scaled[name][0] == pytest.approx(figures[name][0], rel=1e-4)
    for name in ("converged", "wrong", "median_nees"):
        assert large["filter"][name][0] == pytest.approx(small["filter"][name][0], rel=1e-3)
    assert large["filter"]["coverage"] == small["filter"]["coverage"]
    filtered, alone = (small["methods"][name]["median_translation_m"] for name in ("filter", "single_image"))
    assert filtered[1] <= filtered[0] <= filtered[2] < alone[0]  # two draws of odometry, one of the estimates
    assert alone[1:] == [None, None]
    (table,) = tables_on_the_page("estimates", tmp_path / "summary.json")
    assert [name for name, _ in table["rows"]] == ["stairs_hloc", "stairs_x30_hloc"]
    for name in ("real", "copied"):  # other rows of the same benchmark
        assert tables_on_the_page(name, tmp_path / "summary.json")


@pytest.mark.usefixtures("unchecked")
def test_what_is_done_is_not_done_again_but_where_settings_or_code_changed(stairs, tmp_path, monkeypatch):
    only = ("--only", "stairs", "--seeds", "1")
    assert run(stairs, tmp_path, *only) == 0
    before = (tmp_path / "summary.json").read_bytes()
    done = []
    follow = real_benchmark.follow
    monkeypatch.setattr(real_benchmark, "follow", lambda *a, **k: done.append(a) or follow(*a, **k))
    assert run(stairs, tmp_path, *only) == 0
    assert not done
    assert (tmp_path / "summary.json").read_bytes() == before
    assert run(stairs, tmp_path, *only, "--localizer.switch-ratio", "2") == 0
    assert len(done) == 1
    monkeypatch.setattr(real_benchmark, "results_code", lambda row: "another filter")
    assert run(stairs, tmp_path, *only) == 0
    assert len(done) == 2


@full
@pytest.mark.usefixtures("unchecked")
def test_a_model_is_trained_once_and_anew_where_that_code_changed(tmp_path, monkeypatch):
    make_7scenes(tmp_path / "scene", num_images=10)
    monkeypatch.setattr(real_benchmark, "ROWS", (TINY,))
    output = tmp_path / "out"
    assert run(tmp_path, output, "--seeds", "2") == 0
    rows = summary_of(output)["summary"]
    assert {name: (row["draws"], row["images"]) for name, row in rows.items()} == {
        "tiny": (2, 4),
        "tiny, all": (2, 8),
    }
    models, recordings = ({file.name for file in (output / name).iterdir()} for name in ("models", "recordings"))
    assert (len(models), len(recordings)) == (1, 2)
    with monkeypatch.context() as never:
        never.setattr(trained_network, "train", lambda *_, **__: pytest.fail("trained again"))
        assert run(tmp_path, output, "--seeds", "2") == 0
    monkeypatch.setattr(trained_network, "training_code", lambda: "another")
    monkeypatch.setattr(real_benchmark, "ROWS", (replace(TINY),))  # as in another process: a row asks for it once
    assert run(tmp_path, output, "--seeds", "2") == 0
    assert {file.name for file in (output / "models").iterdir()} > models
    assert {file.name for file in (output / "recordings").iterdir()} == recordings  # the network says the same
    assert not list(output.rglob("*.partial"))


@pytest.mark.usefixtures("unchecked")
def test_a_place_stands_twice_and_what_is_there_once_in_the_copy_walked_in(tmp_path, monkeypatch, capsys):
    make_7scenes(tmp_path / "scene", num_images=22)
    middle = list_images(tmp_path / "scene" / "seq-01").world_from_camera.translation[14, 0]
    copied = CopiedPlaces(
        "copied",
        ("scene/seq-01",),
        "scene/seq-01",
        lambda poses: poses.translation[:, 0] > middle,
        ((0.0, 0.0, 0.0), (0.0, 3.0, 0.0)),
        own=1,
        rate_hz=1.0,
        config=replace(TINY.config, landmarks=False),
    )
    once, both = (copied._copies(tmp_path)[f"scene/seq-01, copy {copy}"] for copy in (1, 0))
    poses = Poses.stack([frame.world_from_camera for frame in once])
    assert len(once) == 22
    assert len(both) == 22 - copied._unique(poses, 1).sum() == 15
    assert np.allclose(once[0].world_from_camera.translation - both[0].world_from_camera.translation, [0.0, 3.0, 0.0])
    assert once[0].image.mean() != both[0].image.mean()
    monkeypatch.setattr(real_benchmark, "ROWS", (copied, replace(copied, name="copied_visual", visual_of="copied")))
    assert run(tmp_path, tmp_path / "out", "--seeds", "2") == 0
    assert len(list((tmp_path / "out" / "models").iterdir())) == 1
    rows = summary_of(tmp_path / "out")["summary"]
    of = ("before", "2 s after", "after")
    assert rows.keys() == {f"{row}, {images}" for row in ("copied", "copied_visual") for images in of}
    context = RowContext(tmp_path, tmp_path / "out", RealConfig(num_samples=30))
    simulated, visual = (row.draw(context, 0).segment for row in real_benchmark.ROWS)
    assert np.array_equal(simulated.times_ns, visual.times_ns)
    assert None not in simulated.odometry[1:]
    assert visual.odometry[1:] == (None,) * (len(visual.odometry) - 1)  # these images are noise
    assert rows["copied, 2 s after"]["images"] == 1
    assert rows["copied, after"]["whole_draws"]["right"].keys() == rows["copied, after"]["methods"].keys()
    assert "copied places: draws in which every image is right" in capsys.readouterr().out


def test_unusable_data_and_names_are_refused(stairs, tmp_path, capsys):
    for data, only, said in (
        (tmp_path / "nowhere", (), "nowhere: no such folder, expected one with recordings such as tum_fr1"),
        (stairs, ("--only", "stars"), "unknown row 'stars', expected one of tum_fr1, tum_fr1_one_walk"),
        (stairs, ("--only", "tum_fr1", "stairs_as"), "nothing to measure, expected any of tum_fr1"),
    ):
        assert run(data, tmp_path / "out", *only) == 1
        assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    with pytest.raises(SystemExit):
        run(stairs, tmp_path, "--seeds", "0")
    assert "seeds is 0" in capsys.readouterr().err


# --- recorded data -------------------------------------------------------------------------------------


def test_the_shared_data_have_every_row(shared_data):
    rows, missing = real_benchmark.choose(shared_data, ())
    assert rows == list(ROWS)
    assert not missing


@pytest.mark.usefixtures("unchecked")
def test_the_corridors_own_odometry_is_one_of_ours(shared_data):
    """It is that of seed 4."""
    with np.load(shared_data / "corridor_posteriors" / "floor.npz") as stored:
        times_ns, truth = stored["time_ns"], poses_of(stored["truth"])
        steps, covariance = poses_of(stored["previous_from_current"]), stored["odometry_covariance"]
    motions = simulated_motions(times_ns, truth, rng=np.random.default_rng(4))
    for i, motion in enumerate(motions):
        np.testing.assert_allclose(motion.previous_from_current.as_matrix(), steps[i].as_matrix(), atol=1e-9)
    stated = np.mean([motion.covariance for motion in motions], axis=0)
    np.testing.assert_allclose(np.diagonal(stated), np.diagonal(covariance.mean(axis=0)), rtol=0.01)


@pytest.mark.usefixtures("unchecked")
def test_hlocs_estimates_of_the_stairs_are_as_good_as_published(shared_data, tmp_path):
    """5.1 cm; in the unit of the scaled row the same."""
    for name in ("stairs_hloc", "stairs_x30_hloc"):
        row = next(row for row in ROWS if row.name == name)
        draw = row.draw(RowContext(shared_data, tmp_path), 0)
        places = [draw.segment.posterior(i).means for i in range(0, 1000, 4)]
        error_m = [place.distance(draw.segment.truth[4 * i])[0].max() for i, place in enumerate(places)]
        assert np.median(error_m) / draw.unit_m == pytest.approx(0.051, abs=0.003)
        assert len(draw.segment.times_ns) == draw.evaluated[""].sum() == 1000
        assert sum(motion is None for motion in draw.segment.odometry) == 2  # of two sequences the first
