"""What Foxglove gets: the server, by a client of the standard library, and the layout that ships."""

import json
import re
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vapor.robot
from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from sequences.recordings.bag import Bag
from sequences.recordings.estimate_messages import EstimateWriter, estimate_messages
from sequences.recordings.mcap_writer import ros_transform
from sequences.recordings.message_definitions import decoder, encoder, schema_name, schema_text
from sequences.recordings.source import RawMessage
from tests.helpers.checkout import CHECKOUT
from tests.helpers.fake_transport import FakeTransport
from tests.helpers.foxglove_client import FoxgloveClient
from vapor.robot.config import LiveConfig
from vapor.robot.live import live
from vapor.robot.viewers import FoxgloveServer

pytest.importorskip("foxglove", reason="needs foxglove-sdk")
LAYOUT = Path(vapor.robot.__file__).parent / "foxglove_layout.json"
TIME_NS = 1_700_000_000_123_456_789
PANELS = {"3D": "ThreeDee", "Image": "Image", "DiagnosticSummary": "DiagnosticsSummary"}
PANELS |= {"DiagnosticStatusPanel": "DiagnosticsDetail"}
ONLY_IN_FILES = {"foxglovePanelTitle", "collapsedSections"}  # of a panel's settings, beside those of the SDK
OF_THE_ROBOT = {"/camera/image/compressed"}  # which may call it otherwise


@pytest.fixture
def server() -> Iterator[FoxgloveServer]:
    with FoxgloveServer("127.0.0.1", 0) as server:
        yield server


@pytest.fixture
def taken_port() -> Iterator[int]:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        yield taken.getsockname()[1]


@pytest.fixture(scope="module")
def layout() -> dict[str, Any]:
    return json.loads(LAYOUT.read_text())


def particles() -> RawMessage:
    """Particles as `live` sends them."""
    rng = np.random.default_rng(0)
    cloud = Poses(np.tile(np.eye(3), (500, 1, 1)), rng.normal(size=(500, 3)))
    (message,) = (m for m in estimate_messages(TIME_NS, [], cloud) if m.topic == "/estimate/particles")
    data = encoder(message.type)(message.fields)
    return RawMessage(message.topic, TIME_NS + 5, data, message.type, "cdr", b"")


# --- the server ---------------------------------------------------------------------------------------


def test_a_message_is_served_as_its_bytes(server: FoxgloveServer) -> None:
    raw = particles()
    server.write(raw)
    with FoxgloveClient(server.port) as client:
        client.wait_for("/estimate/particles")
        channel = client.channels["/estimate/particles"]
        assert channel["encoding"] == "cdr"
        assert channel["schemaName"] == schema_name(raw.type) == "geometry_msgs/msg/PoseArray"
        assert channel["schemaEncoding"] == "ros2msg"
        assert channel["schema"] == schema_text(raw.type)
        client.subscribe("/estimate/particles")
        served = client.message(lambda: server.write(raw))
    assert served.data == raw.data
    assert served.log_time_ns == raw.log_time_ns
    assert len(decoder(raw.type)(served.data).poses) == 500


def test_a_topic_that_comes_later_is_offered_to_those_who_are_there(server: FoxgloveServer) -> None:
    with FoxgloveClient(server.port) as client:
        server.write(particles())
        client.wait_for("/estimate/particles")


def test_a_type_that_is_unknown_is_not_offered(server: FoxgloveServer) -> None:
    server.write(RawMessage("/other", TIME_NS, b"\0\1\0\0", "other_msgs/Thing", "cdr", b""))
    server.write(particles())
    with FoxgloveClient(server.port) as client:
        client.wait_for("/estimate/particles")
        assert "/other" not in client.channels


def test_one_who_vanishes_leaves_the_others_be(server: FoxgloveServer) -> None:
    raw = particles()
    server.write(raw)
    with FoxgloveClient(server.port) as stays, FoxgloveClient(server.port) as goes:
        for client in (stays, goes):
            client.wait_for("/estimate/particles")
            client.subscribe("/estimate/particles")
            client.message(lambda: server.write(raw))
        goes.vanish()
        assert stays.message(lambda: server.write(raw)).data == raw.data


def test_one_who_does_not_read_holds_up_nobody(server: FoxgloveServer) -> None:
    fields = {
        "header": {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "camera"},
        "format": "jpeg",
        "data": bytes(2_000_000),
    }
    data = encoder("sensor_msgs/CompressedImage")(fields)
    raw = RawMessage("/camera/image/compressed", TIME_NS, data, "sensor_msgs/CompressedImage", "cdr", b"")
    server.write(raw)
    with FoxgloveClient(server.port) as client:
        client.wait_for(raw.topic)
        client.subscribe(raw.topic)
        client.message(lambda: server.write(raw))
        begin_s = time.monotonic()
        for _ in range(100):
            server.write(raw)
        assert time.monotonic() - begin_s < 5.0


def test_when_it_has_stopped_its_port_is_soon_free() -> None:
    with FoxgloveServer("127.0.0.1", 0) as server:
        port = server.port
    end_s = time.monotonic() + 3.0
    while True:
        with suppress(VaporTrackError), FoxgloveServer("127.0.0.1", port) as again:
            assert again.port == port
            return
        assert time.monotonic() < end_s


def test_what_is_said_only_once_is_told_to_those_who_come_late() -> None:
    kind, pose = "tf2_msgs/TFMessage", np.array([0.0, 0, 0, 0, 0, 0, 1])
    raws = [
        RawMessage(
            "/tf_static",
            at,
            encoder(kind)({"transforms": [ros_transform(at, "base_link", child, pose)]}),
            kind,
            "cdr",
            b"",
        )
        for at, child in ((5, "camera"), (6, "lidar"))
    ]
    with FoxgloveServer("127.0.0.1", 0) as server:
        for raw in [*raws, *raws]:
            server.write(raw)
        with FoxgloveClient(server.port) as client:
            client.wait_for("/tf_static")
            client.subscribe("/tf_static")
            heard = [client.message(lambda: None, 3.0) for _ in raws]
    assert [message.data for message in heard] == [raw.data for raw in raws]


def test_a_port_in_use_is_named(taken_port: int) -> None:
    with pytest.raises(VaporTrackError, match=f"port {taken_port} of 127.0.0.1 .*in use.*--foxglove-port"):
        FoxgloveServer("127.0.0.1", taken_port)


@pytest.mark.parametrize("host", ["not a host", "192.0.2.1"])
def test_a_host_that_is_not_of_this_machine_is_named(host: str) -> None:
    with pytest.raises(VaporTrackError, match=f"port 8765 of {re.escape(host)} cannot be opened for Foxglove"):
        FoxgloveServer(host, 8765)


def test_without_foxglove_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "foxglove", None)
    with pytest.raises(VaporTrackError, match=r"foxglove-sdk is not installed.*vapor-track\[live\]"):
        FoxgloveServer("127.0.0.1", 0)


def test_clients_that_break_off_print_nothing() -> None:
    script = """
import socket, time
from tests.helpers.foxglove_client import FoxgloveClient
from vapor.robot.viewers import FoxgloveServer
with FoxgloveServer("127.0.0.1", 0) as server:
    FoxgloveClient(server.port).vanish()
    with socket.create_connection(("127.0.0.1", server.port)) as other:
        other.sendall(b"no HTTP\\r\\n\\r\\n")
    time.sleep(0.5)
"""
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=CHECKOUT, capture_output=True, text=True, check=True, timeout=60
    )
    assert done.stdout + done.stderr == ""


# --- the layout ---------------------------------------------------------------------------------------


def topics_of(settings: object, key: str = "") -> Iterator[str]:
    """Everything that begins as a topic does."""
    if isinstance(settings, dict):
        for name, value in settings.items():
            yield from topics_of(name)
            yield from topics_of(value, name)
    elif isinstance(settings, list):
        for value in settings:
            yield from topics_of(value, key)
    elif isinstance(settings, str) and settings.startswith("/"):
        yield settings


def panels_of(node: str | dict[str, Any]) -> list[str]:
    return [node] if isinstance(node, str) else [*panels_of(node["first"]), *panels_of(node["second"])]


def known(kind: Any, settings: dict[str, Any]) -> Any:
    """The SDK's object of some settings; it refuses a name that it does not know."""
    names = {re.sub("[A-Z]", lambda m: "_" + m[0].lower(), name): value for name, value in settings.items()}
    return kind(**names)


def test_the_layout_is_as_the_app_exports_them(layout: dict[str, Any]) -> None:
    assert {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"} == layout.keys()
    assert sorted(panels_of(layout["layout"])) == sorted(layout["configById"])
    assert [name.split("!")[0] for name in panels_of(layout["layout"])] == list(PANELS)


def test_settings_of_panels_are_those_that_foxglove_knows(layout: dict[str, Any]) -> None:
    fl = pytest.importorskip("foxglove.layouts")
    for name, settings in layout["configById"].items():
        kind = PANELS[name.split("!")[0]]
        config = {key: value for key, value in settings.items() if key not in ONLY_IN_FILES}
        known(getattr(fl, f"{kind}Config"), config)
    panel = layout["configById"]["3D!belief1"]
    known(fl.ThreeDeeCameraState, panel["cameraState"])
    known(fl.ThreeDeePublishSettings, panel["publish"])
    known(fl.BaseRendererTransforms, panel["scene"]["transforms"])
    known(fl.ImageModeConfig, layout["configById"]["Image!camera1"]["imageMode"])
    grid = {key: value for key, value in panel["layers"]["grid"].items() if key != "layerId"}
    known(fl.BaseRendererGridLayerSettings, grid)
    topics = panel["topics"]
    known(fl.BaseRendererRosMarkerTopicSettings, topics["/estimate/modes"])
    known(fl.BaseRendererPosesTopicSettings, topics["/estimate/particles"])
    known(fl.BaseRendererPoseTopicSettings, topics["/estimate/pose"])
    known(fl.BaseRendererPoseTopicSettings, topics["/estimate/base_pose"])


def test_topics_of_the_layout_are_those_of_live(layout: dict[str, Any], tiny_model: Path) -> None:
    system = FakeTransport()
    localization = live(str(tiny_model), LiveConfig(), system=system)
    localization.stop()
    localization.run()
    heard = {offer.topic for offer in system.subscribed}
    shown = {*topics_of(layout)}
    assert shown <= system.advertised.keys() | heard | OF_THE_ROBOT
    assert system.advertised.keys() - shown == {"/tf"}  # which needs no setting
    panel = layout["configById"]["3D!belief1"]
    assert panel["fixedFrame"] == panel["followTf"] == LiveConfig().map_frame
    assert heard & shown == {"/initialpose"}


def test_topics_of_the_layout_are_those_of_a_run(layout: dict[str, Any], tmp_path: Path) -> None:
    with EstimateWriter(tmp_path / "estimate.mcap") as writer:
        writer.write(0, [(Poses.identity(), np.eye(6), 1.0)], Poses.identity(3))
    written = {*Bag(tmp_path / "estimate.mcap").topics}
    assert written - {"/tf"} <= {*topics_of(layout)}
