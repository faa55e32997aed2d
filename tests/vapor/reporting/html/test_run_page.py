"""The page of a run: its numbers are those of the report, its verdict is what happened."""

import base64
from dataclasses import replace

import cv2
import numpy as np
import pytest

from filtering.se3 import Poses
from filtering.storeys import Storeys
from tests.helpers.pages import ReadPage
from tests.helpers.simulated_run import simulated_record, simulated_steps
from vapor.evaluation.trained_images import said_of_trained_images
from vapor.reporting.calibration import format_calibration
from vapor.reporting.html.run_page import run_page, verdict
from vapor.reporting.record import Moment, RunRecorder
from vapor.reporting.report import build_report

SETTINGS = {"model": {"name": "stairs"}, "versions": {"numpy": "2.4"}, "run": {"seed": 3}}


@pytest.fixture(scope="module")
def record():
    return simulated_record(150)


def read(record, **options) -> ReadPage:
    page = run_page(record, build_report(record), title="walk.mcap", settings=SETTINGS, **options)
    return ReadPage.of(page.html())


def test_the_table_has_the_numbers_of_the_report(record):
    report, page = build_report(record), read(record)
    row = page.cells.index("particle filter")
    metrics = report["filter"]
    assert page.cells[row + 1].split() == [
        f"{metrics['median_translation_m']:.3f}",
        "m",
        f"{metrics['median_rotation_deg']:.1f}°",
    ]
    assert page.cells[row + 2 : row + 5] == [f"{100 * part:.0f} %" for part in metrics["recall"].values()]


def test_calibration_is_shown_of_the_filter_and_of_smoothed_poses(record):
    report = build_report(record)
    smoothed = {"images": 140, "wrong": 0.0, "coverage": {"50%": 0.2, "90%": 0.42, "95%": 0.55}, "median_nees": 11.3}
    report["hindsight"] = {"ambiguous": 0, "carried_off_s": [1.0, 2.5, 9.0], "consistency": smoothed}
    cells = ReadPage.of(run_page(record, report, title="walk.mcap", settings=SETTINGS).html()).cells
    row = cells.index("particle filter", cells.index("median\nNEES"))
    filtered = report["consistency"]
    held = [f"{100 * part:.1f} %" for part in filtered["coverage"].values()]
    assert cells[row + 1 : row + 5] == [str(filtered["images"]), *held]
    assert cells[row + 7 : row + 14] == ["smoothed", "140", "20.0 %", "42.0 %", "55.0 %", "11.30", "0.0 %"]
    assert cells[cells.index("carried off, in hindsight, after") + 1] == "1.0 s, 2.5 s and 9.0 s"
    assert cells[row + 14 : row + 21] == ["expected", "", "50 %", "90 %", "95 %", "5.35", "0 %"]


def test_calibration_is_shown_of_fifty_images_and_more(record):
    few = {"images": 49, "wrong": 1.0, "coverage": {"50%": 0.0, "90%": 0.0, "95%": 0.0}, "median_nees": 30.0}
    report = build_report(record) | {"hindsight": {"ambiguous": 0, "carried_off_s": [], "consistency": few}}
    cells = ReadPage.of(run_page(record, report, title="walk.mcap", settings=SETTINGS).html()).cells
    row = cells.index("smoothed", cells.index("median\nNEES"))
    assert cells[row + 1 : row + 7] == ["49", "", "", "", "", ""]
    assert format_calibration(report) is not None
    report["consistency"] = few
    page = ReadPage.of(run_page(record, report, title="walk.mcap", settings=SETTINGS).html())
    assert "Fewer than 50 images are converged" in page.words
    assert "median\nNEES" not in page.cells
    assert format_calibration(report) is None
    report["consistency"] = {**few, "images": 50}
    assert format_calibration(report) is not None


def test_what_was_asked_and_how_it_was_made_are_said(record):
    page = read(record, notices=["mind the step"], command="vapor-track run walk.mcap --model stairs")
    for said in ("walk.mcap", "150 images in 15 s, localized by stairs", "mind the step", '"seed": 3'):
        assert said in page.words
    assert "vapor-track run walk.mcap --model stairs" in page.words
    assert page.cells[page.cells.index("numpy") + 1] == "2.4"


def test_what_is_synthetic_or_simulated_is_said_where_the_data_say_so(record):
    def asked(**settings) -> str:
        return run_page(record, build_report(record), title="walk.mcap", settings=settings).asked

    synthetic = {"image_source": "synthetic", "odometry": "simulated with drift"}
    assert asked(sequence=synthetic) == "150 synthetic images in 15 s, localized. Odometry: simulated with drift"
    recorded = {"image_source": None, "odometry": "recorded: slam.txt"}
    assert asked(sequence=recorded) == "150 images in 15 s, localized. Odometry: recorded: slam.txt"
    assert (
        asked(odometry="simulated from poses: scale 0.02, seed 0")
        == "150 images in 15 s, localized. Odometry: simulated from poses"
    )
    assert asked(sequence={"image_source": None, "odometry": None}) == "150 images in 15 s, localized"


def test_every_image_of_a_short_run_is_a_moment_that_can_be_looked_at(record):
    data = read(record).data["run"]
    assert len(data["moments"]) == 150
    moment = data["moments"][70]
    assert moment["time_s"] == pytest.approx((record.times_ns[70] - record.times_ns[0]) / 1e9)
    assert moment["status"] == record.status[70]
    assert len(moment["weights"]) == len(moment["modes"][0]) == record.num_modes[70]
    best = record.methods["filter"].poses.translation[70]
    assert moment["belief"] == "1 mode"
    assert np.allclose(np.array(moment["modes"])[:, 0], 1000 * best, atol=1.0)
    centre = np.array(moment["camera"])[:, 3]  # the line along the pyramid passes through it
    assert np.allclose(centre, 1000 * best, atol=1.0)
    particles = np.array(moment["particles"])
    assert particles.shape == (3, 60)
    assert max(moment["of"]) < len(moment["weights"])


def test_where_the_best_mode_is_not_the_heaviest_both_are_said(record):
    def said(*weights: float) -> str:
        moment = replace(record.moments[0], modes=np.zeros((len(weights), 3), np.float32), weights=np.array(weights))
        return read(replace(record, moments=(moment,))).data["run"]["moments"][0]["belief"]

    assert said(0.28, 0.38, 0.2) == "3 modes, best 28 %, heaviest 38 %"
    assert said(0.6, 0.3) == "2 modes, best 60 %"
    assert said(0.281, 0.284, 0.2) == "3 modes, best 28 %"
    assert "it stays the best until another is clearly heavier" in read(record).words


def test_beside_a_moment_is_its_own_image_at_most_200_pixels_wide(record):
    images = [np.full((240, 320, 3), shade, np.uint8) for shade in (40, 200)]
    moments = [Moment.of(i, replace(record.keyframes[0], thumbnail=image)) for i, image in enumerate(images)]
    data = read(replace(record, moments=tuple(moments))).data["run"]["moments"]
    for moment, shade in zip(data, (40, 200), strict=True):
        jpeg = base64.b64decode(moment["image"].removeprefix("data:image/jpeg;base64,"))
        image = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
        assert image.shape == (150, 200, 3)
        assert abs(image.mean() - shade) < 2


def test_a_page_begins_at_a_moment_that_one_of_its_pictures_shows(record):
    page = read(record)
    moments = [int(attributes["data-moment"]) for _, attributes in page.tags if "data-moment" in attributes]
    (begin,) = [int(attributes["value"]) for _, attributes in page.tags if attributes.get("type") == "range"]
    assert begin in moments
    assert begin == min(moments, key=lambda moment: abs(moment - 0.15 * 149))
    assert min(abs(moment - int(0.15 * 149)) for moment in moments) > 0  # a fixed place would be at none of them


def test_a_path_is_broken_where_a_hypothesis_jumped(record):
    (path,) = [each for each in read(record).data["run"]["paths"] if each["name"] == "particle filter"]
    points = [each for each in path["x"] if each is not None]
    assert len(points) == 150
    steps = np.linalg.norm(np.diff(record.methods["filter"].poses.translation, axis=0), axis=1)
    assert path["x"].count(None) == (steps > 0.4 + 6.0 * np.median(steps)).sum() > 0


def test_the_verdict_says_what_happened(record):
    report = build_report(record)
    right = report["filter"]["converged_at_s"]
    assert verdict(report, record).startswith(f"Right from {right:.1f} s on, ")
    sure = report["consistency"]["images"]
    assert verdict(report, record).endswith(f"; right in all {sure} images that it called converged.")
    lost = {**report["filter"], "converged_at_s": None}
    assert verdict({**report, "filter": lost}, record).startswith("It did not find the place and keep it: ")

    def said(**consistency) -> str:
        return verdict({**report, "consistency": {**report["consistency"], **consistency}}, record).split("; ")[1]

    assert said(wrong=0.1, images=50) == "wrong in 5 of the 50 images that it called converged."
    assert said(wrong=1.0, images=1) == "wrong in 1 of the 1 image that it called converged."
    assert said(wrong=0.0, images=1) == "right in the 1 image that it called converged."
    assert said(wrong=None, images=0) == "it called no image converged."


def test_the_verdict_says_so_where_many_images_were_trained_on(record):
    report = build_report(record)

    def said(count: int) -> str:
        new = Poses(np.tile(np.eye(3), (150, 1, 1)), np.arange(450.0).reshape(150, 3))
        notice = said_of_trained_images(list(new), new[:count])
        return run_page(record, report, title="walk.mcap", settings=SETTINGS, notices=["mind the step", notice]).verdict

    assert said(29) == verdict(report, record)
    assert said(30) == (
        f"{verdict(report, record)} But 30 of 150 images were trained on: expect larger errors in new images."
    )


def test_one_image_is_not_several(record):
    report = build_report(record) | {"frames": 1}
    assert run_page(record, report, title="walk.mcap", settings={}).asked.startswith("1 image in ")


def test_it_says_how_often_dead_reckoning_was_put_on_the_true_path_again(record):
    assert "Dead reckoning starts again" not in read(record).words
    gaps = (20, 60, 61)
    recorder = RunRecorder()
    for number, (frame, step) in enumerate(simulated_steps(90)):
        recorder.add(replace(frame, odometry=None) if number in gaps else frame, step)
    words = read(recorder.finish()).words
    assert "Dead reckoning starts again at the true pose 3 times, where the odometry has gaps." in words


def test_without_true_poses_it_says_so_and_how_sure_it_was():
    record = simulated_record(30, with_truth=False)
    page = read(replace(record, status=("ambiguous",) * 10 + ("converged",) * 20))
    assert "Sure in 67 % of the images, first after 1.0 s. There are no true poses to compare with." in page.words
    assert "errors" not in page.data
    assert "Never sure where it is" in read(replace(record, status=("lost",) * 30)).words


def test_where_there_are_storeys_the_page_says_which(record):
    storeys = Storeys((2.0, 5.0, 8.0))
    belief = np.full((150, 3), [0.01, 0.01, 0.98])
    floored = replace(record, storeys=storeys, storey_belief=belief)
    report, page = build_report(floored), read(floored)
    assert [page.cells[page.cells.index(f"storey {n}, {h:.1f} m") + 1] for n, h in enumerate(storeys.heights_m)] == [
        "1.0 %",
        "1.0 %",
        "98.0 %",
    ]
    wrong = report["storeys"]["sure_and_wrong"]
    assert f"Sure of its storey, by 95 % and more, after 100 % of the images, of these wrong: {100 * wrong:.1f} %" in (
        page.words
    )
    assert "On stairs the storey changes at one height." in page.words  # so 99 % here, and 100 % within 0.1 m
    assert "Storeys" not in read(record).words


def test_without_images_there_is_no_strip_of_them(record):
    blind = tuple(replace(each, thumbnail=np.zeros((0, 0, 3), np.uint8)) for each in record.keyframes)
    assert [tag for tag, _ in read(replace(record, keyframes=blind)).tags].count("img") == 0
    assert [tag for tag, _ in read(record).tags].count("img") > 3
