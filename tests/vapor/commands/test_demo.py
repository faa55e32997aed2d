"""`vapor-track demo`, with the models that ship."""

import json
import re

import pytest

from tests.helpers.full import some
from vapor.checkpoints import file_format
from vapor.track import main


@pytest.mark.usefixtures("rough_light")
@pytest.mark.parametrize("scene", some(1, ["staircase", "ceiling"]))
def test_the_demo_runs_with_the_model_that_ships(scene, tmp_path, monkeypatch, capsys):
    assert (file_format.SHIPPED / f"{scene}.safetensors").is_file(), f"no model ships for {scene}"
    assert (file_format.SHIPPED / f"{scene}.safetensors").stat().st_size <= 8_000_000
    monkeypatch.chdir(tmp_path)
    assert main(["demo", scene, "--frames", "6"]) == 0
    out, err = capsys.readouterr()
    assert re.fullmatch(r"(rendering: .*\n)+(localizing: .*\n)+", err)
    methods = ["single image", "dead reckoning", "Kalman filter", "particle filter", "smoothed"]  # as on the page
    assert [line.split("│")[1].strip() for line in out.splitlines() if line.startswith("│")] == methods
    for words in ("recording.rrd", "report.html"):
        assert words in out
    report = json.loads((tmp_path / "demo" / scene / "report.json").read_text())
    assert report["frames"] == 6
    assert report["single_image"]["median_translation_m"] < 30  # within the scene
