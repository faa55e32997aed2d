"""ROS 2 messages of any type with random fields."""

from typing import Any

import numpy as np

from sequences.recordings.message_definitions import DEFINITIONS

_BELOW = {"bool": 2, "byte": 200, "uint8": 200, "int32": 2**31, "uint32": 2**32, "uint64": 2**63}


def made_up(message_type: str, rng: np.random.Generator) -> dict[str, Any]:
    """A message of a type, with texts of up to ten bytes and lists of up to three."""

    def one(kind: str) -> Any:
        if "/" in kind:
            return made_up(kind, rng)
        if kind == "string":
            return "ü" * int(rng.integers(2)) + "x" * int(rng.integers(9))
        return int(rng.integers(_BELOW[kind])) if kind in _BELOW else float(np.float32(rng.normal()))

    message: dict[str, Any] = {}
    for line in DEFINITIONS[message_type].splitlines():
        kind, name = line.split()
        base, _, length = kind.removesuffix("]").partition("[")
        many = [one(base) for _ in range(int(length or rng.integers(4)))]
        message[name] = one(base) if base == kind else bytes(many) if base == "uint8" else many
    return message
