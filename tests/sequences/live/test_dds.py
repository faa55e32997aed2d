"""Topics of ROS 2 by DDS: two participants on this machine."""

import os
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from filtering.errors import VaporTrackError
from sequences.errors import SequenceError
from sequences.live.transport import DdsOptions, Offer, Transport, join
from sequences.recordings.message_definitions import decoder, encoder
from sequences.recordings.source import RawMessage
from tests.helpers.checkout import CHECKOUT
from tests.helpers.live_system import free_domain
from tests.helpers.tf_files import MESSAGE_TYPES, made_up

pytest.importorskip("cyclonedds")

DOMAIN = free_domain()
UNDER = f"/test_{os.getpid()}"  # another worker may be in the same domain
CHATTER, TEXT = f"{UNDER}/chatter", "std_msgs/Header"
LONG_S, SHORT_S = 20.0, 0.15  # for what must come, and for what must not


@contextmanager
def joined(**options: Any) -> Iterator[Transport]:
    transport = join(DdsOptions(DOMAIN, localhost=True, **options))
    try:
        yield transport
    finally:
        transport.close()


@pytest.fixture
def talker() -> Iterator[Transport]:
    with joined() as transport:
        yield transport


@pytest.fixture
def listener(talker: Transport) -> Iterator[Transport]:
    with joined() as transport:
        yield transport


class Ear:
    """What is delivered, and what was."""

    def __init__(self) -> None:
        self._queue: queue.SimpleQueue[RawMessage] = queue.SimpleQueue()
        self.threads: set[threading.Thread] = set()

    def __call__(self, raw: RawMessage) -> None:
        self.threads.add(threading.current_thread())
        self._queue.put(raw)

    def next(self) -> RawMessage:
        return self._queue.get(timeout=LONG_S)

    def rest(self) -> list[RawMessage]:
        """All that is there now, or comes in a moment."""
        time.sleep(SHORT_S)
        return [self._queue.get() for _ in range(self._queue.qsize())]

    def hears(self, say: Callable[[], None]) -> RawMessage:
        """Say something again and again, until it is heard."""
        end_s = time.monotonic() + LONG_S
        while time.monotonic() < end_s:
            say()
            try:
                return self._queue.get(timeout=0.02)
            except queue.Empty:
                continue
        raise AssertionError("nothing was heard")


def offers_of(transport: Transport, number: int) -> list[Offer]:
    """What others offer of these tests, once it is so many topics."""
    end_s = time.monotonic() + LONG_S
    while len(found := [offer for offer in transport.offers() if offer.topic.startswith(UNDER)]) != number:
        assert time.monotonic() < end_s, found
        time.sleep(0.002)
    return found


def text(words: str) -> bytes:
    return encoder(TEXT)({"frame_id": words})


def words(raw: RawMessage) -> str:
    return decoder(TEXT)(raw.data).frame_id


# --- offers ---------------------------------------------------------------------------------------


def test_others_see_what_is_published_and_how_but_not_oneself(talker: Transport, listener: Transport) -> None:
    held = [
        talker.advertise(CHATTER, TEXT),
        talker.advertise(f"{UNDER}/image", "sensor_msgs/Image"),
        talker.advertise(f"{UNDER}/a/tf_static", "tf2_msgs/TFMessage", latched=True),
    ]
    assert offers_of(listener, 3) == [
        Offer(f"{UNDER}/a/tf_static", "tf2_msgs/TFMessage", reliable=True, latched=True),
        Offer(CHATTER, TEXT, reliable=True, latched=False),
        Offer(f"{UNDER}/image", "sensor_msgs/Image", reliable=True, latched=False),
    ]
    assert offers_of(talker, 0) == []
    assert talker.name == f"ROS domain {DOMAIN}"
    held.clear()
    talker.close()
    assert offers_of(listener, 0) == []


def test_of_several_publishers_what_all_of_them_do_is_seen(talker: Transport, listener: Transport) -> None:
    with joined() as third:
        held = [talker.advertise(CHATTER, TEXT, latched=True)]
        assert offers_of(listener, 1) == [Offer(CHATTER, TEXT, reliable=True, latched=True)]
        held += [third.advertise(CHATTER, TEXT), third.advertise(f"{CHATTER}2", TEXT)]
        assert Offer(CHATTER, TEXT, reliable=True, latched=False) in offers_of(listener, 2)
        held.append(third.advertise(CHATTER, "std_msgs/Empty"))
        assert {(offer.topic, offer.type) for offer in offers_of(listener, 3)} == {
            (CHATTER, TEXT),
            (CHATTER, "std_msgs/Empty"),
            (f"{CHATTER}2", TEXT),
        }


# --- messages -------------------------------------------------------------------------------------


def test_messages_of_every_type_arrive_byte_for_byte(talker: Transport) -> None:
    rng = np.random.default_rng(2)
    sent = {t: encoder(t)(made_up(t, rng)) for t in MESSAGE_TYPES}
    names = {t: f"{UNDER}/{t}" for t in MESSAGE_TYPES}
    said = {t: talker.advertise(names[t], t, latched=True) for t in sent}
    for message_type, data in sent.items():
        said[message_type](data)
    ear = Ear()
    with joined(reliable=True) as listener:  # images, too
        for offer in offers_of(listener, len(sent)):
            assert names[offer.type] == offer.topic
            listener.subscribe(offer, ear)
        heard = {raw.type: raw for raw in (ear.next() for _ in sent)}
    assert heard.keys() == sent.keys()
    for message_type, data in sent.items():
        raw = heard[message_type]
        assert raw.topic == names[message_type]
        assert raw.encoding == "cdr"
        assert raw.data == data.ljust(-(-len(data) // 4) * 4, b"\0")
        assert type(raw.data) is bytes
    assert len({len(data) % 4 for data in sent.values()}) == 4


def test_messages_arrive_in_their_order_and_are_timed_by_the_machine(talker: Transport, listener: Transport) -> None:
    say, ear = talker.advertise(CHATTER, TEXT), Ear()
    listener.subscribe(offers_of(listener, 1)[0], ear)
    ear.hears(lambda: say(text("begin")))
    begin_ns = time.time_ns()
    for n in range(50):
        say(text(f"message {n}"))
    heard = [ear.next()]
    while words(heard[-1]) != "message 49":
        heard.append(ear.next())
    assert [words(raw) for raw in heard if words(raw) != "begin"] == [f"message {n}" for n in range(50)]
    times = [raw.log_time_ns for raw in heard if words(raw) != "begin"]
    assert times == sorted(times)
    assert begin_ns <= times[0]
    assert times[-1] <= time.time_ns()
    assert len(ear.threads) == 1
    assert threading.current_thread() not in ear.threads


def test_of_a_latched_topic_a_late_subscriber_gets_the_last_message(talker: Transport) -> None:
    say = talker.advertise(CHATTER, TEXT, latched=True)
    for each in ("first", "second", "last"):
        say(text(each))
    ear = Ear()
    with joined() as late:
        late.subscribe(offers_of(late, 1)[0], ear)
        assert words(ear.next()) == "last"
        say(text("later"))
        assert [words(raw) for raw in [ear.next(), *ear.rest()]] == ["later"]


def test_what_one_publishes_oneself_one_does_not_hear(talker: Transport, listener: Transport) -> None:
    own, other, ear = listener.advertise(CHATTER, TEXT), talker.advertise(CHATTER, TEXT), Ear()
    listener.subscribe(offers_of(listener, 1)[0], ear)
    elsewhere = Ear()
    talker.subscribe(offers_of(talker, 1)[0], elsewhere)

    def say() -> None:
        own(text("own"))
        other(text("of the other"))

    assert words(ear.hears(say)) == "of the other"
    assert words(elsewhere.hears(say)) == "own"
    assert {words(raw) for raw in ear.rest()} <= {"of the other"}
    assert {words(raw) for raw in elsewhere.rest()} <= {"own"}


def test_a_second_subscription_of_a_topic_takes_the_place_of_the_first(talker: Transport, listener: Transport) -> None:
    say, first, second, beside = talker.advertise(CHATTER, TEXT), Ear(), Ear(), Ear()
    say_beside = talker.advertise(f"{CHATTER}2", TEXT)
    offer, offer_beside = offers_of(listener, 2)
    listener.subscribe(offer, first)
    listener.subscribe(offer_beside, beside)
    first.hears(lambda: say(text("to the first")))
    beside.hears(lambda: say_beside(text("beside")))
    first.rest()
    listener.subscribe(offer, second)
    second.hears(lambda: say(text("to the second")))
    assert {words(raw) for raw in first.rest()} <= {"to the first"}
    beside.rest()
    assert words(beside.hears(lambda: say_beside(text("still beside")))) == "still beside"


def test_who_publishes_may_leave_and_come_back(listener: Transport) -> None:
    """As a driver that is started again: what subscribed before it went away hears it again."""
    ear = Ear()
    for n in range(2):
        with joined() as driver:
            say = driver.advertise(CHATTER, TEXT)
            (offer,) = offers_of(listener, 1)
            if n == 0:
                listener.subscribe(offer, ear)
            assert words(ear.hears(lambda n=n, say=say: say(text(f"start {n}")))) == f"start {n}"
            ear.rest()
            del say
        assert offers_of(listener, 0) == []


def test_bytes_that_are_no_message_are_refused_and_others_go_on(talker: Transport, listener: Transport) -> None:
    say, ear = talker.advertise(CHATTER, TEXT), Ear()
    listener.subscribe(offers_of(listener, 1)[0], ear)
    for data in (b"", b"\0", b"\0\1\0", b"\0\1\0\0"):
        with pytest.raises(VaporTrackError):
            say(data)
    assert words(ear.hears(lambda: say(text("a message")))) == "a message"
    ear.rest()
    damaged = b"\0\1\0\0" + b"\xff" * 8
    assert ear.hears(lambda: say(damaged)).data == damaged  # whoever decodes it says so


_ECHO = """
import queue, sys, time
from sequences.live.transport import join
from sequences.live.transport import DdsOptions
topic, domain = sys.argv[1:]
transport, heard = join(DdsOptions(int(domain), localhost=True)), queue.SimpleQueue()
say = transport.advertise(topic, "std_msgs/Header")
while not (found := [offer for offer in transport.offers() if offer.topic == f"{topic}/asked"]):
    time.sleep(0.01)
transport.subscribe(found[0], heard.put)
while b"end" not in (data := heard.get().data):
    say(data)
del say
transport.close()
"""


def test_another_process_is_heard_and_hears(listener: Transport) -> None:
    """By the network: participants of one process need none."""
    ask, ear, long = listener.advertise(f"{CHATTER}/asked", TEXT, latched=True), Ear(), "x" * 300_000  # as an image
    child = subprocess.Popen([sys.executable, "-c", _ECHO, CHATTER, str(DOMAIN)], cwd=CHECKOUT)
    try:
        listener.subscribe(offers_of(listener, 1)[0], ear)
        raw = ear.hears(lambda: ask(text(long)))
        assert words(raw) == long
        assert raw.topic == CHATTER
        ask(text("end"))
        assert child.wait(LONG_S) == 0
        assert offers_of(listener, 0) == []
    finally:
        child.kill()
        child.wait()


# --- leaving, and joining again -------------------------------------------------------------------


def dds_threads() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name == "dds"]


def test_once_closed_nothing_is_delivered_and_the_domain_can_be_joined_again(talker: Transport) -> None:
    say, before, ear = talker.advertise(CHATTER, TEXT), len(dds_threads()), Ear()
    for n in range(3):
        with joined() as again:
            again.subscribe(offers_of(again, 1)[0], ear)
            assert words(ear.hears(lambda n=n: say(text(f"round {n}")))) == f"round {n}"
            again.close()  # and once more behind
        assert len(dds_threads()) == before
        ear.rest()
        say(text("to nobody"))
        assert ear.rest() == []


# --- options --------------------------------------------------------------------------------------


def test_settings_of_cyclonedds_that_are_damaged_are_an_error_that_names_the_domain(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for settings in ("<CycloneDDS><Domain><Unheard/></Domain></CycloneDDS>", "<CycloneDDS>", "file:///nowhere.xml"):
        monkeypatch.setenv("CYCLONEDDS_URI", settings)
        with pytest.raises(VaporTrackError, match=f"^ROS domain {DOMAIN} cannot be joined: "):
            join(DdsOptions(DOMAIN, localhost=True))
    monkeypatch.delenv("CYCLONEDDS_URI")
    join(DdsOptions(DOMAIN, localhost=True)).close()


def test_the_domain_is_that_of_the_environment_where_none_is_given(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(DOMAIN))
    assert DdsOptions().number == DOMAIN
    assert DdsOptions(domain=7).number == 7
    for nothing in ("", "0"):
        monkeypatch.setenv("ROS_DOMAIN_ID", nothing)
        assert DdsOptions().number == 0
    monkeypatch.delenv("ROS_DOMAIN_ID")
    assert DdsOptions().number == 0
    assert DdsOptions(domain=0).number == 0


@pytest.mark.parametrize(
    ("options", "environment", "said"),
    [
        ({"domain": 300}, None, "ROS domain is 300, expected 0 to 232"),
        ({"domain": -1}, None, "ROS domain is -1, expected 0 to 232"),
        ({}, "233", "ROS domain is 233, expected 0 to 232"),
        ({}, "x", "ROS_DOMAIN_ID is 'x', expected a number from 0 to 232"),
        ({}, "-3", "ROS_DOMAIN_ID is '-3', expected a number from 0 to 232"),
        ({"peer": ("robot.local", "a b")}, None, "peer is 'a b', expected an address of a machine"),
        ({"peer": ('"/><Peer address="evil',)}, None, "peer is .*, expected an address of a machine"),
        ({"peer": ("",)}, None, "peer is '', expected an address of a machine"),
    ],
)
def test_options_that_name_no_system_are_refused(
    options: dict[str, Any], environment: str | None, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    if environment is not None:
        monkeypatch.setenv("ROS_DOMAIN_ID", environment)
    with pytest.raises(VaporTrackError, match=f"^{said}$"):
        DdsOptions(**options)


def test_nodes_of_a_peer_are_found(talker: Transport) -> None:
    talker.close()
    with joined(peer=("127.0.0.1",)) as one, joined(peer=("127.0.0.1",)) as two:
        say, ear = one.advertise(CHATTER, TEXT), Ear()
        two.subscribe(offers_of(two, 1)[0], ear)
        assert words(ear.hears(lambda: say(text("found")))) == "found"


def test_without_cyclonedds_the_error_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "sequences.live.dds", raising=False)
    for name in [name for name in sys.modules if name.partition(".")[0] == "cyclonedds"]:
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(SequenceError, match=r"live topics need cyclonedds.*pip install vapor-track\[live\]"):
        join(DdsOptions(DOMAIN, localhost=True))
