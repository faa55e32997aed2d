import numpy as np

from filtering.moments import group_moments
from filtering.se3 import Poses

SPREAD = np.array([0.3, 0.1, 0.2, 0.05, 0.1, 0.08])


def place(x, n, seed):
    local = Poses.exp(SPREAD * np.random.default_rng(seed).standard_normal((n, 6)))
    return Poses.exp(np.array([x, 0, 0, 0, 0, x / 9])) @ local


def test_group_moments_are_those_of_every_group_alone():
    poses = Poses.concatenate([place(0.0, 50, 0), place(3.0, 70, 1)])
    weights = np.random.default_rng(2).random(120)
    means, covariances, tangent = group_moments(poses, weights, np.repeat([0, 1], [50, 70]), 2)
    for k, own in enumerate((slice(50), slice(50, 120))):
        mean = poses[own].mean(weights[own])
        np.testing.assert_allclose(means[k].as_matrix(), mean.as_matrix(), atol=1e-12)
        deviation = (mean.inverse() @ poses[own]).log()
        np.testing.assert_allclose(tangent[own], deviation, atol=1e-9)
        np.testing.assert_allclose(covariances[k], np.cov(deviation.T, aweights=weights[own], bias=True), atol=1e-3)


def test_a_group_without_weight_counts_its_poses_equally():
    poses = place(0.0, 20, 3)
    means, _, _ = group_moments(poses, np.zeros(20), np.zeros(20, np.int64), 1)
    np.testing.assert_allclose(means[0].as_matrix(), poses.mean().as_matrix(), atol=1e-12)
