"""The states of a chain, and the covariances of its poses: Gauss-Newton linearises it, and GTSAM eliminates it.

Source: Dellaert and Kaess, "Factor graphs for robot perception", 2017 (elimination, marginals, § 7.3 fixed-lag
smoothing).
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

import gtsam
import numpy as np
from jaxtyping import Float64, Int64
from scipy.linalg import solve_triangular

from filtering.errors import VaporTrackError
from filtering.hypotheses import BIAS, POSE
from filtering.measurement_noise import MeasurementNoise
from filtering.se3 import Poses
from filtering.state_chain import Chain, Places, Prior, Transition

Graph = gtsam.GaussianFactorGraph
Factors = list[list[gtsam.JacobianFactor]]
"""Linear factors of the changes of states, by image."""

_DAMPING = (0.0, 1e-3, 1e-2, 1e-1, 1.0)  # roots of information on each change, until the graph can be solved
_MOST_ROUNDS = 10
_SETTLED = 0.01  # ordinary standard deviations


def solve(
    start: Poses, prior: Prior, transitions: Sequence[Transition], places: Places, noise: MeasurementNoise
) -> tuple[Chain, Float64[np.ndarray, "n 6 6"]]:
    """The most probable states of n images, and the covariance of each pose.

    Args:
        start: world_from_camera at which the search begins, batch (n,).
        prior: Of the first.
        transitions: Between them, n − 1.
        places: Of the images.
        noise: Noise of the images.
    """
    chain = Chain.from_prior(prior, start)
    std, chosen, larger = np.asarray(noise.finest.typical_std), np.zeros(0, np.int64), np.zeros(0)
    for number in range(_MOST_ROUNDS):
        before, chosen = chosen, places.choose(chain)
        larger = places.enlarged(chain, chosen) if number else np.ones(len(chosen))
        factors = factors_of(chain, transitions, places, chosen, larger)
        _, change = solved(graph_of(prior_factor(prior, chain), factors), range(len(start)), chain.units)
        chain, moved = updated(chain, change)
        if number and np.array_equal(before, chosen) and (np.abs(moved) < _SETTLED * std).all():
            break
    factors = factors_of(chain, transitions, places, chosen, larger)
    graph = graph_of(prior_factor(prior, chain), factors)
    return chain, covariances_of(graph, range(len(start)), chain.units)


def solved(
    graph: gtsam.GaussianFactorGraph, keys: Sequence[int], units: Float64[np.ndarray, " d"]
) -> tuple[gtsam.GaussianFactorGraph, gtsam.VectorValues]:
    """The changes of all states, by their keys; the graph is damped where it is singular in double precision.

    Raises:
        VaporTrackError: it is singular all the same.
    """
    size, unit = len(units), None
    for damping in _DAMPING:
        if damping:
            unit = unit or gtsam.noiseModel.Unit.Create(size)
            for key in keys:
                graph.push_back(gtsam.JacobianFactor(key, damping * np.eye(size), np.zeros(size), unit))
        with suppress(RuntimeError):
            return graph, graph.optimize()
    raise VaporTrackError(f"the states of {len(keys)} images cannot be solved for, expected finite motions and places")


def covariances_of(
    graph: gtsam.GaussianFactorGraph, keys: Sequence[int], units: Float64[np.ndarray, " d"]
) -> Float64[np.ndarray, "n 6 6"]:
    """Covariances of the poses of all states, by their keys."""
    marginals = gtsam.Marginals(*solved(graph, keys, units))
    covariances = np.stack([marginals.marginalCovariance(key)[POSE, POSE] for key in keys])
    return covariances * np.multiply.outer(units[POSE], units[POSE])


def solved_from_first(
    graph: gtsam.GaussianFactorGraph, first: int, count: int, units: Float64[np.ndarray, " d"]
) -> tuple[gtsam.VectorValues, Float64[np.ndarray, "d d"]]:
    """The change of each of so many states, and a root of the information on the first, by one elimination.

    Args:
        graph: Of the factors.
        first: The key of the first state.
        count: Number of the states.
        units: See `Chain`.
    """
    ordering = gtsam.Ordering()
    for key in range(first + count - 1, first - 1, -1):
        ordering.push_back(key)
    with suppress(RuntimeError):
        eliminated = graph.eliminateSequential(ordering)
        root = np.array(eliminated.at(count - 1).R())  # a view of GTSAM's memory
        if (np.abs(root.diagonal()) > 0.0).all():
            return eliminated.optimize(), root
    damped, _ = solved(graph, range(first, first + count), units)
    eliminated = damped.eliminateSequential(ordering)
    return eliminated.optimize(), np.array(eliminated.at(count - 1).R())


def covariance_of(
    root_information: Float64[np.ndarray, "d d"], units: Float64[np.ndarray, " d"]
) -> Float64[np.ndarray, "6 6"]:
    """Covariance of the pose of a state, by an upper triangular root of the information on its change."""
    half = solve_triangular(root_information, np.eye(len(root_information)), check_finite=False)[POSE]
    half *= units[POSE, None]
    return half @ half.T


def marginalised(factors: Sequence[gtsam.JacobianFactor], chain: Chain) -> Prior:
    """What the first of n ≥ 2 states says of the second, as a prior.

    Args:
        factors: All of the change of the first state, one of them also of the second's.
        chain: From which they are changes.
    """
    rows, size = [], 6 + chain.mean.shape[1]
    for factor in factors:
        own = factor.getA()
        whole = own if len(factor.keys()) > 1 else np.pad(own, ((0, 0), (0, size)))
        rows.append(np.column_stack([whole, factor.getb()]))
    triangle = np.asarray(np.linalg.qr(np.concatenate(rows), mode="r"))[size : 2 * size, size:]
    return Prior(chain.poses[1], chain.mean[1], triangle[:, :size] / chain.units, triangle[:, size], chain.units)


def graph_of(
    prior: gtsam.JacobianFactor, factors: Sequence[Sequence[gtsam.JacobianFactor]]
) -> gtsam.GaussianFactorGraph:
    """The graph of a prior and of the factors of each image."""
    graph = gtsam.GaussianFactorGraph()
    graph.push_back(prior)
    for of_image in factors:
        for factor in of_image:
            graph.push_back(factor)
    return graph


def prior_factor(prior: Prior, chain: Chain, key: int = 0) -> gtsam.JacobianFactor:
    """The factor of the change of the first state by a prior."""
    off = np.concatenate([prior.pose.between(chain.poses[0]).log(), chain.mean[0] - prior.mean])
    value = prior.rest - prior.root_information @ off
    return gtsam.JacobianFactor(
        key, prior.root_information * chain.units, value, gtsam.noiseModel.Unit.Create(len(off))
    )


def factors_of(
    chain: Chain,
    transitions: Sequence[Transition],
    places: Places,
    chosen: Int64[np.ndarray, " c"],
    larger: Float64[np.ndarray, " c"],
    key: int = 0,
) -> list[list[gtsam.JacobianFactor]]:
    """Factors of the changes of the n states, of the error ξ of each pose and of the other parts, by image.

    Those of an image are the transition from the one before, the place that it sees, and its vertical.

    Args:
        chain: The states that change.
        transitions: Between them, n − 1.
        places: Of the images.
        chosen: Places that are seen.
        larger: Factor of the variance of each.
        key: Of the first state; the others' count up from it.
    """
    size, count = 6 + chain.mean.shape[1], len(chain.poses)
    whole, of_place = gtsam.noiseModel.Unit.Create(size), gtsam.noiseModel.Unit.Create(6)
    factors: list[list[gtsam.JacobianFactor]] = [[] for _ in range(count)]
    if transitions:
        steps = Poses.stack([each.previous_from_current for each in transitions])
        matrices = np.stack([each.matrix for each in transitions])
        roots = np.stack([each.root_information for each in transitions])
        errs = (matrices[:, POSE, BIAS] @ chain.mean[:-1, :7, None])[:, :, 0]
        expected = chain.poses[:-1] @ (steps @ Poses.exp(errs))
        off = np.empty((len(transitions), size))
        off[:, POSE] = chain.poses[1:].between(expected).log()
        rest = np.einsum("nii->ni", matrices)[:, 6:]
        off[:, 6:] = rest * chain.mean[:-1] - chain.mean[1:]
        before, value = -roots @ matrices * chain.units, (roots @ off[:, :, None])[:, :, 0]
        roots = roots * chain.units
        for i in range(len(transitions)):
            factors[i + 1].append(gtsam.JacobianFactor(key + i, before[i], key + i + 1, roots[i], value[i], whole))
    if len(chosen):
        jacobian, value = places.measurements(chain, chosen, larger)
        own = chain.mean[places.image[chosen]]
        value = value - (jacobian[:, :, 6:] @ own[:, :, None])[:, :, 0]
        jacobian *= chain.units
        for i, each, measured in zip(places.image[chosen].tolist(), jacobian, value, strict=True):
            factors[i].append(gtsam.JacobianFactor(key + i, each, measured, of_place))
    for i, each, measured in places.vertical_measurements(chain):
        of_vertical = gtsam.noiseModel.Unit.Create(len(measured))
        factors[i].append(gtsam.JacobianFactor(key + i, each * chain.units, measured, of_vertical))
    return factors


def updated(chain: Chain, change: gtsam.VectorValues, key: int = 0) -> tuple[Chain, Float64[np.ndarray, "n 6"]]:
    """The chain after a change of its states, whose keys count up from one, and the change of its poses."""
    changes = np.stack([change.at(key + i) for i in range(len(chain.poses))]) * chain.units
    poses = (chain.poses @ Poses.exp(changes[:, POSE])).orthonormal()
    return Chain(poses, chain.mean + changes[:, 6:], chain.units), changes[:, POSE]
