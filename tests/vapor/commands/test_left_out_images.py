"""Images and messages that a run leaves out: counted in the report, and told."""

import json
import re

import pytest

from sequences.trajectories.tum import read_tum
from tests.helpers.command_line import contents, refuse, skipped_in_run, words_of_run
from tests.helpers.sequence_files import BEGIN_NS, IMAGES, Walk, rewrite
from vapor.track import main


@pytest.mark.usefixtures("unchecked", "plain_results")
def test_what_is_left_out_is_counted_in_the_report_and_told(tiny_model, tmp_path, capsys):
    walk, second = Walk(30), 1_000_000_000
    walk.odometry = [(t, pose) for t, pose in walk.odometry if t > BEGIN_NS + 0.25 * second]  # not images 0 to 2
    walk.images[6] = (walk.images[6][0], b"no image")
    walk.images[9] = (walk.images[9][0], walk.images[9][1][:40])
    walk.images.append(walk.images[14])  # a stamp twice

    def logged(topic: str, time_ns: int) -> int:
        return time_ns + 7 * second // 10 * (
            topic == IMAGES and time_ns == BEGIN_NS + 2 * second
        )  # after its successors, and yet used

    path = rewrite(walk.write(tmp_path / "in.mcap"), tmp_path / "walk.mcap", log_time=logged)
    frames, skipped = skipped_in_run(path, tiny_model, tmp_path / "out")
    assert skipped == {
        "before odometry begins": 3,
        "time stamp not increasing": 1,
        "undecodable image": 1,
        "damaged image": 1,  # it is cut
    }
    assert frames == 30 + 1 - 3 - 1 - 2
    images = json.loads((tmp_path / "out" / "report.json").read_text())["images"]
    assert images == {"stated": 31, "read": 31, "used": 25, "skipped": skipped}
    out, err = capsys.readouterr()
    assert "images     31 stated, 31 read, 25 used, 6 skipped" in out
    assert all(f"skipped {count}: {reason}" in out for reason, count in skipped.items())
    assert re.fullmatch(r"(localizing: .*\n)+", err)
    assert read_tum(tmp_path / "out" / "trajectory.tum").poses.is_finite().all()
    assert "NaN" not in (tmp_path / "out" / "report.json").read_text()


@pytest.mark.usefixtures("unchecked", "plain_results")
def test_a_run_that_used_few_of_its_images_says_so_last_and_one_that_used_hardly_any_fails(
    tiny_model, earlier, tmp_path, capsys
):
    walk = Walk(40)
    walk.odometry = [(t, pose) for t, pose in walk.odometry if t < BEGIN_NS + 10**9]
    path = walk.write(earlier.parent / "walk.mcap")
    assert main(words_of_run(path, tiny_model, tmp_path / "few")) == 0
    last = "Only 10 of 40 images were used: 30 were skipped: after odometry ends."
    assert capsys.readouterr().out.splitlines()[-1] == last

    before = contents(earlier)
    words = [*words_of_run(path, tiny_model, earlier), "--start-s", "0.8"]
    refuse(words, capsys, f"{path}: Only 2 of 32 images were used: 30 were skipped", "--allow-few-images")
    assert contents(earlier) == before
    assert main([*words, "--allow-few-images"]) == 0
    report = json.loads((earlier / "report.json").read_text())
    assert report["images"] == {
        "stated": 40,
        "read": 40,
        "used": 2,
        "skipped": {"after odometry ends": 30, "outside the stretch asked for": 8},
    }
