"""Options that have another name than before: the old one is still understood, and the new one told."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

RENAMED: Mapping[str, str] = MappingProxyType(
    {
        "--average": "--ema-decay",
        "--variants": "--ablations",
        "--evolve": "--ewta-fraction",
        "--half": "--store-float16",
        "--validation-share": "--validation-fraction",
        "--outlier-share": "--outlier-probability",
        "--possible-share": "--possible-fraction",
        "--lasting-share": "--lasting-fraction",
        "--constant-share": "--constant-fraction",
        "--converged-map-share": "--converged-map-fraction",
    }
)
"""Old name -> new name, as on the command line, without the prefix of a group such as `train.` and without `no-`.
They hold for all commands: a name that is free again may be given to another option once its row is gone."""


def with_new_names(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """The words of a command line with old names replaced, and a notice for each such name.

    Args:
        arguments: Words such as `--train.evolve`, `--evolve=0.4` or `--no-half`.
    """
    words, notices = [], []
    options = arguments[: arguments.index("--")] if "--" in arguments else arguments  # behind it, words are no options
    for word in options:
        old, equals, value = word.partition("=")
        new = _renamed(old)
        if new != old:
            notices.append(f"{old} is now {new}")
        words.append(new + equals + value)
    return [*words, *arguments[len(options) :]], list(dict.fromkeys(notices))


def _renamed(option: str) -> str:
    """The new name of an option where it has one; anything else as it is."""
    if not option.startswith("--"):
        return option
    group, dot, name = option[2:].rpartition(".")
    name = name.replace("_", "-")
    negated, name = name.startswith("no-"), name.removeprefix("no-")
    new = RENAMED.get(f"--{name}")
    if new is None:
        return option
    return f"--{group}{dot}{'no-' if negated else ''}{new.removeprefix('--')}"
