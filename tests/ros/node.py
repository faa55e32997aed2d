"""A real ROS 2 node, run by the Python of a ROS environment: publishes messages on time, and keeps what it hears.

VENV/bin/python node.py SCRIPT.pickle HEARD.pickle

The script says what to publish (topic, type, latched, at_s, data), which topics to hear (topic: type), and how long to
listen on. With a `gate` the first image, and all else of the time, is published once those topics that it `needs` have
subscribers; the others follow when something was heard on the gate. What is heard: (topic, monotonic seconds, bytes);
what was sent: (index, monotonic seconds). With a gate an image is published when the one before was answered on it.
"""

import importlib
import pickle
import sys
import time
from pathlib import Path

import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy


def class_of(name):
    package, _, kind = name.partition("/")
    return getattr(importlib.import_module(f"{package}.msg"), kind)


def answered(script, sent, heard, spin_once):
    """Wait until the image before is answered, however slow the machine is; returns how long that took, seconds."""
    image = max((i for i, _ in sent if script["publish"][i]["topic"] == script["image"]), default=None)
    begin_s = time.monotonic()
    while image is not None and time.monotonic() < begin_s + 10.0:
        stamp = script["publish"][image]["data"][4:12]  # of the header, behind what says how it is serialized
        if any(topic == script["gate"] and data[4:12] == stamp for topic, _, data in heard):
            break
        spin_once()
    return time.monotonic() - begin_s


def main():
    script = pickle.loads(Path(sys.argv[1]).read_bytes())
    rclpy.init()
    node = rclpy.create_node("tester")
    heard, sent, publishers = [], [], {}
    for each in script["publish"]:
        if each["topic"] not in publishers:
            durability = DurabilityPolicy.TRANSIENT_LOCAL if each["latched"] else DurabilityPolicy.VOLATILE
            reliability = ReliabilityPolicy[each.get("reliability", "RELIABLE")]
            qos = QoSProfile(depth=100, durability=durability, reliability=reliability)
            publishers[each["topic"]] = node.create_publisher(class_of(each["type"]), each["topic"], qos)

    def listen(topic, kind):
        def hear(data):
            heard.append((topic, time.monotonic(), bytes(data)))

        node.create_subscription(class_of(kind), topic, hear, QoSProfile(depth=1000), raw=True)

    for topic, kind in script["listen"].items():
        listen(topic, kind)

    def spin(until_s):
        while (left_s := until_s - time.monotonic()) > 0:
            rclpy.spin_once(node, timeout_sec=min(left_s, 0.05))

    def publish(index):
        each = script["publish"][index]
        sent.append((index, time.monotonic()))
        publishers[each["topic"]].publish(each["data"])

    first = {}
    for index, each in enumerate(script["publish"]):
        first.setdefault(each["topic"], index)
    deadline_s = time.monotonic() + script.get("patience_s", 30.0)
    if script.get("gate"):
        until_ns = script["publish"][first[script["image"]]]["at_s"] + 0.06  # of odometry, which images wait for
        early = [i for i, each in enumerate(script["publish"]) if each["at_s"] <= until_ns]
        early = [i for i in early if script["publish"][i]["topic"] != script["image"] or i == first[script["image"]]]
        for index in (first[topic] for topic in first if script["publish"][first[topic]]["latched"]):
            publish(index)
        while not any(topic == script["gate"] for topic, _, _ in heard) and time.monotonic() < deadline_s:
            if all(publishers[topic].get_subscription_count() for topic in script["needs"]):
                for index in early:
                    if index not in dict(sent):
                        publish(index)
            rclpy.spin_once(node, timeout_sec=0.02)
        done = dict(sent)
    else:
        done = {}
    begin_s = time.monotonic() - (script["publish"][max(done)]["at_s"] if done else 0.0)
    for index, each in enumerate(script["publish"]):
        if index in done:
            continue
        spin(begin_s + each["at_s"])
        if script.get("gate") and each["topic"] == script["image"]:
            begin_s += answered(script, sent, heard, lambda: rclpy.spin_once(node, timeout_sec=0.02))
        publish(index)
    spin(time.monotonic() + script.get("listen_on_s", 2.0))
    Path(sys.argv[2]).write_bytes(pickle.dumps({"heard": heard, "sent": sent}))
    node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main()
