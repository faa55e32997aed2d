"""What a network calls other, on scenes of a few colours that a network of random weights tells apart."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from sequences.frame import Frame
from tests.helpers.command_line import main
from tests.helpers.sequence_files import Walk
from tests.helpers.tiny_model import NETWORK, altered
from vapor.benchmark.ood_images import CHANGED, NARROWER, OUT_OF_DISTRIBUTION, evaluate_flags
from vapor.calibration.calibrate_model import calibrate_model
from vapor.calibration.ood_model import fit_ood_model, learn_ood_model
from vapor.checkpoints.file_format import load_checkpoint, save_checkpoint
from vapor.evaluation.seen_images import describe_images
from vapor.observation import VaporObservationModel
from vapor.regressors.network_config import make_backbone, stage_channels
from vapor.regressors.ood_model import description_size
from vapor.regressors.scene_box import SceneBox
from vapor.regressors.variational import VariationalPoseRegressor
from vapor.tensor_files import CheckpointError, read_safetensors
from vapor.training_data.load import load_training_set

torch.manual_seed(0)
REGRESSOR = VariationalPoseRegressor(NETWORK, SceneBox((-1.0,) * 3, (1.0,) * 3)).eval()


def room(number: int, *, seed: int = 0) -> np.ndarray:
    """Stripes of a few warm colours, as wide as the number says, with some noise."""
    rng = np.random.default_rng([seed, number])
    x = np.arange(48)
    stripes = np.stack([150 + 60 * np.sin(x / (4 + 0.1 * number) + c + 0.05 * number) for c in range(3)], axis=1)
    stripes = np.broadcast_to(stripes * [1.0, 0.8, 0.5], (40, 48, 3)) + rng.normal(0, 3, (40, 48, 3))
    stripes[20:] *= 0.5
    return np.clip(stripes, 0, 255).astype(np.uint8)


def images(numbers, *, seed=0, change=lambda image: image):
    frames = [Frame(i, change(room(n, seed=seed)), None, Poses.identity()) for i, n in enumerate(numbers)]
    return load_training_set({"room": frames}, NETWORK.frame_size)


@pytest.fixture(scope="module")
def ood_model():
    found = learn_ood_model(REGRESSOR, images(range(100)), images(range(100), seed=1))
    assert found is not None
    return found


def scores(ood_model, data):
    return ood_model.ood_score(describe_images(REGRESSOR, data))


def test_an_image_learned_from_scores_about_0_and_a_new_one_of_the_place_below_1(ood_model):
    assert scores(ood_model, images(range(100))).max() < 0.3
    new = scores(ood_model, images(range(100), seed=2))
    assert (new > 1.0).mean() <= 0.03
    assert new.mean() > 0.1


@pytest.mark.parametrize("kind", [kind for kind in OUT_OF_DISTRIBUTION if not kind.startswith(("mirrored", "blurred"))])
def test_images_of_no_such_place_score_above_1(ood_model, kind):
    rng = np.random.default_rng(0)
    other = images(range(0, 100, 10), change=lambda image: np.ascontiguousarray(OUT_OF_DISTRIBUTION[kind](image, rng)))
    assert (scores(ood_model, other) > 1.0).all()


def test_the_threshold_is_the_larger_of_what_training_and_held_out_images_ask_for(ood_model):
    assert ood_model.threshold >= ood_model.own_distance
    far = describe_images(REGRESSOR, images(range(60), change=lambda image: image[..., ::-1]))
    moved = ood_model.with_threshold_of(far)
    assert moved.threshold > 1.5 * ood_model.threshold
    assert (moved.ood_score(far) <= 1.0).mean() >= 0.98
    near = ood_model.with_threshold_of(describe_images(REGRESSOR, images(range(60))))
    assert near.threshold == ood_model.own_distance
    assert ood_model.with_threshold_of(far[:49]).threshold == ood_model.own_distance


def test_own_distance_is_to_other_stretches_not_to_the_images_beside():
    rng = np.random.default_rng(0)
    size = description_size(REGRESSOR.config.backbone)
    places = rng.standard_normal((4, size))
    apart = np.repeat(places, 25, axis=0) + 0.01 * rng.standard_normal((100, size))
    beside = fit_ood_model(apart.astype(np.float32), np.arange(100) % 4)
    others = fit_ood_model(apart.astype(np.float32), np.repeat(np.arange(4), 25))
    assert others.own_distance > 10 * beside.own_distance


def test_too_few_images_say_nothing_about_what_is_familiar():
    assert learn_ood_model(REGRESSOR, images(range(49)), images(range(60))) is None


@pytest.mark.parametrize("name", ["resnet18-quarter", "efficientnet-lite0"])
def test_a_backbone_says_how_many_channels_its_stages_have(name):
    backbone, found = make_backbone(name), list[int]()
    for stage in backbone.stages:
        stage.register_forward_hook(lambda _m, _i, output: found.append(output.shape[1]))
    backbone.eval()(torch.zeros(1, 3, 64, 64))
    assert tuple(found) == stage_channels(name)


# --- in a model file -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def model(tiny_model, ood_model, tmp_path_factory):
    """The tiny model, knowing the room; its weights are others than the room was described with."""
    checkpoint = load_checkpoint(tiny_model)
    network = checkpoint.build_network()
    known = learn_ood_model(network, images(range(100)), images(range(100), seed=1))
    path = tmp_path_factory.mktemp("known") / "tiny.safetensors"
    save_checkpoint(path, replace(checkpoint, ood_model=known), store_float16=True)
    return path


def test_observing_gives_the_score_of_the_same_pass_and_the_same_samples_as_without(model, tiny_model):
    checkpoint = load_checkpoint(model)
    assert checkpoint.ood_model is not None
    knowing, without = (VaporObservationModel.from_checkpoint(str(p), num_samples=20) for p in (model, tiny_model))
    posterior = knowing.observe(room(7, seed=5), rng=np.random.default_rng(0))
    bare = without.observe(room(7, seed=5), rng=np.random.default_rng(0))
    described = describe_images(checkpoint.build_network(), images([7], seed=5))
    assert posterior.ood_score == pytest.approx(checkpoint.ood_model.ood_score(described)[0], rel=1e-3)
    assert 0.0 < posterior.ood_score < 1.0
    assert bare.ood_score == 0.0
    np.testing.assert_array_equal(posterior.samples.as_matrix(), bare.samples.as_matrix())
    black = knowing.observe(np.zeros((40, 48, 3), np.uint8), rng=np.random.default_rng(0))
    assert black.ood_score > 1.0


def test_what_is_familiar_comes_back_from_a_model_file_exactly(model, tmp_path):
    first = load_checkpoint(model)
    save_checkpoint(tmp_path / "again.safetensors", first)
    again = load_checkpoint(tmp_path / "again.safetensors")
    assert first.ood_model is not None
    assert again.ood_model is not None
    for name, value in vars(first.ood_model).items():
        np.testing.assert_array_equal(getattr(again.ood_model, name), value)
    _, tensors = read_safetensors(model)
    assert sum(t.nbytes for n, t in tensors.items() if n.startswith("ood_model.")) < 200_000


DAMAGE = {
    "surplus": (lambda t: t.update({"ood_model.more": torch.zeros(1)}), "surplus tensor ood_model.more"),
    "of another network": (lambda t: t.update({"ood_model.centre": torch.zeros(3)}), "centre has shape"),
    "not finite": (lambda t: t["ood_model.exemplars"].fill_(torch.nan), "exemplars has values that are not finite"),
    "threshold of zero": (lambda t: t["ood_model.threshold"].zero_(), "threshold 0.0, expected positive"),
    "scale of zero": (lambda t: t["ood_model.scale"].zero_(), "scale has values that are not positive"),
}  # fmt: skip


@pytest.mark.parametrize("case", DAMAGE)
def test_a_file_with_unusable_ood_model_is_refused(model, tmp_path, case):
    change, message = DAMAGE[case]
    bad = altered(model, tmp_path / "bad.safetensors", lambda tensors, _: change(tensors))
    with pytest.raises(CheckpointError, match=rf"bad\.safetensors: .*{message}"):
        load_checkpoint(bad)


# --- commands --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def walks(tmp_path_factory):
    folder = tmp_path_factory.mktemp("walks")
    return [str(Walk(60).write(folder / f"{n}.mcap")) for n in "ab"]


def test_calibrate_learns_what_is_familiar_from_training_data_and_else_from_half_of_the_held_out(
    tiny_model, walks, tmp_path
):
    a, b = walks
    outputs = [tmp_path / f"{n}.safetensors" for n in "123"]
    calibrate_model(str(tiny_model), [b], outputs[0], training=[a], ood_only=True)
    calibrate_model(str(tiny_model), [a, b], outputs[1], ood_only=True)
    taught, halved = (load_checkpoint(path).ood_model for path in outputs[:2])
    assert taught is not None
    assert halved is not None
    np.testing.assert_array_equal(taught.exemplars, halved.exemplars)  # both of walk a
    assert main(["calibrate", str(outputs[0]), b, "--ood-only", "--output", str(outputs[2])]) == 0
    again = load_checkpoint(outputs[2]).ood_model
    assert again is not None
    np.testing.assert_array_equal(taught.exemplars, again.exemplars)
    assert again.threshold == taught.threshold  # judged by the same images again
    with pytest.raises(VaporTrackError, match="shares images"):
        calibrate_model(str(tiny_model), [a], outputs[2], training=[a])


def test_the_benchmark_counts_what_is_flagged_of_every_kind(model, walks, capsys):
    observer = VaporObservationModel.from_checkpoint(str(model), num_samples=1)
    rows = evaluate_flags(observer, [walks[0]], [walks[1]], every=4)
    known, other = ([name, *(f"{name}, {each}" for each in NARROWER)] for name in ("known", "b.mcap"))
    assert [row.kind for row in rows] == [*known, *OUT_OF_DISTRIBUTION, *CHANGED, *other]
    assert {row.images for row in rows} == {15}
    by_kind = {row.kind: row for row in rows}
    assert by_kind["uniform noise"].fraction == by_kind["uniform noise"].fraction_in_a_row == 1.0
    assert by_kind["known"].fraction == by_kind["b.mcap"].fraction  # the walks are alike
    assert main(["vapor-benchmark", "out-of-distribution", str(model), "--known", walks[0], "--every", "20"]) == 0
    assert "upside down" in capsys.readouterr().out


def test_a_model_that_knows_nothing_of_it_cannot_be_judged(tiny_model, walks, capsys):
    assert main(["vapor-benchmark", "out-of-distribution", str(tiny_model), "--known", walks[0]]) == 1
    assert "the model file has no OOD model" in capsys.readouterr().err
