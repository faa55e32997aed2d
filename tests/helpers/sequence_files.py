"""A short walk with known poses, the forms in which it can lie on disk, and damaged copies."""

import struct
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer
from rosbags import rosbag1, rosbag2
from rosbags.rosbag2 import StoragePlugin
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from filtering.se3 import Poses
from sequences.frame import Camera
from sequences.writer import SequenceWriter

BEGIN_NS = 1_700_000_000_123_456_789
IMAGES, ODOMETRY, TRUTH = "/camera/image/compressed", "/odom", "/ground_truth/pose"
CAMERA = Camera(48, 32, 40.0, 41.0, 23.5, 15.5)
BASE_FROM_CAMERA = Poses.exp(np.array([0.3, -0.1, 0.5, -1.2, 1.1, -1.3]))
TWIST_COVARIANCE = np.diag([0.04, 0.01, 0.02, 0.001, 0.002, 0.003])


def world_from_base(times_ns: np.ndarray) -> Poses:
    """Where the robot is: it moves along all axes and turns about all of them."""
    t = (np.asarray(times_ns) - BEGIN_NS)[..., None] * 1e-9
    swing = 0.3 * np.sin(t * np.array([0.7, 1.1, 0.5]) + np.array([0.1, 0.2, 0.3]))
    return Poses.exp(np.concatenate([0.5 * t * np.array([1.0, 0.3, 0.05]), swing], axis=-1))


def world_from_camera(time_ns: int) -> Poses:
    return world_from_base(np.array(time_ns)) @ BASE_FROM_CAMERA


def picture(index: int) -> np.ndarray:
    image = np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8)
    image[...] = [40 + 5 * index, 200 - 5 * index, 90]
    return image


@dataclass
class Walk:
    """The content of a file: tests change it before they write it."""

    num_images: int = 12
    twist_covariance: np.ndarray = field(default_factory=lambda: TWIST_COVARIANCE)
    images: list[tuple[int, bytes]] = field(default_factory=list)
    odometry: list[tuple[int, Poses]] = field(default_factory=list)
    truth: list[tuple[int, Poses]] = field(default_factory=list)

    def __post_init__(self) -> None:
        for i in range(self.num_images):
            time_ns = BEGIN_NS + 100_000_000 * i
            self.images.append((time_ns, cv2.imencode(".png", picture(i % 12)[..., ::-1])[1].tobytes()))
            self.truth.append((time_ns, world_from_camera(time_ns)))
        # 50 Hz, between the images, from before the first to after the last one.
        times_ns = BEGIN_NS + 20_000_000 * np.arange(-2, 5 * self.num_images) + 7_000_000
        self.odometry = [(int(t), world_from_base(np.array(t))) for t in times_ns]

    def write(self, path: Path, metadata: dict[str, str] | None = None) -> Path:
        """Write in order of time, as a recorder does; odometry before the image it is due with."""
        events: list[tuple[int, int, Callable[[], None]]] = []
        with SequenceWriter(path, camera=CAMERA, base_from_camera=BASE_FROM_CAMERA, metadata=metadata or {}) as writer:
            for n, (t, pose) in enumerate(self.odometry):
                events.append((t, n, lambda t=t, p=pose: writer.write_odometry(t, p, self.twist_covariance)))
            for n, (t, pose) in enumerate(self.truth):
                events.append((t, n, lambda t=t, p=pose: writer.write_true_pose(t, p)))
            for n, (t, data) in enumerate(self.images):
                events.append((t, n, lambda t=t, d=data: writer.write_encoded_image(t, d, "png")))
            for _, _, write in sorted(events, key=lambda event: event[:2]):
                write()
        return path


def rewrite(
    source: Path,
    target: Path,
    *,
    keep: Callable[[str, int], bool] = lambda topic, time_ns: True,
    topic_names: dict[str, str] | None = None,
    data: Callable[[str, int, bytes], bytes] = lambda topic, time_ns, data: data,
    log_time: Callable[[str, int], int] = lambda topic, time_ns: time_ns,
    order: Callable[[str, int], int] | None = None,
    index_types: IndexType = IndexType.ALL,
    **options: object,
) -> Path:
    """Copy a file as another recorder might have written it, or as a damaged one, by log time or in another order."""
    with open(source, "rb") as stream, open(target, "wb") as out:
        settings = {"compression": CompressionType.NONE, "index_types": index_types, **options}
        writer = Writer(out, **settings)  # pyright: ignore[reportArgumentType]
        writer.start(profile="ros2")
        channels: dict[str, int] = {}
        messages = [each for each in make_reader(stream).iter_messages() if keep(each[1].topic, each[2].log_time)]
        placed = order or log_time
        for schema, channel, message in sorted(messages, key=lambda each: placed(each[1].topic, each[2].log_time)):
            assert schema is not None
            topic = (topic_names or {}).get(channel.topic, channel.topic)
            if topic not in channels:
                schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[topic] = writer.register_channel(topic, channel.message_encoding, schema_id)
            payload = data(channel.topic, message.log_time, message.data)
            time_ns = log_time(channel.topic, message.log_time)
            writer.add_message(channels[topic], time_ns, payload, time_ns)
        writer.finish()
    return target


def as_file(source: Path, folder: Path) -> Path:
    return rewrite(source, folder / "as_file.mcap", chunk_size=4000, compression=CompressionType.ZSTD)


def as_split_folder(source: Path, folder: Path, *, cut_s: float = 0.555) -> Path:
    """A rosbag2 folder of two files, cut where no image is, with the metadata.yaml that `ros2 bag record` writes."""
    bag = folder / "bag"
    bag.mkdir()
    cut_ns = BEGIN_NS + int(cut_s * 1e9)
    rewrite(source, bag / "bag_0.mcap", keep=lambda topic, time_ns: time_ns < cut_ns)
    rewrite(source, bag / "bag_1.mcap", keep=lambda topic, time_ns: time_ns >= cut_ns)
    write_listing(bag)
    return bag


def write_listing(bag: Path) -> Path:
    files, topics = sorted(bag.glob("*.mcap")), Counter[tuple[str, str]]()
    totals = []
    for file in files:
        with open(file, "rb") as stream:
            summary = make_reader(stream).get_summary()
        assert summary is not None
        assert summary.statistics is not None
        totals.append(summary.statistics.message_count)
        for id, count in summary.statistics.channel_message_counts.items():
            channel = summary.channels[id]
            topics[channel.topic, summary.schemas[channel.schema_id].name] += count
    lines = ["rosbag2_bagfile_information:", "  version: 5", "  storage_identifier: mcap"]
    lines += ["  duration:", "    nanoseconds: 1100000000", f"  message_count: {sum(totals)}"]
    lines += ["  topics_with_message_count:"]
    for (name, kind), count in topics.items():
        lines += ["    - topic_metadata:", f"        name: {name}", f"        type: {kind}"]
        lines += ["        serialization_format: cdr", '        offered_qos_profiles: "- history: 3\\n  depth: 0"']
        lines += [f"      message_count: {count}"]
    lines += ['  compression_format: ""', '  compression_mode: ""', "  relative_file_paths:"]
    lines += [f"    - {file.name}" for file in files]
    lines += ["  files:"]
    for file, total in zip(files, totals, strict=True):
        lines += [f"    - path: {file.name}", f"      message_count: {total}"]
    (bag / "metadata.yaml").write_text("".join(f"{line}\n" for line in lines))
    return bag / "metadata.yaml"


def as_file_without_index(source: Path, folder: Path) -> Path:
    left_out = ("repeat_channels", "repeat_schemas", "use_statistics", "use_summary_offsets")
    options = {"chunk_size": 4000, "index_types": IndexType.NONE, **dict.fromkeys(left_out, False)}
    return rewrite(source, folder / "without_index.mcap", **options)


def as_file_without_chunks(source: Path, folder: Path) -> Path:
    return rewrite(source, folder / "without_chunks.mcap", use_chunking=False)


def as_sqlite_folder(source: Path, folder: Path) -> Path:
    """A rosbag2 folder of SQLite storage, written by another library."""
    return _as_rosbag2(source, folder / "sqlite_bag", StoragePlugin.SQLITE3)


def as_packed_messages(source: Path, folder: Path) -> Path:
    """A rosbag2 folder of SQLite storage with every message packed by itself, written by another library."""
    return _as_rosbag2(source, folder / "packed_bag", StoragePlugin.SQLITE3, packed=True)


def _as_rosbag2(source: Path, target: Path, storage: StoragePlugin, *, packed: bool = False) -> Path:
    out = rosbag2.Writer(target, version=8, storage_plugin=storage)
    if packed:
        out.set_compression(rosbag2.CompressionMode.MESSAGE, rosbag2.CompressionFormat.ZSTD)
    _copy(source, out, get_typestore(Stores.ROS2_HUMBLE), lambda data, _: data)
    return target


def as_ros1_bag(source: Path, folder: Path) -> Path:
    """A ROS 1 bag in chunks packed by LZ4, written by another library."""
    types, types_of_ros1 = get_typestore(Stores.ROS2_HUMBLE), get_typestore(Stores.ROS1_NOETIC)
    types_of_ros1.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
    target = folder / "one.bag"
    out = rosbag1.Writer(target)
    out.set_compression(rosbag1.Writer.CompressionFormat.LZ4)
    _copy(source, out, types_of_ros1, types.cdr_to_ros1)
    return target


def _copy(source: Path, out: Any, types: Any, encoded: Callable[[Any, str], Any]) -> None:
    """Write the messages of a file by another library's writer, each as `encoded` makes it of data and type."""
    connections: dict[str, Any] = {}
    with open(source, "rb") as stream, out:
        for schema, channel, message in make_reader(stream).iter_messages():
            assert schema is not None
            if channel.topic not in connections:
                connections[channel.topic] = out.add_connection(channel.topic, schema.name, typestore=types)
            out.write(connections[channel.topic], message.log_time, encoded(message.data, schema.name))


FORMS = [
    *(as_file, as_split_folder, as_file_without_index, as_file_without_chunks),
    *(as_sqlite_folder, as_packed_messages, as_ros1_bag),
]
Form = Callable[[Path, Path], Path]


def close(a: Poses | None, b: Poses, tolerance: float = 1e-6) -> bool:
    return a is not None and bool(np.abs(a.as_matrix() - b.as_matrix()).max() < tolerance)


MS = 1_000_000


def relogged(walk: Path, target: Path, late_ns: Callable[[str, int], int]) -> Path:
    """A copy in which messages were logged late, by a function of topic and stamp."""
    return rewrite(walk, target, log_time=lambda topic, time_ns: time_ns + late_ns(topic, time_ns))


def stamped(walk: Path, target: Path, topics: Collection[str], stamp: Callable[[int], int]) -> Path:
    """A copy in which some topics have other stamps, logged when they were."""

    def change(topic: str, time_ns: int, data: bytes) -> bytes:
        if topic not in topics:
            return data
        return data[:4] + struct.pack("<II", *divmod(stamp(time_ns), 1_000_000_000)) + data[12:]

    return rewrite(walk, target, data=change)


def records(data: bytes | bytearray, start: int = 8, end: int | None = None) -> Iterator[tuple[int, int, int]]:
    """Opcode, place and length of each record, its head left out."""
    while start < (len(data) - 8 if end is None else end):
        opcode, length = struct.unpack_from("<BQ", data, start)
        yield opcode, start + 9, length
        start += 9 + length


def chunks(data: bytes | bytearray) -> list[tuple[int, int, int]]:
    """Place of each chunk, and of the records in it where they are not compressed, from and to."""
    places = [(place, length) for opcode, place, length in records(data) if opcode == Opcode.CHUNK]
    return [
        (place, place + length - struct.unpack_from("<Q", data, place + 32)[0], place + length)
        for place, length in places
    ]


def id_of(data: bytes, topic: str) -> int:
    return next(
        struct.unpack_from("<H", data, place)[0]
        for opcode, place, length in records(data)
        if opcode == Opcode.CHANNEL and topic.encode() in data[place : place + length]
    )


def damaged(source: Path, target: Path, change: Callable[[bytearray], None], **options: object) -> Path:
    """A copy without checksums of its index, with uncompressed chunks, changed in place."""
    data = bytearray(rewrite(source, target, enable_crcs=False, enable_data_crcs=False, **options).read_bytes())
    change(data)
    target.write_bytes(data)
    return target


def without_ten_images(data: bytearray) -> None:
    """Give ten records of images an unknown opcode."""
    lose_ten(data, chunks(data))


def lose_ten(data: bytearray, stretches: Iterable[tuple[int, int, int]]) -> None:
    images, left = id_of(data, IMAGES), 10
    for _, begin, end in stretches:
        for opcode, place, _ in records(data, begin, end):
            if opcode == Opcode.MESSAGE and struct.unpack_from("<H", data, place)[0] == images and left:
                data[place - 9], left = 0x90, left - 1
    assert left == 0
