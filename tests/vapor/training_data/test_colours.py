"""Red and blue that are swapped, by the colours of other recordings."""

import numpy as np
import pytest

from vapor.training_data.checks import Colours, said_of_colours


def colours(seed: int, *, warmth: int = 30, swapped: bool = False) -> Colours:
    """Of images of warm or cold light, each recording a little different."""
    rng, found = np.random.default_rng(seed), Colours()
    for _ in range(20):
        grey = rng.integers(60, 180, (12, 16, 1))
        image = np.clip(grey + np.array([warmth, 0, -warmth]) + rng.integers(-20, 20, (12, 16, 3)), 0, 255)
        found.take(np.ascontiguousarray((image[..., ::-1] if swapped else image).astype(np.uint8)))
    return found


def test_of_alike_recordings_nothing_is_said():
    assert said_of_colours({name: colours(i) for i, name in enumerate("abc")}) == []
    assert said_of_colours({"a": colours(0)}) == []
    assert said_of_colours({"grey": colours(0, warmth=0), "warm": colours(1)}) == []


def test_the_one_whose_colours_are_swapped_is_named():
    (said,) = said_of_colours({name: colours(i, swapped=name == "b") for i, name in enumerate("abc")})
    assert said.startswith("b: red and blue are swapped, beside the other recordings (BGR")


def test_of_two_recordings_it_cannot_be_said_which():
    (said,) = said_of_colours({"a": colours(0), "b": colours(1, swapped=True)})
    assert said.startswith("a, b do not have the same colours: red and blue of some are swapped")


@pytest.mark.parametrize("count", [1, 3])
def test_where_all_are_bluish_it_is_asked(count):
    (said,) = said_of_colours({f"w{i}": colours(i, swapped=True) for i in range(count)})
    assert "more blue than red in nearly all images" in said
