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


def _modules(code):
    """Of a process that runs this, those that are loaded, by what it says they are loaded after."""
    code = f"import sys\nseen = lambda after: print(after, *sys.modules)\n{code}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    lines = [line.split() for line in done.stdout.splitlines()]
    return {line[0]: {*line[1:]} for line in lines if "sys" in line}


def test_importing_loads_only_the_needed_packages():
    loaded = _modules("""
import vapor; seen("package")
vapor.ParticleLocalizer, vapor.SequenceReader; seen("filter")
vapor.Estimate, vapor.PosePosterior, vapor.StreamLocalizer; seen("parts")
vapor.VaporObservationModel, vapor.run, vapor.fuse; seen("model")
vapor.read_run, vapor.read_tum, vapor.plot_trajectories; seen("results")
vapor.live, vapor.LiveConfig; seen("live")
vapor.TrainConfig, vapor.PRESETS; seen("training")
""")
    assert not {"numpy", "scipy", "cv2", *HEAVY} & loaded.pop("package")
    assert loaded.keys() == {"filter", "parts", "model", "results", "live", "training"}
    for after, modules in loaded.items():
        assert not HEAVY & modules, after


@pytest.mark.parametrize(
    ("code", "absent"),
    [
        ("import vapor; vapor.live, vapor.LiveConfig", {"scipy.optimize", "scipy.stats"}),
        ("from filtering import storeys; storeys.peaks_of(storeys.np.arange(3.0), 1)", {"scipy.signal", "scipy.stats"}),
    ],
)
def test_parts_of_scipy_are_loaded_where_they_are_used(code, absent):
    assert not absent & _modules(f"{code}; seen('it')")["it"]


def test_help_loads_no_heavy_package():
    loaded = _modules(f"""
from vapor.track import main
for command in {[*COMMANDS]}:
    try:
        main([command, "--help"])
    except SystemExit:
        pass
    seen(command)
""")
    assert loaded.keys() == COMMANDS.keys()
    for command, modules in loaded.items():
        assert f"vapor.commands.{command}" in modules
        assert not HEAVY & modules, command


def _loaded_by(words):
    return _modules(f"import atexit; atexit.register(seen, 'all'); from vapor.track import main; main({words})")["all"]


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
