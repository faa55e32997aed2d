"""What is said of images that could not be placed."""

import numpy as np
import pytest

from sequences.mapping.diagnosis import what_is_missing, why_no_model
from tests.helpers.mapped_walks import match, unplaced, walk_of

NEXT = [match(k, k + 1) for k in range(19)]


@pytest.mark.parametrize(
    ("found", "said"),
    [
        (unplaced(*NEXT, features=12), "20 of 20 images have hardly any features (median 12)"),
        (unplaced(), "hardly any two images show the same"),
        (unplaced(match(0, 1), match(1, 2)), "hardly any two images show the same"),
        (unplaced(*[match(k, k + 1, shift=0.001) for k in range(19)]), "the picture stands still"),
        (unplaced(*[match(k, k + 1, turned=True) for k in range(19)]), "the camera turned on the spot: in 100 %"),
        (unplaced(*NEXT), "no 10 images fit together"),
    ],
)
def test_the_likeliest_reason_is_named(found, said):
    assert why_no_model([walk_of("phone", 20)], found).startswith(said)


def missing(walks, placed, others=(), matches=()):
    return [*what_is_missing(walks, np.array(placed, bool), others, matches)]


def test_nothing_is_said_where_all_images_are_placed():
    matches = [match(k, k + 1) for k in range(39)]
    assert missing([walk_of("a", 20), walk_of("b", 20)], [1] * 40, matches=matches) == []


def test_images_that_are_not_placed_are_named_with_their_times():
    placed = [1] * 4 + [0] * 3 + [1] * 3
    walk, matches = walk_of("phone", 10), [match(k, k + 1) for k in range(9)]
    assert missing([walk], placed, matches=matches) == ["phone: 3 of 10 images are not placed: 1.0 s to 1.5 s"]
    numbered = walk_of("photos", 10, has_stamps=False)
    assert missing([numbered], placed, matches=matches) == ["photos: 3 of 10 images are not placed: image 4 to image 6"]


def test_a_walk_that_is_not_connected_is_named():
    walks, placed = [walk_of("a", 20), walk_of("b", 20)], [1] * 20 + [0] * 20
    within = [*(match(k, k + 1) for k in range(19)), *(match(k, k + 1) for k in range(20, 39))]
    (said,) = missing(walks, placed, matches=within)
    assert said.startswith("b: none of its 20 images is placed: nothing in it was recognised in the other walks")
    (said,) = missing(walks, placed, matches=[*within, match(3, 25)])
    assert said == "b: none of its 20 images is placed: too few pairs with placed images look alike: 1"


def test_a_cut_and_a_part_of_its_own_are_named():
    matches = [match(k, k + 1) for k in range(29) if k != 14]
    said = missing([walk_of("phone", 30)], [1] * 15 + [0] * 15, [range(15, 30)], matches)
    assert said == [
        "phone: 15 of 30 images are not placed: 3.8 s to 7.3 s",
        "phone: the images before and after 3.8 s show nothing in common: a cut, or too fast a turn",
        "15 images form a model of their own, which is left out: phone 3.8 s to 7.3 s; film the way from there to the"
        " rest, slowly",
    ]
