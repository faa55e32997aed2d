"""How messages list things, and what stays of long paths in them."""

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from filtering.errors import MAX_MESSAGE, VaporTrackError, counted, few, length_said, listed, shortened

_LONG = "no such thing, " * 25


def test_a_list_names_all_but_two_and_more_others():
    assert listed([], 2) == ""
    assert listed("a", 2) == "a"
    assert listed("ab", 2) == "a and b"
    assert listed("abc", 2) == "a, b and c"  # "1 more" would be no shorter
    assert listed("abcd", 2) == "a, b and 2 more"
    assert listed(range(9), 2, "; ", others="more ranges") == "0; 1; and 7 more ranges"
    assert few("abcd", 2) == ["a", "b", "2 more"]


def test_one_of_a_kind_is_no_plural():
    assert [counted(number, "image") for number in (0, 1, 2)] == ["0 images", "1 image", "2 images"]


@pytest.mark.parametrize(
    ("metres", "said"),
    [(0.00072, "0.72 mm"), (0.0099, "9.9 mm"), (0.00999, "1 cm"), (0.031, "3.1 cm"), (0.996, "1 m"), (1.24, "1.2 m")],
)
def test_a_length_is_said_in_its_unit(metres, said):
    assert length_said(metres) == said


@pytest.mark.parametrize(
    ("path", "kept"),
    [
        (
            "/home/someone/recordings/of-2026/ros_bags/t265_trimmed_locoffice.bag",
            ".../ros_bags/t265_trimmed_locoffice.bag",
        ),
        ("/home/someone/recordings/" + "long-name" * 5 + ".mcap", ".../" + "long-name" * 5 + ".mcap"),
        ("/home/someone/recordings/" + "long-name" * 5 + "/", ".../" + "long-name" * 5 + "/"),
        ("/home/someone/recordings/" + "y" * 60, ".../" + "y" * 60),
        ("/home/someone/recordings/" + "y" * 250 + ".mcap", ".../" + "y" * 250 + ".mcap"),
        ("/" + "y" * 60, "/" + "y" * 60),
        ("/short/path.bag", "/short/path.bag"),
    ],
)
def test_of_long_paths_in_long_messages_names_of_files_and_folders_stay_whole(path, kept):
    said = str(VaporTrackError(f"{path}: {_LONG}"))
    assert said.startswith(f"{kept}: no such")


@given(st.lists(st.text("/:;,.'\" yx`…", max_size=400), max_size=6).map(" ".join))
@example("/" * 80 + " " + "z " * 200)
@example(f"{'/' * 300} `vapor-track {'/' * 90}`: {_LONG}")
def test_any_message_can_be_printed_and_has_at_most_the_stated_length(message):
    assert len(str(VaporTrackError(message))) <= min(MAX_MESSAGE, max(len(message), 300))
    assert len(shortened(message, 60)) <= 60


def test_notices_shorten_long_paths_between_folders():
    folders = "/".join(f"folder-number-{i}" for i in range(20))
    said = shortened(f"left out: /{folders}/walk.mcap, {'as it is said here, ' * 10}")
    (path,) = [word for word in said.split() if "walk" in word]
    begin, end = path.split("…")
    assert f"/{folders}/".startswith(begin)
    assert begin.endswith("/")
    assert f"/{folders}/walk.mcap,".endswith(end)
    assert end.startswith("/")
    assert len(said) <= 300
