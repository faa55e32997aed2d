"""Several sequences in one call of `vapor-track run`: which are found, what each leaves, and what is said of them."""

import json
import os
import shutil
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from sequences.options import SequenceOptions
from tests.helpers.command_line import contents
from tests.helpers.data_sets import make_7scenes, make_cambridge, make_tum
from tests.helpers.dot_scene import make_stray
from tests.helpers.sequence_files import BEGIN_NS, Walk, as_split_folder, rewrite
from tests.helpers.tiny_model import SMALL
from vapor.pipeline import batch as batch_module
from vapor.pipeline import model as model_module
from vapor.pipeline.batch import find_sequences, is_batch
from vapor.pipeline.config import RunConfig
from vapor.pipeline.model import load_model
from vapor.pipeline.run import request_of
from vapor.track import main


def run(sequences: list[Path], model: Path, output: Path, *words: str) -> int:
    paths = [str(path) for path in sequences]
    return main(["run", *paths, "--model", str(model), "--output", str(output), *SMALL, "--no-recording", *words])


def refused(*arguments) -> bool:
    with pytest.raises(SystemExit) as ended:
        run(*arguments)
    return ended.value.code == 2


def summary_of(output: Path) -> dict:
    return json.loads((output / "summary.json").read_text())


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def touch(folder: Path, *names: str) -> None:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(b"")


# --- which sequences -----------------------------------------------------------------------------------


def test_a_folder_stands_for_all_recordings_in_it_but_not_for_parts_and_results(tmp_path):
    bags = tmp_path / "bags"
    touch(bags, "b.mcap", "a.mcap", "notes.txt", "monday/bag/metadata.yaml", "monday/bag/bag_0.mcap", ".trash/c.mcap")
    touch(bags, "old/estimate.mcap", "old/report.json", "results/a/estimate.mcap", "demo/sequence.mcap")
    touch(bags, "demo/report.json", "demo/estimate.mcap", "other/estimate.mcap")
    found = find_sequences([bags], bags / "results")
    assert {name: str(path.relative_to(bags)) for name, path in found.items()} == {
        "a": "a.mcap",
        "b": "b.mcap",
        "sequence": "demo/sequence.mcap",
        "bag": "monday/bag",
        "estimate": "other/estimate.mcap",
    }
    assert list(found) == ["a", "b", "sequence", "bag", "estimate"]
    assert is_batch([bags])
    assert is_batch([bags / "results"])  # of one recording, so that results lie alike tomorrow
    assert not is_batch([bags / "monday" / "bag"])
    assert not is_batch([bags / "a.mcap"])
    assert not is_batch([tmp_path / "absent"])


def test_a_data_set_is_one_sequence(tmp_path):
    scene = make_7scenes(tmp_path / "scene", num_images=1)
    assert not is_batch([scene])
    touch(tmp_path, "a.mcap")
    assert list(find_sequences([scene, tmp_path / "a.mcap"], tmp_path / "out")) == ["scene", "a"]


def test_a_folder_stands_for_the_data_sets_in_it_and_a_scene_for_its_sequences(tmp_path):
    make_7scenes(tmp_path / "all" / "scene", num_images=1, sequences=("seq-01", "seq-02"))
    make_tum(tmp_path / "all" / "desk", num_images=2)
    scene = tmp_path / "all" / "scene"
    assert set(find_sequences([tmp_path / "all"], tmp_path / "out")) == {"desk", "seq-01", "seq-02"}
    assert find_sequences([scene], tmp_path / "out") == {name: scene / name for name in ("seq-01", "seq-02")}
    assert is_batch([scene])
    touch(scene, "walk.mcap")  # recordings are asked for first
    assert "walk" in find_sequences([scene], tmp_path / "out")


def test_a_part_of_a_folder_is_named_by_it_also_with_a_slash_between(tmp_path):
    paths = [Path(f"{make_tum(tmp_path / name)}/@0:2") for name in ("desk", "hall")]
    assert find_sequences(paths, tmp_path / "out") == {
        "desk@0:2": tmp_path / "desk@0:2",
        "hall@0:2": tmp_path / "hall@0:2",
    }


@pytest.mark.parametrize("stray", ["poses.txt", "transforms.json"])
def test_a_stray_file_named_like_one_of_a_data_set_does_not_hide_recordings(stray, tmp_path):
    touch(tmp_path / "rec", "a/walk.mcap", "b/phone.mp4", "hall.mp4", stray)
    assert set(find_sequences([tmp_path / "rec"], tmp_path / "out")) == {"walk", "phone", "hall"}


def test_a_damaged_data_set_is_a_sequence_that_fails_in_its_row(tmp_path):
    scan, desk = make_stray(tmp_path / "all" / "scan"), make_tum(tmp_path / "all" / "desk", num_images=2)
    (scan / "odometry.csv").write_text("nothing of use\n")
    (desk / "rgb.txt").write_text("nothing of use\n")
    assert not is_batch([scan])
    assert not is_batch([desk])
    assert find_sequences([tmp_path / "all"], tmp_path / "out") == {"desk": desk, "scan": scan}


def test_a_scene_of_cambridge_landmarks_stands_for_its_sequences(tmp_path):
    scene = make_cambridge(tmp_path / "scene")
    assert set(find_sequences([scene], tmp_path / "out").values()) == {scene / f"seq{number}" for number in (1, 2, 10)}


def test_names_are_unique_and_as_short_as_they_can_be(tmp_path):
    touch(tmp_path, "r1/mon/walk.mcap", "r1/tue/walk.mcap", "r2/mon/walk.mcap", "r2/mon/other.mcap", "x/Other2.mcap")
    touch(tmp_path, "x/y/other2.mcap", "z/summary.json.mcap")
    assert set(find_sequences([tmp_path], tmp_path / "out")) == {
        *("r1-mon-walk", "tue-walk", "r2-mon-walk", "other", "x-Other2", "y-other2", "z-summary.json")
    }


def test_what_is_named_twice_is_localized_once_and_twins_are_numbered(tmp_path):
    touch(tmp_path, "bags/a.mcap", "bags/b.mcap", "bags/a/metadata.yaml")
    found = find_sequences([tmp_path / "bags" / "b.mcap", tmp_path / "bags"], tmp_path / "out")
    assert next(iter(found)) == "b"
    assert len(found) == 3
    assert len(set(found)) == 3
    assert sorted(name[-4:] for name in found if name != "b") == ["-a-1", "-a-2"]


# --- what comes of them --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two recordings, one of them without true poses, and two files that are none."""
    folder = tmp_path_factory.mktemp("bags")
    (folder / "kitchen").mkdir()
    Walk(8).write(folder / "kitchen" / "walk.mcap")
    source = Walk(6).write(folder.parent / "hall.mcap")
    as_split_folder(
        rewrite(source, folder.parent / "blind.mcap", keep=lambda topic, _: topic != "/ground_truth/pose"), folder
    )
    (folder / "broken.mcap").write_bytes(b"not a recording at all")
    return folder


@pytest.mark.usefixtures("unchecked", "plain_results")
def test_a_batch_gives_each_sequence_what_it_gets_alone_and_one_summary(
    bags, tiny_model, tmp_path, capsys, monkeypatch
):
    loads: list[str] = []
    load = model_module.find_model
    monkeypatch.setattr(model_module, "find_model", lambda name: loads.append(name) or load(name))
    monkeypatch.setenv("COLUMNS", "100")  # as its table needs
    out = tmp_path / "results"
    assert run([bags], tiny_model, out) == 1
    assert len(loads) == 1
    printed = capsys.readouterr()
    assert printed.err.splitlines()[-1] == "vapor-track run: 1 of 3 sequences failed: broken"
    assert "broken: failed:" in printed.out
    assert "expected the MCAP magic" in printed.out
    rows = {line.split()[1]: line for line in printed.out.splitlines() if line.startswith("│")}
    assert set(rows) == {"bag", "broken", "walk"}
    assert " failed " in rows["broken"]
    assert " 8 " in rows["walk"]
    assert "°" in rows["walk"]
    assert "°" not in rows["bag"]
    assert "3 sequences, 14 images" in printed.out
    assert names(out) == {"bag", "walk", "summary.json", "summary.html"}

    summary = summary_of(out)
    assert (summary["model"], summary["sequences_done"], summary["sequences_in_all"]) == ("tiny.safetensors", 3, 3)
    by_name = {row["name"]: row for row in summary["sequences"]}
    assert {name: row["error"] is None for name, row in by_name.items()} == {"bag": True, "broken": False, "walk": True}
    report = json.loads((out / "walk" / "report.json").read_text())
    assert by_name["walk"]["median_translation_m"] == report["filter"]["median_translation_m"]
    assert by_name["walk"]["status"] == report["status"]
    assert by_name["walk"]["success"] == report["filter"]["success"]
    assert by_name["walk"]["states"].keys() <= {"right", "wrong", "ambiguous", "lost"}
    assert sum(by_name["walk"]["states"].values()) == pytest.approx(1.0)
    truth = np.loadtxt(out / "walk" / "ground_truth.tum")[:, 1:4]
    np.testing.assert_allclose(by_name["walk"]["visited"]["positions_m"], truth, atol=0.0051)
    assert by_name["walk"]["visited"]["are_true"]
    estimate = np.loadtxt(out / "bag" / "trajectory.tum")[:, 1:4]
    np.testing.assert_allclose(by_name["bag"]["visited"]["positions_m"], estimate, atol=0.0051)
    assert not by_name["bag"]["visited"]["are_true"]
    page = (out / "summary.html").read_text()
    assert 'href="walk/report.html"' in page
    assert "expected the MCAP magic" in page
    assert by_name["bag"]["median_translation_m"] is None
    assert by_name["bag"]["final_status"] in ("converged", "ambiguous", "lost")
    assert (summary["total"]["failed"], summary["total"]["images"], summary["total"]["judged"]) == (1, 14, 1)

    assert run([bags / "bag"], tiny_model, tmp_path / "alone") == 0
    assert names(tmp_path / "alone") == names(out / "bag")
    for name in ("trajectory.tum", "smoothed.tum", "config.json", "estimate.mcap"):
        assert (tmp_path / "alone" / name).read_bytes() == (out / "bag" / name).read_bytes()


@pytest.mark.usefixtures("unchecked", "plain_results")
def test_an_interrupted_batch_keeps_what_was_finished_whole(bags, tiny_model, tmp_path, capsys, monkeypatch):
    real, out = batch_module.run, tmp_path / "out"

    def interrupted(sequence, model, output, config, *, progress, **options):
        def stop(done: int, of: int) -> None:
            progress(done, of)
            if sequence.name == "walk.mcap" and done == 3:
                raise KeyboardInterrupt

        return real(sequence, model, output, config, progress=stop, **options)

    monkeypatch.setattr(batch_module, "run", interrupted)
    assert run([bags / "bag", bags / "kitchen"], tiny_model, out) == 130
    printed = capsys.readouterr()
    assert printed.err.splitlines()[-1] == "vapor-track run: interrupted"
    assert "1 sequence, 6 images" in printed.out
    assert names(out) == {"bag", "summary.json", "summary.html"}
    assert "1 of 2 recordings are not done" in (out / "summary.html").read_text()
    assert (out / "bag" / "report.json").is_file()
    summary = summary_of(out)
    assert (summary["sequences_done"], summary["sequences_in_all"]) == (1, 2)


def test_a_model_that_cannot_be_used_is_said_once_and_nothing_is_written(bags, tmp_path, capsys):
    assert run([bags], tmp_path / "none.safetensors", tmp_path / "out") == 1
    printed = capsys.readouterr()
    assert "no such model file" in printed.err
    assert printed.out == ""
    assert not (tmp_path / "out").exists()


def test_folders_without_a_recording_and_absent_files_fail_each_in_its_row(tiny_model, tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    assert run([tmp_path / "empty", tmp_path / "gone.mcap"], tiny_model, tmp_path / "out") == 1
    printed = capsys.readouterr()
    assert "empty: no sequence or data set; looked for a video, PNG or JPEG images, .mcap" in printed.out
    assert "gone.mcap: no such file or folder" in printed.out
    assert printed.err.endswith("2 of 2 sequences failed: empty, gone\n")


@pytest.mark.usefixtures("unchecked", "plain_results")
def test_a_sequence_that_used_hardly_any_of_its_images_fails_unless_it_may(tiny_model, tmp_path, capsys):
    bags = tmp_path / "bags"
    bags.mkdir()
    walk = Walk(30)
    walk.odometry = [(t, pose) for t, pose in walk.odometry if t < BEGIN_NS + 150_000_000]
    walk.write(bags / "attic.mcap")
    Walk(6).write(bags / "hall.mcap")
    assert run([bags], tiny_model, tmp_path / "out") == 1
    printed = capsys.readouterr()
    assert "attic.mcap: Only 2 of 30 images were used: 28 were skipped: after odometry ends. Exp" in printed.out
    assert printed.err.splitlines()[-1] == "vapor-track run: 1 of 2 sequences failed: attic"
    assert names(tmp_path / "out") == {"hall", "summary.json", "summary.html"}
    assert run([bags], tiny_model, tmp_path / "out", "--allow-few-images") == 0
    last = "Fewer than half of the images were used in 1 of 2 sequences: attic."
    assert capsys.readouterr().out.splitlines()[-1] == last
    assert {row["name"]: row["images"] for row in summary_of(tmp_path / "out")["sequences"]} == {"attic": 2, "hall": 6}


@pytest.mark.usefixtures("unchecked", "plain_results")
def test_results_of_one_sequence_and_of_several_share_no_folder(bags, tiny_model, tmp_path, capsys):
    one, several = [bags / "bag"], [bags / "bag", bags / "broken.mcap"]
    assert run(one, tiny_model, tmp_path / "one") == 0
    assert run(several, tiny_model, tmp_path / "several") == 1
    for folder, sequences in ((tmp_path / "one", several), (tmp_path / "several", one)):
        before = contents(folder)
        capsys.readouterr()
        assert run(sequences, tiny_model, folder) == 1
        said = capsys.readouterr().err
        assert f"{folder}: holds " in said
        assert "expected an empty folder or" in said
        assert contents(folder) == before
    assert run(several, tiny_model, tmp_path / "one", "--overwrite") == 1
    assert (tmp_path / "one" / "summary.html").is_file()


# --- goes on -------------------------------------------------------------------------------------------


@pytest.fixture
def runs(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the sequences that are localized."""
    found: list[str] = []
    real = batch_module.run
    monkeypatch.setattr(
        batch_module,
        "run",
        lambda sequence, *rest, **options: found.append(sequence.stem) or real(sequence, *rest, **options),
    )
    return found


@pytest.mark.usefixtures("unchecked", "plain_results")
def test_resume_keeps_complete_results_and_localizes_the_rest(bags, tiny_model, tmp_path, runs, capsys):
    out = tmp_path / "out"
    assert run([bags / "bag"], tiny_model, out / "bag") == 0  # as a task of a job array does
    assert run([bags], tiny_model, out, "--resume") == 1
    assert runs == ["broken", "walk"]
    first = summary_of(out)
    assert {row["name"]: row["images"] for row in first["sequences"]} == {"bag": 6, "broken": 0, "walk": 8}
    assert run([bags], tiny_model, out, "--resume") == 1
    assert runs == ["broken", "walk", "broken"]
    assert summary_of(out) == first
    assert run([bags], tiny_model, out, "--resume", "--seed", "1") == 1  # other settings
    assert runs[3:] == ["bag", "broken", "walk"]
    (out / "walk" / "trajectory.tum").unlink()
    assert run([bags], tiny_model, out, "--resume", "--seed", "1") == 1
    assert runs[6:] == ["broken", "walk"]
    assert run([bags], tiny_model, out) == 1
    assert runs[8:] == ["bag", "broken", "walk"]
    capsys.readouterr()
    assert refused([bags / "bag"], tiny_model, tmp_path / "alone", "--resume")
    assert capsys.readouterr().err.startswith("vapor-track run: --resume with one sequence, expected several")


@pytest.mark.usefixtures("unchecked", "plain_results")
def test_resume_keeps_nothing_incomplete_nor_of_other_content(bags, tiny_model, tmp_path, runs):
    recordings, out = tmp_path / "recordings", tmp_path / "out"
    shutil.copytree(bags / "bag", recordings / "bag")
    recording = Walk(8).write(recordings / "walk.mcap", {"day": "1"})
    size = recording.stat().st_size

    def localized() -> list[str]:
        runs.clear()
        run([recordings], tiny_model, out, "--resume", "--overwrite")
        return [*runs]

    assert localized() == ["bag", "walk"]
    assert localized() == []
    (out / "walk" / "report.html").unlink()
    assert localized() == ["walk"]
    (out / "walk" / "manifest.json").unlink()
    (out / "walk" / "smoothed.tum").unlink()
    assert localized() == ["walk"]
    assert (out / "walk" / "smoothed.tum").is_file()
    Walk(8).write(recording, {"day": "2"})
    assert recording.stat().st_size == size
    assert localized() == ["walk"]


def test_a_request_has_the_content_of_a_file_of_poses(bags, tiny_model, tmp_path):
    config = RunConfig()
    model, poses = load_model(str(tiny_model), config), tmp_path / "poses.tum"

    def request() -> str:
        return request_of(bags / "kitchen" / "walk.mcap", model, config, SequenceOptions(poses=poses))

    poses.write_text("0 0 0 0 0 0 0 1\n")
    first = request()
    assert request() == first
    poses.write_text("0 0 0 1 0 0 0 1\n")
    assert request() != first


# --- on a Dask scheduler ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def scheduler():
    """The address of a Dask scheduler whose worker is this process."""
    distributed = pytest.importorskip("distributed", reason="distributed is not installed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None
    ) as cluster:
        yield cluster.scheduler_address


@pytest.mark.usefixtures("unchecked", "plain_results")
def test_workers_of_a_scheduler_give_what_this_process_gives(bags, tiny_model, tmp_path, monkeypatch, scheduler):
    assert run([bags], tiny_model, tmp_path / "here") == 1
    monkeypatch.chdir(bags.parent)
    assert run([Path(bags.name)], tiny_model, tmp_path / "there", "--dask", scheduler) == 1
    here, there = summary_of(tmp_path / "here"), summary_of(tmp_path / "there")
    assert [row.pop("sequence") for row in there["sequences"]] == [
        os.path.relpath(row.pop("sequence")) for row in here["sequences"]
    ]
    assert here == there
    assert names(tmp_path / "here") == names(tmp_path / "there")
    for name in ("trajectory.tum", "smoothed.tum", "status.csv"):
        assert (tmp_path / "here" / "bag" / name).read_bytes() == (tmp_path / "there" / "bag" / name).read_bytes()


def test_a_worker_that_does_not_see_the_files_or_cannot_write_is_named(
    bags, tiny_model, tmp_path, monkeypatch, capsys, scheduler
):
    @contextmanager
    def elsewhere(place, name):
        yield tmp_path / "on" / "another" / "disk"

    monkeypatch.setattr(batch_module, "workspace", elsewhere)
    assert run([bags], tiny_model, tmp_path / "out", "--dask", scheduler) == 1
    said = capsys.readouterr().err
    assert "another/disk: is not there on " in said
    assert "expected a file system that all machines share, with the same paths" in said
    monkeypatch.undo()
    monkeypatch.setattr(batch_module.os, "access", lambda *_: False)
    assert run([bags], tiny_model, tmp_path / "out", "--dask", scheduler) == 1
    assert "out: cannot write on " in capsys.readouterr().err


def test_a_recording_that_a_worker_does_not_see_ends_the_run_unless_it_was_not_there_before(
    bags, tiny_model, tmp_path, capsys, scheduler, monkeypatch
):
    gone, real = tmp_path / "gone.mcap", Path.exists
    assert run([gone, bags / "broken.mcap"], tiny_model, tmp_path / "out", "--dask", scheduler) == 1
    assert capsys.readouterr().err.endswith("2 of 2 sequences failed: gone, broken\n")
    asked: list[Path] = []

    def exists_here(path: Path, **options: bool) -> bool:
        asked.extend([path] if path.name == "walk.mcap" else [])
        return real(path, **options) and asked.count(path) < 2

    monkeypatch.setattr(Path, "exists", exists_here)
    walk = bags / "kitchen" / "walk.mcap"
    assert run([walk, bags / "broken.mcap"], tiny_model, tmp_path / "out", "--dask", scheduler) == 1
    assert f"{walk}: is not there on " in capsys.readouterr().err


@pytest.mark.usefixtures("unchecked", "plain_results")
def test_workers_find_a_file_of_poses_wherever_they_were_started(bags, tiny_model, tmp_path, monkeypatch, scheduler):
    assert run([bags / "kitchen" / "walk.mcap"], tiny_model, tmp_path / "alone") == 0
    (tmp_path / "alone" / "ground_truth.tum").rename(tmp_path / "poses.tum")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(batch_module, "_require_shared", lambda _: os.chdir("/"))  # as a worker starts elsewhere
    words = ["--dask", scheduler, "--poses", "poses.tum"]
    assert run([bags / "bag", bags / "broken.mcap"], tiny_model, tmp_path / "out", *words) == 1
    row, _ = summary_of(tmp_path / "out")["sequences"]
    assert (row["images"], row["images_with_true_pose"]) == (6, 6)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--dask", "tcp://h:1", "--workers", "2"], "--workers beside --dask, expected one of them"),
        (["--dask", "tcp://h:1", "--view"], "--view beside --dask"),
    ],
)
def test_options_that_do_not_go_together_are_refused(bags, tiny_model, tmp_path, capsys, words, expected):
    assert refused([bags], tiny_model, tmp_path / "out", *words)
    assert expected in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_one_sequence_needs_no_scheduler(bags, tiny_model, tmp_path, capsys):
    assert refused([bags / "bag"], tiny_model, tmp_path / "out", "--dask", "tcp://h:1")
    assert "--dask with one sequence, expected several, or a folder of them" in capsys.readouterr().err
