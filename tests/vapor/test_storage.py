"""Files under URLs, worked on as copies: `memory://` is the storage, and other cache folders are other machines."""

import json
import os
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import fsspec
import pytest

from tests.helpers.command_line import main
from tests.helpers.full import full
from tests.helpers.tiny_model import SMALL
from tests.helpers.tiny_training import TINY_TRAIN
from vapor.benchmark.recordings import record as record_module
from vapor.benchmark.regressors import training_runs as runs_module
from vapor.benchmark.regressors.table import TableConfig, TableExperiment, parse_scene
from vapor.benchmark.regressors.training_runs import _render, render_scenes
from vapor.benchmark.trials import replay as run_module
from vapor.parallel.jobs import Workers
from vapor.storage import StorageError, absent, fetched, listed, local_path, published, url_of, withdrawn
from vapor.training import state as state_module
from vapor.training.state import state_path

Machine = Callable[[str], None]


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Machine:
    """Go to another machine, by its name; storage is empty at first."""
    memory = fsspec.filesystem("memory")
    memory.rm("/", recursive=True) if memory.ls("/") else None

    def go(name: str) -> None:
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "machines" / name))

    go("one")
    return go


@pytest.mark.parametrize("url", ["s3://bucket/a/b.mcap", "memory://x", "file:///tmp/x", "gs://bucket/a@b c"])
def test_a_url_and_the_path_of_its_copy_stand_for_each_other(url, machine):
    assert url_of(local_path(url)) == url
    assert url_of(Path("/tmp/x")) is None


@pytest.mark.parametrize("url", ["s3://", "s3://bucket/../x", "s3://bucket//x", "zip://x::s3://bucket/y"])
def test_urls_that_lead_elsewhere_are_refused(url):
    with pytest.raises(StorageError, match="expected a URL such as"):
        local_path(url)


def test_what_is_published_on_one_machine_is_fetched_on_another_as_it_is_now(machine):
    folder = local_path("memory://shared/results")
    folder.mkdir(parents=True)
    (folder / "a.json").write_text("1")
    (folder / "b.json").write_text("2")
    published(folder)
    times = [file.stat().st_mtime_ns for file in (folder / "a.json", folder / "b.json")]

    machine("two")
    copy = fetched(local_path("memory://shared/results"))
    assert copy != folder
    assert [file.read_text() for file in listed(copy)] == ["1", "2"]
    assert [file.stat().st_mtime_ns for file in listed(copy)] == times  # the same version, so of the same identity
    (copy / "a.json").write_text("changed")
    published(copy / "a.json")
    withdrawn(copy / "b.json")

    machine("one")
    assert absent([folder / "a.json", folder / "b.json"], folder) == {folder / "b.json"}
    assert fetched(folder) == folder
    assert {file.name: file.read_text() for file in folder.iterdir()} == {"a.json": "changed"}
    assert not fetched(local_path("memory://nowhere")).exists()


def test_storage_that_cannot_be_used_is_told_in_one_line(machine, capsys):
    with pytest.raises(StorageError, match=r"nofiles://bucket/x, with its copy at .*: Protocol not known: nofiles"):
        fetched(local_path("nofiles://bucket/x"))
    assert main(["run", "nofiles://bucket/x.mcap", "--model", "ceiling", "--output", "out"]) == 1
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "Protocol not known" in err
    with pytest.raises(SystemExit):
        main(["run", "x.mcap", "--model", "ceiling", "--output", "s3://bucket/out"])
    assert "only vapor-benchmark writes to URLs" in capsys.readouterr().err


@full
@pytest.mark.usefixtures("unchecked")
def test_a_benchmark_under_a_url_goes_on_from_any_machine(machine, tiny_model, monkeypatch, capsys):
    fsspec.filesystem("memory").put(str(tiny_model), "/models/tiny.safetensors")
    words = ["vapor-benchmark", "localization", "ceiling", "--models", "memory://models/tiny.safetensors", "--output"]
    words += ["memory://bench", "--kinds", "no-cue", "--runs", "1", "--frames", "50", "--width", "32"]
    words += ["--height", "24", "--workers", "1", "--num-samples", "40", "--localizer.max-hypotheses", "30"]
    assert main(words) == 0
    names = {Path(name).name for name in fsspec.filesystem("memory").find("/bench")}
    assert {"summary.json", "manifest.json", "settings.json", "samples.npy", "path.npz"} < names
    summary = fsspec.filesystem("memory").cat("/bench/summary.json")

    machine("two")
    with monkeypatch.context() as patch:
        patch.setattr(run_module, "localize", lambda *_: pytest.fail("localized again"))
        assert main(words) == 0
    assert fsspec.filesystem("memory").cat("/bench/summary.json") == summary
    monkeypatch.setattr(record_module, "record_synthetic", lambda *_: pytest.fail("recorded again"))
    assert main([*words, "--localizer.switch-ratio", "2"]) == 0  # which needs the recording
    capsys.readouterr()

    fsspec.filesystem("memory").pipe("/other/notes.txt", b"mine")
    assert main([*words[:6], "memory://other", *words[7:]]) == 1
    assert "memory://other: holds notes.txt, expected an empty folder" in capsys.readouterr().err


@pytest.mark.usefixtures("unchecked")
def test_a_walk_is_rendered_on_a_machine_that_has_no_copy_of_anything(machine):
    names = {"train_walks": 1, "train_frames": 8, "test_walks": 0, "test_frames": 8, "height": 24}
    steps = render_scenes(["dinner-table"], local_path("memory://new"), workers=Workers(1), **names)
    _, _, (scene,) = next(steps)
    (walk,) = scene.anywhere.train
    assert walk.startswith("memory://new/images/dinner-table-train-0-8-32x24")
    machine("two")
    _render(local_path(walk), "dinner-table", "train", 0, 8, (32, 24))
    assert len(listed(local_path("memory://new"))) == 1


@full
@pytest.mark.usefixtures("unchecked")
def test_a_training_that_was_killed_goes_on_on_another_machine_to_the_same_result(machine, tmp_path, monkeypatch):
    config = TableConfig(
        ("variational",),
        1,
        sequences=1,
        frames=32,
        test_sequences=1,
        test_frames=6,
        num_samples=20,
        train=replace(TINY_TRAIN, epochs=2),
    )

    def results(directory: Path) -> list[dict]:
        experiment = TableExperiment([parse_scene("dinner-table")], directory, config, Workers(1))
        list(experiment.render())
        return [result | {"seconds": None} for result in experiment.train()]

    whole = results(tmp_path / "local")
    (model,) = (tmp_path / "local" / "runs").glob("*.safetensors")  # and no state of a training
    fsspec.filesystem("memory").put(str(tmp_path / "local" / "images"), "/table/images", recursive=True)
    epochs, save = [], state_module.save_state

    def killed(path: Path, *state: object) -> None:
        save(path, *state)  # pyright: ignore[reportArgumentType]
        epochs.append(path)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(state_module, "save_state", killed)
        with pytest.raises(KeyboardInterrupt):
            results(local_path("memory://table"))
    machine("two")
    monkeypatch.setattr(state_module, "save_state", lambda *state: save(*state) or epochs.append(state[0]))
    trains = runs_module.train_on_images

    def resuming(images: object, names: object, model: Path, *rest: object) -> object:
        assert state_path(model).is_file()
        return trains(images, names, model, *rest)  # pyright: ignore[reportArgumentType]

    monkeypatch.setattr(runs_module, "train_on_images", resuming)
    assert results(local_path("memory://table")) == whole
    assert len(epochs) == 2  # one on each machine
    (there,) = (name for name in fsspec.filesystem("memory").find("/table") if name.endswith(".safetensors"))
    assert ".training." not in there + model.name


def test_sequences_under_urls_are_found_and_localized(machine, walk_of_25, tiny_model, tmp_path, plain_results):
    memory = fsspec.filesystem("memory")
    for name in ("a.mcap", "deeper/b.mcap"):
        memory.put(str(walk_of_25), f"/walks/{name}")
    memory.pipe("/walks/old/estimate.mcap", b"")
    memory.pipe("/walks/old/report.json", b"")
    words = ["--model", str(tiny_model), *SMALL, "--no-recording", "--duration-s", "0.5"]
    assert main(["run", "memory://walks", "--output", str(tmp_path / "many"), *words]) == 0
    summary = json.loads((tmp_path / "many" / "summary.json").read_text())
    assert [each["sequence"] for each in summary["sequences"]] == [
        "memory://walks/a.mcap",
        "memory://walks/deeper/b.mcap",
    ]
    assert main(["run", "memory://walks/a.mcap", "--output", str(tmp_path / "one"), *words]) == 0
    many, one = ((tmp_path / at / "trajectory.tum").read_bytes() for at in ("many/a", "one"))
    assert many == one
    assert os.listdir(tmp_path / "many" / "b")


def test_where_fsspec_is_missing_one_is_told_how_to_install_it(machine, monkeypatch):
    monkeypatch.setitem(sys.modules, "fsspec.core", None)
    with pytest.raises(
        StorageError, match=r"memory://a/b\.mcap: URLs need fsspec: pip install 'vapor-track\[cluster\]'"
    ):
        fetched(local_path("memory://a/b.mcap"))
