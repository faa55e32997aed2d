"""Runs of recordings with random faults: an error of ours or a result that is right about itself, every image counted.

`SEEDS=2000` tries as many; the suite a few.
"""

import os
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from filtering.errors import VaporTrackError
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from sequences.files import read_lines
from sequences.reader import SequenceReader
from sequences.trajectories.tum import read_tum
from tests.helpers.random_recordings import NUM_IMAGES, write_random
from tests.helpers.sequence_files import BEGIN_NS, picture, world_from_camera
from tests.helpers.simulation import ERRORS, seen_at
from vapor.pipeline.config import FilteringConfig
from vapor.pipeline.localize import localize
from vapor.pipeline.results import write_results

SEEDS = int(os.environ.get("SEEDS", "20"))
AT_ONCE = 10
CONFIG = FilteringConfig(recording=False)


class Pictured:
    """Says where a picture was taken: a walk shows each of twelve again and again."""

    def __init__(self) -> None:
        poses = [world_from_camera(BEGIN_NS + i * 100_000_000) for i in range(NUM_IMAGES)]
        self._by_picture = {picture(i).tobytes(): Poses.stack(poses[i::12]) for i in range(12)}

    def observe(self, image: np.ndarray, *, rng: np.random.Generator) -> PosePosterior:
        poses = self._by_picture[image.tobytes()]
        return seen_at(poses, [1 / len(poses)] * len(poses), ood_score=0.2)


@pytest.mark.usefixtures("unchecked", "plain_results")
@pytest.mark.parametrize("first", range(0, SEEDS, AT_ONCE))
def test_a_run_is_an_error_of_ours_or_right_about_itself(first: int, tmp_path: Path) -> None:
    outcomes: Counter[str] = Counter()
    for seed in range(first, min(first + AT_ONCE, SEEDS)):
        file, directory = tmp_path / f"{seed}.mcap", tmp_path / f"{seed}"
        names = write_random(file, seed)
        directory.mkdir()
        try:
            reader = SequenceReader(file)
            record = localize(reader, Pictured(), directory, CONFIG, ERRORS)
            write_results(record, directory, {}, title="random", notices=reader.notices)
        except VaporTrackError as error:
            outcomes["refused"] += 1
            if file.name not in str(error):
                pytest.fail(f"seed {seed} ({names}): {error}")
            continue
        outcomes["localized"] += 1
        said = f"seed {seed}: {names}"
        assert record.images is not None
        assert record.images.are_complete, said
        assert record.images.used == len(record.times_ns), said
        assert (np.diff(record.times_ns) > 0).all(), said
        assert np.linalg.eigvalsh(record.covariance).min() > 0, said
        for name, track in record.methods.items():
            assert track.poses.is_finite().all(), f"{said}: {name}"
        assert len(read_tum(directory / "trajectory.tum")) == len(record.times_ns)
        with open(directory / "estimate.mcap", "rb") as stream:
            written = make_reader(stream, decoder_factories=[DecoderFactory()])
            for *_, pose in written.iter_decoded_messages(topics=["/estimate/pose"]):
                assert np.linalg.eigvalsh(np.reshape(pose.pose.covariance, (6, 6))).min() > 0, said
        header, *rows = [line.split(",") for _, line in read_lines(directory / "status.csv")]
        std_m = [float(row[header.index("std_m")]) for row in rows]
        assert np.isfinite(std_m).all(), said
        assert min(std_m) > 0, said
    assert outcomes["localized"] > 0, outcomes
