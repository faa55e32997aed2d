"""Folders of rosbag2: links, and what the metadata.yaml states."""

import re
from pathlib import Path

import pytest
import yaml

from sequences.datasets.listing import list_images
from sequences.errors import SequenceError
from sequences.options import SequenceOptions
from sequences.reader import SequenceReader
from sequences.recordings.bag import Bag
from tests.helpers.sequence_files import IMAGES, as_file_without_index, as_split_folder


@pytest.mark.parametrize(
    "name", ["{outside}", "../outside.mcap", "inner/../../outside.mcap", "link.mcap", "a/link.mcap"]
)
def test_a_listing_that_leads_out_of_its_folder_is_refused(name: str, walk_file: Path, tmp_path: Path) -> None:
    outside = tmp_path / "outside.mcap"
    outside.write_bytes(walk_file.read_bytes())
    bag = tmp_path / "bag"
    (bag / "inner").mkdir(parents=True)
    (bag / "link.mcap").symlink_to(outside)
    (bag / "a").symlink_to(bag)
    (bag / "metadata.yaml").write_text(f"relative_file_paths:\n- {name.format(outside=outside)}\n")
    with pytest.raises(SequenceError, match="leads out of the folder"):
        Bag(bag)


def test_links_within_the_folder_and_to_it_are_followed(walk_file: Path, tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "a.mcap").write_bytes(walk_file.read_bytes())
    (bag / "b.mcap").symlink_to("a.mcap")
    (bag / "metadata.yaml").write_text("relative_file_paths:\n- b.mcap\n")
    (tmp_path / "elsewhere").symlink_to(bag)
    assert len(list(Bag(tmp_path / "elsewhere").messages([IMAGES]))) == 12


def images_of(bag: Path) -> tuple[int, list[str]]:
    """How many images are read of a folder, and the notices."""
    reader = SequenceReader(bag, SequenceOptions(ground_truth_topic=""), odometry="unread")
    return len(list(reader)), reader.notices


def test_a_folder_that_has_what_its_listing_states_is_read_without_a_word(walk_file: Path, tmp_path: Path) -> None:
    bag = as_split_folder(walk_file, tmp_path)
    assert images_of(bag) == (12, [])
    # As other tools write it: names sorted, messages of single files counted twice, as converting did.
    listing = bag / "metadata.yaml"
    content = yaml.safe_load(listing.read_text())
    for file in content["rosbag2_bagfile_information"]["files"]:
        file["message_count"] *= 2
    listing.write_text(yaml.safe_dump(content))
    assert images_of(bag) == (12, [])


def without(text: str, *lines: str) -> str:
    """A listing without some lines, which are all there."""
    left = text.splitlines()
    for line in lines:
        left.remove(line)
    return "".join(f"{line}\n" for line in left)


LISTED, IN_FILES = "    - bag_1.mcap", "    - path: bag_1.mcap"


def test_a_file_that_is_gone_from_the_listing_is_missed(walk_file: Path, tmp_path: Path) -> None:
    bag = as_split_folder(walk_file, tmp_path)
    listing = bag / "metadata.yaml"
    whole = listing.read_text()
    listing.write_text(without(whole, LISTED))
    with pytest.raises(SequenceError, match=r"`files` has 'bag_1\.mcap' and `relative_file_paths` has not"):
        images_of(bag)
    gone = without(whole.split("  files:")[0], LISTED)
    listing.write_text(gone)
    said = rf"metadata\.yaml: '{IMAGES}': the files that it lists have 6 messages, expected the 12 that it states"
    with pytest.raises(SequenceError, match=rf"{said}; beside them lies 'bag_1\.mcap'"):
        images_of(bag)
    listing.write_text(gone.replace(IMAGES, "/another"))  # the numbers of all topics remain
    with pytest.raises(SequenceError, match=r"all topics: the files that it lists have \d+ messages, expected the \d+"):
        images_of(bag)
    (bag / "bag_1.mcap").unlink()
    listing.write_text(gone)
    with pytest.raises(SequenceError, match=rf"{said} \(`ros2 bag reindex`"):
        images_of(bag)
    listing.write_text(whole)
    with pytest.raises(SequenceError, match=r"names 'bag_1\.mcap', which is not in the folder"):
        images_of(bag)


def test_more_images_than_the_listing_states_are_an_error_too(walk_file: Path, tmp_path: Path) -> None:
    bag = as_split_folder(walk_file, tmp_path)
    (bag / "bag_1.mcap").write_bytes(walk_file.read_bytes())
    with pytest.raises(SequenceError, match="have 18 messages, expected the 12 that it states"):
        images_of(bag)


def test_a_listing_that_states_no_numbers_is_read_with_a_notice(walk_file: Path, tmp_path: Path) -> None:
    bag = as_split_folder(walk_file, tmp_path)
    listing = bag / "metadata.yaml"
    whole = listing.read_text()
    told = "metadata.yaml states no number of messages: images in lost files go unnoticed"
    zeros = re.sub(r"message_count: \d+", "message_count: 0", whole)  # as of a recorder that was killed
    for text in (zeros, "relative_file_paths: [bag_0.mcap, bag_1.mcap]\n"):
        listing.write_text(text)
        assert images_of(bag) == (12, [told])
    listing.write_text("relative_file_paths:\n- bag_0.mcap\n")
    assert images_of(bag) == (6, [told, "metadata.yaml does not list 'bag_1.mcap': not read"])


def test_a_file_beside_is_named_where_nothing_is_missing(walk_file: Path, tmp_path: Path) -> None:
    bag = as_split_folder(walk_file, tmp_path)
    for name in ("copy.mcap", "d.mcap", "e.mcap", "f.mcap", "g.mcap"):
        (bag / name).write_bytes(walk_file.read_bytes())
    said = "metadata.yaml does not list 'copy.mcap', 'd.mcap', 'e.mcap' and 2 more: not read"
    assert images_of(bag) == (12, [said])


def test_numbers_of_the_listing_speak_for_files_that_state_none(walk_file: Path, tmp_path: Path) -> None:
    bag = as_split_folder(walk_file, tmp_path)
    as_file_without_index(bag / "bag_1.mcap", tmp_path).replace(bag / "bag_1.mcap")
    assert images_of(bag) == (12, [])


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ("message_count: 12", "message_count: many", "message_count: 'many', expected a whole number"),
        ("message_count: 12", "message_count: -1", "message_count: '-1', expected a whole number"),
        (
            "  relative_file_paths:\n",
            "  relative_file_paths: 7\n  others:\n",
            "`relative_file_paths` is 7, expected a list",
        ),
        ("  version: 5", "  version: [5", "expected YAML"),
    ],
)
def test_a_damaged_listing_is_named(before: str, after: str, said: str, walk_file: Path, tmp_path: Path) -> None:
    listing = as_split_folder(walk_file, tmp_path) / "metadata.yaml"
    listing.write_text(listing.read_text().replace(before, after))
    with pytest.raises(SequenceError, match=rf"metadata\.yaml: .*{re.escape(said)}"):
        Bag(listing.parent)


def test_the_folder_of_a_recorder_that_was_killed_says_how_it_is_read(walk_file: Path, tmp_path: Path) -> None:
    bag = as_split_folder(walk_file, tmp_path)
    (bag / "metadata.yaml").unlink()
    with pytest.raises(SequenceError, match=r"no metadata\.yaml, .*one by one \(`ros2 bag reindex` writes one\)"):
        Bag(bag)
    named = ", ".join(sorted(file.name for file in bag.glob("*.mcap"))).replace(", ", " and ")
    with pytest.raises(SequenceError, match=rf"expected what is in it: {named} \(.*`ros2 bag reindex` writes"):
        list_images(bag)
    assert sum(images_of(file)[0] for file in bag.glob("*.mcap")) == 12
