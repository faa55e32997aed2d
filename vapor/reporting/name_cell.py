"""Names of files and recordings in printed tables."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions, RenderResult
    from rich.measure import Measurement


@dataclass(frozen=True)
class WholeWords:
    """A name as a cell of a table, in lines that end behind its separators; longer words alone are folded."""

    name: str

    def __str__(self) -> str:
        return self.name

    def lines(self, width: int) -> list[str]:
        """The name in lines of at most so many characters, as far as its words allow."""
        lines = [""]
        for word in self._words:
            if lines[-1] and len(lines[-1]) + len(word) > width:
                lines.append("")
            lines[-1] += word
        return lines

    @property
    def _words(self) -> list[str]:
        return re.findall(r"[^/_ -]*[/_ -]+|[^/_ -]+", self.name)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """What Rich prints."""
        from rich.text import Text

        yield Text("\n".join(self.lines(options.max_width)), overflow="fold")

    def __rich_measure__(self, console: Console, options: ConsoleOptions) -> Measurement:
        """The least and the usual width."""
        from rich.measure import Measurement

        least = max(map(len, self._words), default=0)
        return Measurement(least, len(self.name)).with_maximum(options.max_width)
