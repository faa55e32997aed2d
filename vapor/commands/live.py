"""`vapor-track live`."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Annotated

import tyro

from sequences.live.transport import DdsOptions
from sequences.options import ReadingOptions
from vapor.commands.console import parse, show, show_skipped
from vapor.commands.model_name import ModelName
from vapor.commands.terminal import flush_output
from vapor.robot.config import LiveConfig
from vapor.robot.live import live


@dataclass(frozen=True)
class Options:
    """Localize a robot from its ROS 2 topics while it moves; publish its pose, tf and diagnostics until Ctrl-C."""

    model: ModelName
    """Name of a model that ships with the package, or model file."""
    system: Annotated[DdsOptions, tyro.conf.arg(name="")] = field(default_factory=DdsOptions)
    reading: Annotated[ReadingOptions, tyro.conf.arg(name="")] = field(default_factory=ReadingOptions)
    config: Annotated[LiveConfig, tyro.conf.arg(name="")] = field(default_factory=LiveConfig)


def main(arguments: Sequence[str]) -> None:
    """Run the command with the words after `live`."""
    options = parse("live", Options, arguments)
    localization = live(options.model, options.config, system=options.system, reading=options.reading, notify=_print)
    begin_s = time.monotonic()
    with suppress(KeyboardInterrupt):  # by which a robot's localization ends
        localization.run()
    show(f"{localization.localized} images localized in {time.monotonic() - begin_s:.0f} s")
    show_skipped(localization.skipped)


def _print(line: str) -> None:
    show(f"{time.strftime('%H:%M:%S')} {line}")
    flush_output()
