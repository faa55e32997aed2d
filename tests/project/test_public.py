import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

import vapor
from tests.helpers.command_line import words_of_run
from vapor.track import COMMANDS

HEAVY = {
    "torch",
    "gtsam",
    "rerun",
    "plotly",
    "embreex",
    "matplotlib",
    "pandas",
    "filterpy",
    "joblib",
    "openvino",
    "pycolmap",
    "av",
}
"""Packages that take tens of megabytes, or half a second: imported where they are used."""


def test_all_public_names_are_what_their_modules_define():
    assert sorted(vapor.__all__) == sorted(set(vapor.__all__)), "a name is listed twice"
    for name in vapor.__all__:
        value = getattr(vapor, name)
        assert getattr(value, "__name__", name) == name
        assert value.__doc__ or not callable(value), f"{name} is public and says nothing of itself"
        assert name in dir(vapor)


def test_type_checkers_see_the_same_names_as_python():
    source = Path(vapor.__file__).read_text(encoding="utf-8")
    seen = [line.split(" as ")[1].strip() for line in source.splitlines() if " as " in line and line.startswith("    ")]
    assert sorted(seen) == sorted(vapor.__all__)


def test_a_name_that_is_not_public_is_no_attribute():
    with pytest.raises(AttributeError, match="module 'vapor' has no attribute 'PartikelFilter'"):
        vapor.PartikelFilter  # noqa: B018


@pytest.mark.parametrize(
    ("code", "absent"),
    [
        ("import vapor", {"torch", "numpy", "scipy", "cv2", "gtsam", "rerun", "plotly", "embreex", "matplotlib"}),
        ("import vapor; vapor.ParticleLocalizer, vapor.SequenceReader", HEAVY),
        ("import vapor; vapor.VaporObservationModel, vapor.run, vapor.fuse", HEAVY),
        ("import vapor; vapor.live, vapor.LiveConfig", HEAVY | {"scipy.optimize", "scipy.stats"}),
        ("import vapor; vapor.Estimate, vapor.PosePosterior, vapor.StreamLocalizer", HEAVY),
        ("import vapor; vapor.read_run, vapor.read_tum, vapor.plot_trajectories", HEAVY),
        ("import vapor; vapor.TrainConfig, vapor.PRESETS", HEAVY),
        ("from filtering import storeys; storeys.peaks_of(storeys.np.arange(3.0), 1)", {"scipy.signal", "scipy.stats"}),
    ],
)
def test_importing_loads_only_the_needed_packages(code, absent):
    code = f"import sys; {code}; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not absent & {*done.stdout.split()}


def _loaded_by(words):
    code = (
        f"import atexit, sys; atexit.register(lambda: print(*sys.modules)); from vapor.track import main; main({words})"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return {*done.stdout.splitlines()[-1].split()}


@pytest.mark.parametrize("command", COMMANDS)
def test_help_loads_no_heavy_package(command):
    loaded = _loaded_by([command, "--help"])
    assert f"vapor.commands.{command}" in loaded
    assert not HEAVY & loaded


def test_a_run_without_a_recording_loads_what_it_uses_only(walk_of_25, tiny_model, tmp_path):
    loaded = _loaded_by(words_of_run(walk_of_25, tiny_model, tmp_path / "out", ["--engine", "torch"]))
    assert (tmp_path / "out" / "report.html").exists()
    network, smoothed_poses, kalman_baseline = "torch", "gtsam", "filterpy"
    assert HEAVY & loaded == {network, smoothed_poses, kalman_baseline}


def test_the_documentation_lists_the_public_names():
    page = (Path(vapor.__file__).parents[1] / "docs" / "api.md").read_text(encoding="utf-8")
    rows = [row for row in page.splitlines() if row.startswith("| `")]
    listed = [name for row in rows for name in re.findall(r"`(\w+)`", row.split("|")[1])]
    described = re.findall(r"^\.\. auto\w+:: vapor\.(\w+)$", page, re.MULTILINE)
    assert sorted(listed) == sorted(described) == sorted(vapor.__all__)


def test_files_may_be_named_by_strings(walk_of_25, tiny_model, tmp_path):
    result = vapor.run(str(walk_of_25), str(tiny_model), str(tmp_path / "out"))
    assert len(result.record.status) == 25
    stored = json.loads((tmp_path / "out" / "config.json").read_text())["run"]["localizer"]
    assert "converged_map_fraction" in stored
