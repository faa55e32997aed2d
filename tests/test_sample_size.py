"""How many particles a belief needs."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from filtering.errors import VaporTrackError
from filtering.localizer import LocalizerConfig
from filtering.sample_size import SampleSizeConfig, draw_enough, occupied_cells
from filtering.se3 import Poses

CONFIG = SampleSizeConfig(min_particles=10, max_particles=10**6)


@pytest.mark.parametrize("cells", [2, 3, 10, 100, 5000])
def test_the_number_is_half_a_chi_squared_quantile_over_the_divergence(cells):
    exact = chi2.ppf(CONFIG.confidence, cells - 1) / (2 * CONFIG.divergence)
    assert CONFIG.particles_needed(cells) == pytest.approx(exact, rel=0.02, abs=2)


def test_the_number_keeps_its_bounds():
    config = SampleSizeConfig(min_particles=300, max_particles=900)
    assert [config.particles_needed(cells) for cells in (0, 1, 2, 10**6)] == [300, 300, 300, 900]


def test_so_many_particles_do_keep_the_divergence():
    """What the formula promises, by simulation: 99 of 100 histograms lie within the divergence of their source."""
    rng = np.random.default_rng(0)
    share = rng.dirichlet(np.ones(50))
    n = CONFIG.particles_needed(50)
    counts = rng.multinomial(n, share, size=2000) / n
    divergence = np.where(counts > 0, counts * np.log(np.maximum(counts, 1e-12) / share), 0.0).sum(axis=1)
    assert np.mean(divergence <= CONFIG.divergence) > 0.975  # the χ² law holds for large n only


def test_cells_count_the_same_for_a_belief_wherever_it_looks():
    """Cells of Euler angles would multiply at their poles: looking straight up, a narrow belief would fill many."""
    rng = np.random.default_rng(1)
    belief = Poses.exp(np.concatenate([np.zeros((4000, 3)), 0.1 * rng.standard_normal((4000, 3))], axis=1))
    counts = []
    for turn in Rotation.random(60, random_state=2).as_matrix():
        counts.append(occupied_cells(Poses(turn @ belief.rotation, belief.translation), CONFIG))
    for pitch in (np.pi / 2, -np.pi / 2):
        looking = Rotation.from_euler("y", pitch).as_matrix()
        counts.append(occupied_cells(Poses(looking @ belief.rotation, belief.translation), CONFIG))
    assert max(counts) < 4 * min(counts)


def test_a_wide_belief_gets_more_particles_than_a_narrow_one():
    rng = np.random.default_rng(3)

    def draw(width):
        return lambda size: Poses.exp(width * rng.standard_normal((size, 6)))

    # The level camera at the origin is in the middle of a cell, not where 2⁶ of them meet.
    assert occupied_cells(draw(0.02)(1000), CONFIG) == 1

    narrow, wide, wider = (
        len(draw_enough(draw(width), SampleSizeConfig(max_particles=3000))[0]) for width in (0.02, 0.3, 1.0)
    )
    assert narrow == 1000
    assert narrow < wide <= wider == 3000


def test_a_given_number_is_kept_whatever_the_belief():
    size = LocalizerConfig(num_particles=123).size
    poses, count = draw_enough(lambda n: Poses.exp(np.random.default_rng(n).standard_normal((n, 6))), size)
    assert len(poses) == count == 123


def test_bounds_that_cross_are_refused():
    with pytest.raises(VaporTrackError, match="min_particles is 1000"):
        SampleSizeConfig(max_particles=400)
