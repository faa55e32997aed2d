"""What is measured: the list of measurements, and the result of each, both as data."""

from __future__ import annotations

import json
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

LIST, PAGE = "list.toml", "measurements.md"


@dataclass(frozen=True)
class Measurement:
    """An entry of the list.

    Attributes:
        name: Of its result and of the folder that it is measured in.
        part: Heading that it stands under.
        title: Its own heading.
        about: What is measured, on which data: synthetic, simulated or real.
        minutes: How long it takes on two cores, roughly.
        commands: Shell, run one after the other in its folder.
        table: What is taken from the files that these write, see `docs.measuring.tables`.
        note: What the figures show, and why they fall short.
    """

    name: str
    part: str
    title: str
    about: str
    minutes: int
    commands: list[str]
    table: list[dict[str, Any]]
    note: str = ""


@dataclass(frozen=True)
class Measurements:
    """All of them, and where they are: the folder of the documentation.

    Attributes:
        docs: Has `measurements/list.toml`, `measurements/NAME.json` for each that has been measured, and the page.
    """

    docs: Path

    @property
    def page(self) -> Path:
        """The page that is made from them."""
        return self.docs / PAGE

    @property
    def introduction(self) -> str:
        """How the page begins."""
        return self._list["introduction"]

    @property
    def entries(self) -> dict[str, Measurement]:
        """By name, in the order of the page."""
        return {entry["name"]: Measurement(**entry) for entry in self._list["measurement"]}

    @property
    def _list(self) -> dict[str, Any]:
        return tomllib.loads((self.docs / "measurements" / LIST).read_text(encoding="utf-8"))

    def result(self, name: str) -> dict[str, Any] | None:
        """What a measurement gave; None where there is nothing yet.

        JSON: `date`, `processor`, `commit` (of the code), `version`, `seconds`, `commands`, `tables` (see
        `docs.measuring.tables`).
        """
        file = self.docs / "measurements" / f"{name}.json"
        return json.loads(file.read_text(encoding="utf-8")) if file.exists() else None

    def keep(self, name: str, result: dict[str, Any]) -> None:
        """Write what a measurement gave, a row of a table a line."""
        file = self.docs / "measurements" / f"{name}.json"
        file.write_text(f"{_dumped(result)}\n", encoding="utf-8")

    @property
    def missing(self) -> list[str]:
        """Names of those without a result."""
        return [name for name in self.entries if self.result(name) is None]


def _dumped(value: Any, indent: int = 0) -> str:
    """JSON in which whatever fits stands in one line."""
    short = json.dumps(value, ensure_ascii=False)
    if not isinstance(value, dict | list) or len(short) + indent <= 120:
        return short
    inner, outer = " " * (indent + 1), " " * indent
    items = [
        f"{json.dumps(key, ensure_ascii=False)}: {_dumped(each, indent + 1)}"
        for key, each in (value.items() if isinstance(value, dict) else ())
    ] or [_dumped(each, indent + 1) for each in value]
    begin, end = "{}" if isinstance(value, dict) else "[]"
    return f"{begin}\n{inner}" + f",\n{inner}".join(items) + f"\n{outer}{end}"
