"""`vapor-benchmark gpu`: its stages on a processor, and a processor in the place of a GPU; no GPU is needed."""

import json
import math
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from filtering.se3 import Poses
from sequences.frame import Trajectory
from tests.helpers.command_line import refuse
from tests.helpers.full import full
from vapor.benchmark.__main__ import main
from vapor.benchmark.commands import gpu
from vapor.benchmark.gpu import network, parity, tracking, training
from vapor.benchmark.gpu.deviation import Tolerance, sample_deviation
from vapor.benchmark.gpu.matching import matched
from vapor.benchmark.gpu.setting import TINY, Setting
from vapor.benchmark.gpu.stages import Deadline, Finding, OutOfTime, Stage, carry_out
from vapor.benchmark.gpu.timing import timed
from vapor.benchmark.gpu.training import Reached
from vapor.engines import torch_engine
from vapor.landmarks.features import mutual_matches, restored, stored, unit_vectors

CPU = torch.device("cpu")
TINY_WORDS = ["gpu", "--device", "cpu", "--tiny", "--threads", "1"]


def test_a_missing_gpu_is_told(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    refuse(["vapor-benchmark", "gpu", "--output", str(tmp_path / "a.json")], capsys, "no GPU", "--device cpu --tiny")
    assert not list(tmp_path.iterdir())


@full
def test_every_stage_runs_on_a_processor_and_all_figures_are_written(rough_light, tmp_path, capsys):
    assert main([*TINY_WORDS, "--output", str(tmp_path / "a.json")]) == 0
    out, found = capsys.readouterr().out, json.loads((tmp_path / "a.json").read_text())
    assert found["machine"]["torch"] == torch.__version__
    assert found["settings"]["tiny"]
    assert {stage["stage"]: stage["outcome"] for stage in found["stages"]} == dict.fromkeys(gpu._STAGES, "done")
    for stage in found["stages"]:
        figures = [(each["what"], each["value"]) for each in stage["findings"]]
        assert figures
        assert all(math.isfinite(value) and what in out for what, value in figures)


class _Unrecorded(torch_engine.Recorded):
    """What cannot be recorded on a processor is computed every time, into the inputs that a recording would read."""

    def __init__(self, network, inputs, autocast):
        self._network, self._inputs, self._autocast = network, inputs, autocast

    def __call__(self, image, noise):
        for own, given in zip(self._inputs, (image, noise), strict=True):
            own.copy_(given)
        with self._autocast():
            return self._network(*self._inputs)


def test_all_that_is_done_on_a_gpu_runs_with_a_processor_in_its_place(rough_light, tmp_path, monkeypatch):
    start_engine = torch_engine.TorchEngine.__init__
    monkeypatch.setattr(
        torch_engine.TorchEngine, "__init__", lambda self, model, **_: start_engine(self, model, device="cpu")
    )
    monkeypatch.setattr("vapor.training.state.resolve_device", lambda _: CPU)
    monkeypatch.setattr(network, "Recorded", _Unrecorded)
    monkeypatch.setattr(Setting, "torch_device", CPU)
    setting = Setting("cuda", TINY, tmp_path)
    results = carry_out(gpu._stages(setting, tuple(gpu._STAGES)), Deadline(1000.0))
    assert {result.stage: (result.outcome, result.reason) for result in results} == dict.fromkeys(
        gpu._STAGES, ("done", "")
    )
    assert all(finding.passes in (None, True) for result in results for finding in result.findings)
    named = " ".join(finding.what for result in results for finding in result.findings)
    for what in (
        "float32 as it ships",
        "bfloat16, graph",
        "cuda, bfloat16: whole run",
        "on cuda, image bytes",
        "float32 on cpu",
    ):
        assert what in named


def test_a_network_that_gives_other_poses_on_the_device_fails(rough_light, tmp_path, monkeypatch, capsys):
    run, ways = torch_engine.TorchEngine.run, []

    def shifted(self, image, noise):
        ways.append(self) if self not in ways else None
        seen = run(self, image, noise)
        off = 0.01 if ways.index(self) % 2 else 0.0  # the reference comes first
        return type(seen)(seen.translation + np.float32(off), seen.rotation, seen.description)

    monkeypatch.setattr(torch_engine.TorchEngine, "run", shifted)
    output = tmp_path / "a.json"
    assert main([*TINY_WORDS, "--output", str(output), "--stages", "parity"]) == 1
    assert "checks that failed: staircase model, float32: position" in capsys.readouterr().err
    findings = json.loads(output.read_text())["stages"][0]["findings"]
    assert next(each["value"] for each in findings if each["what"].endswith("position")) == pytest.approx(17.3, abs=0.1)


def _rounded(numbers):
    """To ten bits, as TensorFloat-32."""
    bits = numbers.contiguous().view(torch.int32)
    return ((bits + 0x1000) & ~0x1FFF).view(torch.float32)


def test_the_tolerances_are_ten_times_what_rounded_convolutions_make_of_samples(rough_light, tmp_path, monkeypatch):
    run, convolve, engines = torch_engine.TorchEngine.run, torch.nn.Conv2d._conv_forward, []

    def rounded_on_device(self, image, noise):
        engines.append(self) if self not in engines else None
        with monkeypatch.context() as patch:
            if engines.index(self) % 2:  # the reference comes first
                patch.setattr(
                    torch.nn.Conv2d,
                    "_conv_forward",
                    lambda self, pixels, weight, bias: convolve(self, _rounded(pixels), _rounded(weight), bias),
                )
            return run(self, image, noise)

    monkeypatch.setattr(torch_engine.TorchEngine, "run", rounded_on_device)
    monkeypatch.setattr(parity, "_ON_PROCESSORS", (parity._Way("rounded", parity.TF32),))
    found = list(parity.compare_networks(Setting("cpu", TINY, tmp_path), Deadline(1000.0)))
    rounded = [each for each in found if ", rounded: " in each.what]
    assert len(rounded) == 6  # of two networks: positions, rotations, densities
    assert all(each.most is not None and 0.0 < each.value < 0.1 * each.most for each in rounded)


def test_deviations_are_of_95_percent_of_the_samples_and_small_rotations_are_seen():
    rng = np.random.default_rng(0)
    samples = Poses.exp(rng.standard_normal((1000, 6)))
    moved = samples @ Poses.exp(np.array([0, 0, 0.003, 0, np.radians(0.004), 0]))
    far = moved.translation.copy()
    far[:30] += 1.0

    def float32(poses, translation):
        return translation.astype(np.float32), poses.rotation.astype(np.float32)

    position, rotation = sample_deviation(
        "x", float32(moved, far), float32(samples, samples.translation), Tolerance(0.0029, 0.0041, 1.0)
    )
    assert position.value == pytest.approx(3.0, abs=0.01)
    assert rotation.value == pytest.approx(0.004, abs=1e-4)
    assert (position.passes, rotation.passes) == (False, True)


def test_other_statuses_and_poses_of_converged_images_fail_a_run(tmp_path, monkeypatch):
    (tmp_path / "walk.mcap").touch()

    def record(statuses, offset_m):
        at = np.array([[0.0, 0, 0], [0.0, offset_m, 0], [offset_m, 0, 0]])
        trajectory = Trajectory(np.arange(3), Poses(np.tile(np.eye(3), (3, 1, 1)), at))
        return SimpleNamespace(status=statuses, methods={"filter": trajectory, "smoothed": trajectory})

    runs = iter(
        [
            record([], 0),
            record(("ambiguous", "converged", "lost"), 0),
            record(("ambiguous", "converged", "converged"), 0.5),
        ]
    )
    monkeypatch.setattr(tracking, "_run", lambda *_, **__: (next(runs), 1.0))
    found = {f.what: f for f in tracking.compare_runs(Setting("cpu", TINY, tmp_path), Deadline(9.0))}
    assert found["cpu, float32: other statuses"].value == 1
    assert not found["cpu, float32: other statuses"].passes
    assert "of 1 images" in found["cpu, float32: filter, positions"].note
    assert found["cpu, float32: filter, positions"].value == pytest.approx(500.0)
    assert not found["cpu, float32: smoothed, positions"].passes
    assert found["cpu, float32: filter, rotations"].passes


class _Clock:
    def __init__(self):
        self.now_s = 0.0

    def __call__(self):
        return self.now_s


def _working(clock, seconds, count):
    def work(deadline):
        for number in range(count):
            clock.now_s += seconds
            deadline.check()
            yield Finding(str(number), 1.0, "s")

    return work


def _failing(deadline):
    yield Finding("before", 1.0, "s")
    raise ValueError("broken\nand more")


def test_a_stage_that_fails_keeps_its_figures_and_the_others_go_on():
    clock = _Clock()
    results = carry_out([Stage("a", 1.0, _failing), Stage("b", 1.0, _working(clock, 1.0, 3))], Deadline(100.0, clock))
    assert [(r.stage, r.outcome, len(r.findings)) for r in results] == [("a", "failed", 1), ("b", "done", 3)]
    assert results[0].reason == "ValueError: broken"
    assert results[1].seconds == 3.0


def test_a_stage_gets_its_share_and_what_earlier_ones_left_and_the_whole_never_takes_longer():
    clock = _Clock()
    stages = [
        Stage("short", 1.0, _working(clock, 2.0, 1)),
        Stage("long", 1.0, _working(clock, 3.0, 100)),
        Stage("last", 2.0, _working(clock, 7.0, 100)),
    ]
    results = carry_out(stages, Deadline(40.0, clock))
    assert [r.outcome for r in results] == ["done", "out of time", "out of time"]
    assert [len(r.findings) for r in results] == [1, 5, 2]  # 20 s for the first two, 2 of them used; then 40
    assert "18 s were over after 5 figures" in results[1].reason
    assert clock.now_s == 41.0


def test_a_stage_without_any_time_is_left_out_and_said():
    clock = _Clock()
    whole = Deadline(1.0, clock)
    clock.now_s = 2.0
    (result,) = carry_out([Stage("a", 1.0, _failing)], whole)
    assert (result.outcome, result.findings) == ("out of time", [])


def test_every_figure_is_reported_when_it_is_known():
    seen = []
    carry_out(
        [Stage("a", 1.0, _failing)],
        Deadline(9.0),
        lambda results: seen.append((results[-1].outcome, len(results[-1].findings))),
    )
    assert seen == [("under way", 0), ("under way", 1), ("failed", 1)]


def test_a_figure_that_is_no_number_does_not_pass():
    assert Finding("x", math.nan, "mm", most=1.0).passes is False
    assert Finding("x", math.nan, "mm").passes is None


def test_work_that_hangs_is_ended_with_the_process():
    words = "import time; from vapor.benchmark.commands.gpu import _ended_after\nwith _ended_after(0.3): time.sleep(60)"
    ended = subprocess.run([sys.executable, "-c", words], capture_output=True, text=True, timeout=50, check=False)
    assert ended.returncode == 1
    assert "Timeout" in ended.stderr


def test_times_are_of_fewer_repetitions_where_time_is_short_and_of_none_where_hardly_any_fits():
    assert "3 times" in timed("x", lambda: None, CPU, Deadline(9.0), repetitions=3).note
    clock = _Clock()

    def second():
        clock.now_s += 1.0

    found = timed("x", second, CPU, Deadline(15.5, clock), repetitions=100)
    assert "11 times" in found.note  # after five that do not count
    with pytest.raises(OutOfTime):
        timed("x", second, CPU, Deadline(8.5, clock), repetitions=100)


@pytest.mark.parametrize("count", [2, 40])
def test_matches_by_torch_are_those_of_the_library(count):
    rng = np.random.default_rng(count)
    known = stored(unit_vectors(rng.standard_normal((100, 64)).astype(np.float32)))
    points = np.stack([rng.permutation(100)[:count] for _ in range(3)])
    images = unit_vectors(rng.standard_normal((2 * 30, 64)).astype(np.float32)).reshape(2, 30, 64)
    images[0, :20] = unit_vectors(restored(known[rng.permutation(100)[:20]]) + 0.3 * images[0, :20])
    found = matched(torch.from_numpy(images), torch.from_numpy(known), torch.from_numpy(points), 0.9).numpy()
    matches = 0
    for i, p in np.ndindex(2, 3):
        features, landmarks = mutual_matches(images[i], restored(known[points[p]]), 0.9)
        expected = np.full(30, -1)
        expected[features] = landmarks
        np.testing.assert_array_equal(found[i, p], expected)
        matches += len(features)
    assert matches


def _recalls(monkeypatch, tmp_path, **courses):
    monkeypatch.setattr(training, "_course", lambda config, *_: courses[config.precision])
    setting, images = Setting("cuda", TINY, tmp_path), range(10)
    rates = {("cuda", "float32"): 1000.0, ("cpu", "float32"): 5.0}
    return list(training._time_to_recall(setting, images, images, rates, Deadline(100.0)))


def test_the_time_to_equal_recall_is_when_each_reaches_what_both_reach(monkeypatch, tmp_path, unchecked):
    found = _recalls(
        monkeypatch,
        tmp_path,
        float32=[Reached(1.0, 10, 0.1), Reached(2.0, 20, 0.3)],
        bfloat16=[Reached(0.5, 10, 0.35), Reached(1.0, 20, 0.2)],
    )
    assert [f.value for f in found] == [30.0, 35.0, 2.0, 0.5]
    assert "20 images" in found[2].note
    assert "on the processor, by its images a second, 4 s" in found[2].note


def test_where_nothing_is_recalled_no_time_is_stated(monkeypatch, tmp_path, unchecked):
    found = _recalls(monkeypatch, tmp_path, float32=[Reached(2.0, 20, 0.0)], bfloat16=[Reached(0.5, 10, 0.35)])
    assert [f.unit for f in found] == ["%", "%"]


def test_convolutions_round_as_before_after_a_comparison():
    before = torch.backends.cudnn.allow_tf32
    with parity.convolutions(tf32=not before):
        assert torch.backends.cudnn.allow_tf32 is not before
    assert torch.backends.cudnn.allow_tf32 is before
