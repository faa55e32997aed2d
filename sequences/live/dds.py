"""Topics of ROS 2 by Cyclone DDS, without ROS; nodes of all distributions speak DDS.

Messages stay bytes, which are those of a recording: types are declared by name alone.
"""

from __future__ import annotations

import os
import re
import threading
import time
import weakref
from collections import defaultdict
from collections.abc import Callable
from functools import cache
from typing import Any
from weakref import WeakValueDictionary

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.core import DDSException, GuardCondition, InstanceState, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import make_idl_struct
from cyclonedds.idl.types import uint8
from cyclonedds.internal import InvalidSample
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from filtering.errors import VaporTrackError
from sequences.live.transport import DdsOptions, Offer, Publish
from sequences.recordings.source import RawMessage

_DEPTH, _LATCHED_DEPTH = 100, 1000  # messages kept for slow and for late subscribers
_IMAGE_DEPTH = 4
_AT_ONCE = 64
_LARGE = ("sensor_msgs/Image", "sensor_msgs/CompressedImage", "foxglove_msgs/CompressedVideo")
_MOST_PUBLISHERS = 10_000
_LONG_NS = 3600 * 10**9
_DOMAINS: WeakValueDictionary[int, Domain] = WeakValueDictionary()
_JOINING = threading.Lock()
_RELIABLE_S = 0.1  # that a publisher waits for a slow subscriber
_TYPE = "::msg::dds_::"
_NAME = re.compile(r"rt(/.+)")
_TYPE_NAME = re.compile(r"(\w+)::msg::dds_::(\w+)_")


class DdsTransport:
    """A participant of a ROS 2 system, see `Transport`."""

    def __init__(self, config: DdsOptions | None = None) -> None:
        """Join a system. Raises VaporTrackError where that is impossible."""
        self._config = config or DdsOptions()
        self.name = f"ROS domain {self._config.number}"
        try:
            self._domain = _domain(self._config)
            self._participant = DomainParticipant(self._config.number)
        except DDSException as error:
            raise VaporTrackError(f"{self.name} cannot be joined: {_reason(error)}") from error
        self._own = self._participant.guid
        publications = BuiltinDataReader(self._participant, BuiltinTopicDcpsPublication)
        self._publications = publications
        self._alive = ReadCondition(publications, ViewState.Any | SampleState.Any | InstanceState.Alive)
        self._topics: dict[tuple[str, str], Any] = {}
        self._readers: list[tuple[DataReader[Any], Offer, Callable[[RawMessage], None], ReadCondition]] = []
        self._writers: list[DataWriter[Any]] = []
        self._changed = GuardCondition(self._participant)
        self._waitset = WaitSet(self._participant)
        self._waitset.attach(self._changed)
        self._closed = False
        self._error: str | None = None
        self._thread = threading.Thread(target=self._work, name="dds", daemon=True)
        self._thread.start()

    def offers(self) -> list[Offer]:
        """See `Transport.offers`. Raises VaporTrackError once messages can no longer be received."""
        if self._error is not None:
            raise VaporTrackError(f"{self.name}: {self._error}")
        found: dict[tuple[str, str], list[tuple[bool, bool]]] = defaultdict(list)
        for endpoint in self._publications.read(_MOST_PUBLISHERS, self._alive):
            topic = _NAME.fullmatch(endpoint.topic_name or "")
            type_name = _TYPE_NAME.fullmatch(endpoint.type_name or "")
            if topic is None or type_name is None or endpoint.participant_key == self._own:
                continue
            reliable = endpoint.qos[Policy.Reliability] != Policy.Reliability.BestEffort
            latched = endpoint.qos[Policy.Durability] != Policy.Durability.Volatile
            found[topic[1], "/".join(type_name.groups())].append((reliable, latched))
        return [Offer(*names, *(all(each) for each in zip(*qos, strict=True))) for names, qos in sorted(found.items())]

    def subscribe(self, offer: Offer, deliver: Callable[[RawMessage], None]) -> None:
        """See `Transport.subscribe`: reliable where all publishers are; of images only where the options ask for it."""
        is_image = offer.type in _LARGE
        reliable = offer.reliable and (self._config.reliable or offer.latched or not is_image)
        qos = Qos(
            Policy.Reliability.Reliable(0) if reliable else Policy.Reliability.BestEffort,
            Policy.Durability.TransientLocal if offer.latched else Policy.Durability.Volatile,
            Policy.History.KeepLast(_IMAGE_DEPTH if is_image else _LATCHED_DEPTH if offer.latched else _DEPTH),
            _as_cdr(),
            Policy.IgnoreLocal.Participant,  # messages of this process, such as on /tf
        )
        for before in [each for each in self._readers if each[1].topic == offer.topic]:
            self._readers.remove(before)
            self._waitset.detach(before[3])
        reader = DataReader(self._participant, self._topic(offer.topic, offer.type), qos)
        coming = ReadCondition(reader, ViewState.Any | SampleState.Any | InstanceState.Any)
        self._waitset.attach(coming)
        self._readers.append((reader, offer, deliver, coming))
        self._changed.set(True)  # new conditions count from the next call of the waitset

    def advertise(self, topic: str, message_type: str, *, latched: bool = False) -> Publish:
        """See `Transport.advertise`."""
        declared = self._topic(topic, message_type)
        qos = Qos(
            Policy.Reliability.Reliable(duration(seconds=_RELIABLE_S)),
            Policy.Durability.TransientLocal if latched else Policy.Durability.Volatile,
            Policy.History.KeepLast(1 if latched else _DEPTH),
            _as_cdr(),
        )
        writer = DataWriter(self._participant, declared, qos)
        self._writers.append(writer)
        kept = weakref.ref(writer)

        def publish(data: bytes) -> None:
            if (open_writer := kept()) is None:
                raise VaporTrackError(f"{self.name} was left")
            try:
                open_writer.write(declared.data_type(data))
            except DDSException as error:
                raise VaporTrackError(_reason(error)) from error

        return publish

    def close(self) -> None:
        """See `Transport.close`."""
        if self._closed:
            return
        self._closed = True
        self._changed.set(True)
        self._thread.join()
        self._readers.clear()
        self._writers.clear()
        self._topics.clear()
        # An entity leaves when nothing refers to it any more; the participant takes with it what remains.
        del self._waitset, self._changed, self._alive, self._publications, self._participant, self._domain

    def _topic(self, topic: str, message_type: str) -> Any:
        if (topic, message_type) not in self._topics:
            package, _, name = message_type.partition("/")
            raw = _raw_type(f"{package}{_TYPE}{name}_")
            self._topics[topic, message_type] = Topic(self._participant, f"rt{topic}", raw)
        return self._topics[topic, message_type]

    def _work(self) -> None:
        try:
            self._listen()
        except DDSException as error:  # raised by the next call of `offers`
            self._error = _reason(error)

    def _listen(self) -> None:
        while not self._closed:
            self._waitset.wait(_LONG_NS)
            self._changed.set(False)
            for reader, offer, deliver, _ in list(self._readers):
                while not self._closed and (samples := reader.take(_AT_ONCE)):
                    now_ns = time.time_ns()
                    for number, sample in enumerate(samples):  # distinct times for messages that came together
                        if not isinstance(sample, InvalidSample):  # a publisher came or went
                            deliver(RawMessage(offer.topic, now_ns + number, sample.first, offer.type, "cdr", b""))
                    if len(samples) < _AT_ONCE:
                        break


def _domain(options: DdsOptions) -> Domain:
    """The domain, with the settings of the first participant of this process until the last one leaves."""
    number = options.number
    with _JOINING:
        if (domain := _DOMAINS.get(number)) is None:
            settings = ",".join(filter(None, [os.environ.get("CYCLONEDDS_URI"), options.xml]))
            domain = _DOMAINS[number] = Domain(number, settings)
    return domain


@cache
def _raw_type(name: str) -> Any:
    """A type of that name whose values are the bytes of messages.

    DDS checks only that they begin with the declared fields: one byte, which all messages have.
    """
    declared: Any = make_idl_struct("Raw", name, {"first": uint8})
    declared.serialize = lambda self, *_, **__: self.first
    declared.deserialize = classmethod(lambda cls, data, *_, **__: cls(data))  # pyright: ignore[reportCallIssue]
    declared.deserialize_key = declared.deserialize
    return declared


def _as_cdr() -> Any:
    """The encoding of ROS 2; by default DDS would accept another one, too."""
    return Policy.DataRepresentation(use_cdrv0_representation=True)


def _reason(error: Exception) -> str:
    return str(error).splitlines()[0].removeprefix("[DDSException] ")
