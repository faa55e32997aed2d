"""Which images are held out: shown by others, apart in time, and said."""

import numpy as np
import pytest

from filtering.se3 import Poses
from tests.helpers.corridors import STEP_M, corridor, recorded, stairwell
from vapor.training.holding_out import Split, hold_out, within_map
from vapor.training_data.ground import describe_runs, describe_unshown


def trained(split: Split) -> np.ndarray:
    """Which of the images are trained on, (n,)."""
    return np.isin(split.source.rows, split.training.rows)


def test_one_of_several_walks_is_held_out_as_a_whole():
    images = stairwell()
    split = hold_out(images, 0.1)
    assert len(np.unique(images.sequence[split.held_out_mask])) == 1
    held_out = images.sequence == images.sequence[split.held_out_mask][0]
    np.testing.assert_array_equal(split.held_out_mask, held_out)
    np.testing.assert_array_equal(trained(split), ~held_out)
    (note,) = split.notes
    assert (
        note
        == f"held out: walk{images.sequence[split.held_out_mask][0]} (400 images); other passes show the same ground"
    )


def test_of_many_walks_as_many_are_held_out_as_asked_for():
    images = stairwell(walks=20, top=tuple(range(20)))
    split = hold_out(images, 0.3)
    assert len(np.unique(images.sequence[split.held_out_mask])) == 6
    assert split.held_out_mask.mean() == pytest.approx(0.3)
    assert not hold_out(images, 0.0).held_out_mask.any()


def test_a_storey_that_one_walk_alone_shows_is_trained_on():
    walks = stairwell(top=(0,), walks=4)
    alone = walks.poses.translation[:, 2] > 8.9
    images = walks.select(np.flatnonzero((walks.sequence == 0) | (walks.poses.translation[:, 0] < 8.0)))
    alone = images.poses.translation[:, 2] > 8.9
    for share in (0.1, 0.9):
        split = hold_out(images, share)
        assert split.held_out_mask.any()
        assert trained(split)[alone].all()


def test_what_only_the_walk_held_out_shows_is_told_and_kept_apart_in_time():
    first = Poses.concatenate([corridor(0, 20), corridor(20, 40)])  # nobody else goes on
    others = [Poses.concatenate([corridor(0, 20, y_m=0.1 * i), corridor(0, 40, z_m=20.0 * i)]) for i in (1, 2, 3)]
    images = recorded(first, *others)
    split = hold_out(images, 0.1)
    assert not split.held_out_mask[400:].any()
    assert split.held_out_mask[:200].sum() > 150
    assert trained(split)[230:].all()
    held, beside = np.flatnonzero(split.held_out_mask), np.flatnonzero(trained(split)[:400])
    assert np.abs(held[:, None] - beside).min() * STEP_M > 0.5  # never touching
    assert any(note.startswith("trained on, as no other recording shows it within") for note in split.notes)
    assert any(note.endswith("or not shown by any") for note in split.notes)


def test_of_one_recording_a_stretch_that_was_visited_again_is_held_out():
    images = recorded(Poses.concatenate([corridor(0, 20), corridor(20, 0, y_m=0.2)]))  # forth, and back backwards
    split = hold_out(images, 0.1)
    held = np.flatnonzero(split.held_out_mask)
    assert 20 <= len(held) <= 60
    assert (np.diff(held) == 1).all()
    assert np.abs(held[:, None] - np.flatnonzero(trained(split))).min() > 3
    (other,) = np.nonzero(
        np.abs(images.poses.translation[held, :1] - images.poses.translation[:, 0]).min(axis=0) < 0.05
    )
    assert trained(split)[other].any()


@pytest.mark.parametrize("back", [corridor(20, 0, ahead=False), corridor(20, 0, z_m=3.0), corridor(60, 40)])
def test_of_ground_seen_once_or_the_other_way_round_the_middles_of_short_stretches_are_held_out(back):
    images = recorded(corridor(0, 20), back)
    split = hold_out(images, 0.1)
    held, learned = split.held_out_mask, trained(split)
    assert 0.05 * len(images) < held.sum() < 0.15 * len(images)
    for at in np.flatnonzero(held):
        assert not learned[max(at - 1, 0) : at + 2].any()  # nothing of nearly the same time
        for side in (learned[:at][::-1], learned[at:]):  # but what is there is shown before and after
            assert np.argmax(side) * STEP_M < 2.0
    (note,) = split.notes
    assert note.startswith(f"held out: the middles of short stretches, {held.sum()} images: ")
    last = int(np.flatnonzero(np.diff(held.astype(int), append=0) < 0)[0])  # of the first stretch
    assert f"{images.names[images.sequence[last]]}, images {int(np.argmax(held))} to {last}" in note
    assert "no pass leads over ground that another shows" in note


def test_of_a_few_images_nothing_is_held_out():
    split = hold_out(recorded(corridor(0, 3)), 0.1)
    assert trained(split).all()
    assert not split.held_out_mask.any()
    (note,) = split.notes
    assert note.startswith("nothing is held out")


def test_the_choice_does_not_depend_on_the_unit_of_length():
    images = stairwell(top=(0,))
    expected = hold_out(images, 0.2)
    for factor in (0.01, 30.0):
        larger = recorded(
            *(
                Poses(own.rotation, factor * own.translation)
                for own in (images.poses[np.flatnonzero(images.sequence == i)] for i in range(5))
            )
        )
        found = hold_out(larger, 0.2)
        np.testing.assert_array_equal(trained(found), trained(expected))
        np.testing.assert_array_equal(found.held_out_mask, expected.held_out_mask)


def test_a_camera_that_stands_is_no_other_pass():
    stand = Poses(np.tile(np.eye(3), (300, 1, 1)), np.zeros((300, 3)))
    split = hold_out(recorded(stand), 0.1)
    assert trained(split).all()


def test_given_images_outside_the_map_are_not_evaluated_on_and_told():
    training = stairwell(top=(), walks=3)
    held_out = stairwell(top=(0,), walks=1)
    split = within_map(training, held_out)
    np.testing.assert_array_equal(split.held_out_mask, np.arange(400) < 300)
    assert len(split.held_out) == 300
    (note,) = split.notes
    assert note.startswith("not evaluated on, as no training image is within ")
    assert note.endswith("45°: walk0, images 300 to 399")
    same = within_map(training, training)
    assert same.held_out_mask.all()
    assert same.notes == ()


def test_a_run_over_ground_that_training_images_do_not_show_is_told_so():
    training = stairwell(top=(), walks=3).poses
    told = describe_unshown(stairwell(walks=1).poses, training)
    assert told is not None
    assert told.startswith(
        "25% of the images were taken, by the smoothed trajectory, where no training image is within"
    )
    assert "images 300 to 399;" in told
    found = np.arange(400) < 300
    assert describe_unshown(stairwell(walks=1).poses, training, verified=found) == told
    found[300:395] = True  # landmarks verify 95 % of the very images
    assert describe_unshown(stairwell(walks=1).poses, training, verified=found) is None
    assert describe_unshown(training[np.arange(300)], training) is None
    back = corridor(10, 0, ahead=False)  # the same ground, but what was behind the camera is ahead
    assert describe_unshown(back, training) is not None


def test_ranges_of_images_that_are_left_out_are_counted():
    five = [slice(10 * i, 10 * i + 3) for i in range(5)]
    assert describe_runs(five[:2], np.arange(99)) == "0 to 2 and 10 to 12"
    assert describe_runs([slice(7, 8), slice(20, 22)], np.arange(99) - 5) == "2 and 15 to 16"
    assert describe_runs(five[:4], np.arange(99)) == "0 to 2, 10 to 12, 20 to 22 and 30 to 32"
    assert describe_runs(five, np.arange(99)).endswith("20 to 22 and 2 more ranges")


def test_what_held_out_images_are_worth_is_said():
    once, walks = recorded(corridor(0, 200)), stairwell()
    there_and_back = recorded(Poses.concatenate([corridor(0, 40), corridor(40, 0, y_m=0.2)]))
    worth = [hold_out(images, 0.15).evidence for images in (walks, there_and_back, once)]
    assert [each.split(":")[-1].strip() for each in worth] == [
        "they are of recordings that nothing else was learned from",
        "some evidence for another walk",
        "little evidence for another walk",
    ]
    assert within_map(walks, walks).evidence == "they are of the held-out data that were given"
    assert hold_out(recorded(corridor(0, 2)), 0.15).evidence == ""
