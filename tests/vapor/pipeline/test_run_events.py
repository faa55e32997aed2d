"""What happens on the way of a run: gaps and wrong odometry."""

import csv
import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from filtering.se3 import Poses
from sequences.reader import SequenceReader
from sequences.reading.counts import IN_GAP
from tests.helpers.command_line import report_of
from tests.helpers.pages import ReadPage
from tests.helpers.sequence_files import BEGIN_NS, Walk, rewrite
from tests.helpers.simulation import ERRORS, lifted, seen_at
from vapor.commands.run import show_run
from vapor.pipeline.config import FilteringConfig
from vapor.pipeline.localize import localize
from vapor.pipeline.results import write_results
from vapor.reporting.record import RunRecord


class Storeys:
    """Says where the camera is, and from some image on the same a storey higher as well: one image after the other."""

    def __init__(self, sequence: Path, alone: int) -> None:
        self.truth = Poses.stack([frame.world_from_camera for frame in SequenceReader(sequence)])
        self.alone, self.count = alone, -1

    def observe(self, image, *, rng):
        self.count += 1
        storeys = [0.0] if self.count < self.alone else [0.0, 6.0]
        return seen_at(lifted(self.truth[self.count], storeys), [1.0 / len(storeys)] * len(storeys), ood_score=0.2)


def follow(sequence: Path, directory: Path, *, alone: int) -> RunRecord:
    directory.mkdir()
    reader, model = SequenceReader(sequence), Storeys(sequence, alone)
    return localize(reader, model, directory, FilteringConfig(recording=False), ERRORS)


def test_a_gap_in_the_odometry_widens_the_belief_but_does_not_forget_it(walk_of_25, tmp_path):
    begins, ends = BEGIN_NS + 1_020_000_000, BEGIN_NS + 1_780_000_000
    gappy = rewrite(walk_of_25, tmp_path / "g.mcap", keep=lambda topic, t: topic != "/odom" or not begins < t < ends)
    record = follow(gappy, tmp_path / "out", alone=8)
    assert record.skipped[IN_GAP] > 3
    (after,) = np.flatnonzero(np.diff(record.times_ns) > 300_000_000) + 1
    assert 8 < after < len(record.times_ns) - 5  # two storeys are possible by then, if the belief began anew
    std = np.sqrt(record.covariance[:, 0, 0])
    assert std[after] > 1.1 * std[after - 1]
    assert record.best_weight[after:].min() > 0.9
    assert record.methods["filter"].poses.distance(record.truth.poses)[0].max() < 0.2


def wrong_odometry(kind: str, poses: list[tuple[int, Poses]], begin: int, end: int) -> list[tuple[int, Poses]]:
    """Odometry that is wrong from increment `begin` to `end`; or set back at `begin` to an origin 5 m away."""
    times_ns, given = zip(*poses, strict=True)
    told = [Poses.exp(np.array([4.0, 3.0, 0.0, 0.0, 0.0, 0.0]))]
    for i, (before, after) in enumerate(itertools.pairwise(given), start=1):
        step = before.inverse() @ after
        if kind != "reset" and begin <= i < end:
            step = Poses.identity() if kind == "stuck" else Poses.exp(3.0 * step.log())
        told.append(Poses.identity() if kind == "reset" and i == begin else told[-1] @ step)
    return list(zip(times_ns, told, strict=True))


@pytest.mark.usefixtures("unchecked", "plain_results")
def test_smoothed_poses_that_err_by_more_than_they_state_are_told_of_beside_the_filter(tmp_path, capsys):
    sequence = Walk(60, twist_covariance=1e-6 * np.eye(6)).write(tmp_path / "walk.mcap")
    record = follow(sequence, tmp_path / "out", alone=60)
    smoothed = record.look_back.trajectories["smoothed"]
    off = smoothed.poses @ Poses.exp(np.array([0.05, 0.0, 0.0, 0.0, 0.0, 0.0]))
    sharp = replace(smoothed, poses=off, covariance=1e-3 * smoothed.covariance)
    record = record.in_hindsight(replace(record.look_back, trajectories={"smoothed": sharp}))
    result = write_results(record, tmp_path / "out", {}, title="walk")
    show_run(result, tmp_path / "out", title="walk", recording=False)
    printed = capsys.readouterr().out
    assert "  the 90 % regions of smoothed poses hold 0 % of the true poses, those of the filter " in printed
    (row,) = [line for line in printed.splitlines() if line.startswith("│ smoothed ") and " m " not in line]
    assert [cell.strip() for cell in row.split("│")[3:6]] == ["0.0 %", "0.0 %", "0.0 %"]
    page = ReadPage.of((tmp_path / "out" / "report.html").read_text())
    assert "Take the filter's poses and covariances" in page.words


@pytest.mark.usefixtures("unchecked", "plain_results")
@pytest.mark.parametrize("kind", ["right", "stuck", "slipping", "reset"])
def test_smoothed_poses_are_doubtful_where_odometry_was_wrong(kind, tmp_path, capsys):
    walk, begin = Walk(60, twist_covariance=1e-6 * np.eye(6)), 150  # 50 Hz: three seconds
    if kind != "right":
        walk.odometry = wrong_odometry(kind, walk.odometry, begin, begin + 75)
    sequence = walk.write(tmp_path / "walk.mcap")
    record = follow(sequence, tmp_path / "out", alone=60)
    off_m = record.methods["smoothed"].poses.distance(record.truth.poses)[0]
    result = write_results(record, tmp_path / "out", {}, title=kind)
    with (tmp_path / "out" / "status.csv").open() as file:
        doubtful = np.array([row["smoothed"] == "doubtful" for row in csv.DictReader(file)])
    assert report_of(tmp_path / "out")["smoothed_doubtful"] == doubtful.sum()
    show_run(result, tmp_path / "out", title=kind, recording=False)
    printed = capsys.readouterr().out
    if kind == "right":
        assert off_m.max() < 0.1
        assert not doubtful.any()
        assert "doubtful" not in printed
        return
    assert doubtful[off_m > 0.5].all()
    assert doubtful[off_m < 0.1].mean() < 0.1  # images about a pose count, too
    assert (
        not doubtful.any()
        or f"{doubtful.sum()} of 60 smoothed poses are doubtful: images about them do not fit (status.csv)" in printed
    )
