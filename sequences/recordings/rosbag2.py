"""The metadata.yaml of a rosbag2 folder: which files it lists, and how many messages it states that they have.

What it states of single files is left alone: recorders count there what their cache then drops, and `ros2 bag convert`
counted messages twice. Numbers of topics are of what was written.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from filtering.errors import quoted
from sequences.errors import SequenceError
from sequences.files import read_yaml, require_inside
from sequences.values import parse_whole

_MOST_MESSAGES = 10**18
_SUFFIXES = (".mcap", ".db3")
_PACKED = ".zstd"


@dataclass(frozen=True)
class Listing:
    """What a metadata.yaml says.

    Attributes:
        path: The metadata.yaml.
        files: The files that it lists, in order, MCAP or SQLite; all of them are there.
        unlisted: Names of such files that lie beside it, and that it does not list.
        num_messages: How many messages all topics have together; None where it states none, as after a crash.
        of_topics: How many each topic has, by name; empty where it states none.
    """

    path: Path
    files: list[Path]
    unlisted: list[str]
    num_messages: int | None
    of_topics: Counter[str]

    @property
    def notices(self) -> list[str]:
        """What a person should know of it."""
        if not self.unlisted:
            return []
        return [f"metadata.yaml does not list {self.unlisted_said}: not read"]

    @property
    def unlisted_said(self) -> str:
        """Names of files that it does not list, three of them at most."""
        others = f" and {len(self.unlisted) - 3} more" if len(self.unlisted) > 3 else ""
        return ", ".join(quoted(name) for name in self.unlisted[:3]) + others


def read_listing(folder: Path) -> Listing:
    """Read the metadata.yaml of a rosbag2 folder.

    Raises:
        SequenceError: there is none, it is no YAML, lists no file, or one that is not there, is of no known format or
            lies outside the folder, lists files in one place and not in the other, or a number in it is none.
    """
    if not folder.is_dir():
        raise SequenceError(
            f"{folder}: no such file or folder, expected an .mcap file, a rosbag2 folder or a ROS 1 bag"
        )
    path = folder / "metadata.yaml"
    if not path.is_file():
        helps = ", or its files one by one (`ros2 bag reindex` writes one)" if _bag_files(folder) else ""
        raise SequenceError(f"{folder}: folder has no metadata.yaml, expected an .mcap file or a rosbag2 folder{helps}")
    content = read_yaml(path)
    content = content.get("rosbag2_bagfile_information", content)
    names = list(dict.fromkeys(str(name) for name in _list(content, "relative_file_paths", path)))
    if not names:
        raise SequenceError(f"{path}: names no files, expected `relative_file_paths:` with one or more files")
    beside = {file.name for file in _bag_files(folder)}
    names = [name.removesuffix(_PACKED) if name.removesuffix(_PACKED) in beside else name for name in names]
    for name in names:
        if name.endswith(_PACKED):
            raise SequenceError(f"{path}: names {quoted(name)}, a file packed as a whole; unpack it first: `zstd -d`")
        if not name.endswith(_SUFFIXES):
            raise SequenceError(f"{path}: names {quoted(name)}, expected .mcap or .db3 files")
    listed = {Path(name).name for name in names}
    for item in _list(content, "files", path):
        name = Path(str(item.get("path", ""))).name if isinstance(item, dict) else ""
        name = name.removesuffix(_PACKED) if name.removesuffix(_PACKED) in listed else name
        if name.endswith(_SUFFIXES) and name not in listed:
            raise SequenceError(
                f"{path}: `files` has {quoted(name)} and `relative_file_paths` has not, expected it in both"
            )
    files = [folder / name for name in names]
    require_inside(folder, files)
    for file, name in zip(files, names, strict=True):
        if not file.is_file():
            raise SequenceError(f"{path}: names {quoted(name)}, which is not in the folder")
    read = {file.resolve() for file in files}
    unlisted = [file.name for file in _bag_files(folder) if file.resolve() not in read]
    return Listing(path, files, unlisted, _count(content, path) or None, _counts_of_topics(content, path))


def _bag_files(folder: Path) -> list[Path]:
    return sorted(file for file in folder.iterdir() if file.suffix in _SUFFIXES and file.is_file())


def _counts_of_topics(content: Any, path: Path) -> Counter[str]:
    """How many messages each topic has; nothing where none has any."""
    counts: Counter[str] = Counter()
    for item in _list(content, "topics_with_message_count", path):
        topic = item.get("topic_metadata") if isinstance(item, dict) else None
        if isinstance(topic, dict) and "name" in topic and (count := _count(item, path)) is not None:
            counts[str(topic["name"])] += count
    return counts if counts.total() else Counter()


def _list(content: Any, name: str, path: Path) -> list[Any]:
    value = content.get(name) if isinstance(content, dict) else None
    if not isinstance(value, list | None):
        raise SequenceError(f"{path}: `{name}` is {quoted(value)}, expected a list")
    return value or []


def _count(content: Any, path: Path) -> int | None:
    value = content.get("message_count") if isinstance(content, dict) else None
    return None if value is None else parse_whole(str(value), f"{path}: message_count", 0, _MOST_MESSAGES)
