"""A walk up a staircase of equal storeys, localized by a filter that is simulated: what reports are tested on."""

import numpy as np

from filtering.estimate import Estimate, Mode
from filtering.motion import Odometry
from filtering.observation import Observation
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from sequences.frame import Camera, Frame
from vapor.reporting.record import RunRecord, RunRecorder
from vapor.tracking.loop import Step

FLOOR_M = 3.0
CAMERA = Camera(width=160, height=120, fx=120.0, fy=120.0, cx=79.5, cy=59.5)


def true_walk(count: int, *, storeys: int = 5) -> Poses:
    """Poses up a stairwell: two flights a storey, the camera looking along its way."""
    turn = np.linspace(0.0, 2 * np.pi * (storeys - 1), count)
    translation = np.stack([1.2 * np.cos(turn), 2.0 * np.sin(turn), 1.6 + FLOOR_M * turn / (2 * np.pi)], axis=1)
    translation[:, 2] += 0.03 * np.sin(9 * turn)
    yaw = turn + np.pi / 2
    forward = np.stack([np.cos(yaw), np.sin(yaw), np.zeros(count)], axis=1)
    down = np.broadcast_to([0.0, 0.0, -1.0], (count, 3))
    return Poses(np.stack([np.cross(down, forward), down, forward], axis=-1), translation)


def simulated_steps(count=200, *, seed=0, with_truth=True, start_ns=1_700_000_000_000_000_000):
    """Yield (frame, step): the belief is on five storeys until a third of the way. There are no baselines."""
    rng = np.random.default_rng(seed)
    truth = true_walk(count)
    v, u = np.mgrid[:120, :160]
    for i in range(count):
        odometry = None
        if i:
            drift = np.array([0.0, 0.002, 0.006, 0.0, 0.006, 0.0]) + 0.004 * rng.standard_normal(6)
            odometry = Odometry(truth[i - 1].inverse() @ truth[i] @ Poses.exp(drift), np.diag([1e-4] * 6), 0.1)
        image = np.stack([120 + 80 * np.sin((u + 3 * i) / 9), 110 + 70 * np.cos(v / 7), 90 + v], -1).astype(np.uint8)
        frame = Frame(start_ns + i * 100_000_000, image, odometry, truth[i] if with_truth else None, CAMERA)
        belief = max(0.0, 1.0 - i / (0.33 * count))
        weights = np.array([belief / 5] * 5)
        storey = int(np.clip(round((truth[i].translation[2] - 1.6) / FLOOR_M), 0, 4))
        weights[storey] += 1.0 - belief
        wrong = rng.choice(5, p=np.full(5, 0.2))
        single = _moved(truth[i], FLOOR_M * (wrong - storey) if rng.random() < 0.6 else 0.0, 0.08, rng)
        which = rng.choice(5, size=500, p=weights / weights.sum())
        particles = _moved(truth[np.full(500, i)], FLOOR_M * (which - storey), 0.12, rng)
        best = int(np.argmax(weights)) if belief < 0.5 else (storey + 2 + i // 25) % 5
        order = [best, *(f for f in np.argsort(-weights) if f != best and weights[f] > 0.02)]
        covariance = np.diag([0.01] * 3 + [0.003] * 3)
        modes = tuple(
            Mode(_moved(truth[i], FLOOR_M * (f - storey), 0.03, rng), covariance, float(weights[f]), identity=int(f))
            for f in order
        )
        status = "converged" if weights.max() > 0.8 else "lost" if i < 6 else "ambiguous"
        log_weights = np.full(500, -np.log(500))
        covariances = np.broadcast_to(np.diag([1e-6] * 6), (500, 6, 6))
        agreement, ood_score = 1.0 - 0.5 * belief, 0.1 * rng.random()
        estimate = Estimate(
            modes, status, particles, covariances, log_weights, 0.0, 0.0, agreement, 0.1, 0.1, ood_score
        )
        places = (Mode(single, covariance, 1.0),)
        observation = Observation.of_posterior(PosePosterior.uninformative(), odometry)
        yield frame, Step(observation, estimate, places, {}, 20.0 + rng.random())


def simulated_record(count=200, **options) -> RunRecord:
    recorder = RunRecorder()
    for frame, step in simulated_steps(count, **options):
        recorder.add(frame, step)
    return recorder.finish(skipped={"undecodable_image": 2}, peak_rss_mb=512.0)


def _moved(pose: Poses, up_m, noise: float, rng: np.random.Generator) -> Poses:
    shift = np.zeros((*pose.batch_shape, 3))
    shift[..., 2] = up_m
    tangent = noise * rng.standard_normal((*pose.batch_shape, 6)) * np.array([1, 1, 1, 0.3, 0.3, 0.3])
    return Poses(pose.rotation, pose.translation + shift) @ Poses.exp(tangent)
