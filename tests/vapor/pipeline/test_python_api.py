"""The Python API: a user's own observation model, and the example of README.md and docs/index.md."""

import re

import numpy as np
import pytest

from filtering.config import LocalizerConfig
from filtering.localizer import ParticleLocalizer
from filtering.measurement_noise import MeasurementNoise
from filtering.motion import Odometry
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from sequences.synthesize import synthesize, write_synthetic
from tests.helpers.checkout import CHECKOUT

ROUGH = MeasurementNoise(radius_m=1.0)


class UsersModel:
    """A user's posterior: Gaussian in position about a point, any rotation near one; nothing of ours inherited."""

    def observe(self, image, *, rng):
        tangent = rng.standard_normal((300, 6)) * [0.2, 0.2, 0.2, 0.1, 0.1, 0.1]
        centre = np.array([image[0, 0, 0] / 10.0, 2.0, 1.5])
        return PosePosterior.from_samples(Poses(Poses.exp(tangent).rotation, centre + tangent[:, :3]), ROUGH)


def test_a_users_own_observation_model_drives_the_filter():
    localizer = ParticleLocalizer(UsersModel(), LocalizerConfig(), rng=np.random.default_rng(0))
    odom = Odometry(Poses.exp(np.array([0.1, 0, 0, 0, 0, 0])), np.diag([1e-4] * 6), 0.1)
    for i in range(15):
        estimate = localizer.step(np.full((4, 6, 3), i, np.uint8), odom if i else None)
        best = estimate.modes[0]
        np.testing.assert_allclose(best.world_from_camera.translation, [i / 10.0, 2.0, 1.5], atol=0.15)
    assert estimate.status == "converged"
    assert best.weight > 0.9
    assert np.sqrt(best.covariance[0, 0]) < 0.2  # better than any one image


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("page", ["README.md", "docs/index.md"])
def test_the_ten_lines_that_a_newcomer_sees_first_run(page, tmp_path, monkeypatch, capsys):
    blocks = re.findall(r"```python\n(.*?)```", (CHECKOUT / page).read_text(encoding="utf-8"), flags=re.DOTALL)
    block = next((b for b in blocks if "ParticleLocalizer" in b), None)
    assert block is not None, f"{page} shows no Python block with ParticleLocalizer"
    lines = [line for line in block.splitlines() if line.strip() and not line.startswith(("import", "from"))]
    assert len(lines) <= 12
    path = tmp_path / "demo" / "staircase" / "sequence.mcap"
    path.parent.mkdir(parents=True)
    write_synthetic(synthesize("round-table", seed=3, num_frames=6, width=80, height=60), path)
    monkeypatch.chdir(tmp_path)
    exec(compile(block, page, "exec"), {"__name__": "page"})
