"""The directive `command-help`: what a command does and its options, from the parser that reads the command line.

    ```{command-help} vapor-track train
    ```

Nothing is written down twice: an option that is added, renamed or given another default is so on the page, too.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import cache
from typing import Any, NoReturn
from unittest.mock import patch

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from vapor import track
from vapor.benchmark import __main__ as benchmark
from vapor.commands import console
from vapor.commands.command_help import Command, Option, heading

PROGRAMS = {"vapor-track": track, "vapor-benchmark": benchmark}
"""Each with its `COMMANDS` and its `main`."""


@cache
def command(words: str) -> Command:
    """What the command line knows of a command.

    Args:
        words: Such as `vapor-track train`.
    """
    program, name = words.split()
    with patch.object(console, "show_help", _given):
        try:
            PROGRAMS[program].main([name, "--help"])
        except _Given as given:
            return given.command
    raise AssertionError(f"{words} shows no help")


class _Given(SystemExit):
    """Ends a command once it has told which options it has."""

    def __init__(self, command: Command) -> None:
        self.command = command


def _given(command: Command) -> NoReturn:
    raise _Given(command)


class CommandHelp(SphinxDirective):
    """What a command does, how it is called, and a section for each group of options; of a program, every command."""

    required_arguments = 1
    final_argument_whitespace = True

    def run(self) -> list[nodes.Node]:
        """What the directive stands for."""
        program, *name = self.arguments[0].split()
        if name:
            return self._parts(command(self.arguments[0]))
        words = {name: f"{program} {name}" for name in PROGRAMS[program].COMMANDS}
        return [self._section(name, each, self._parts(command(each))) for name, each in words.items()]

    def _parts(self, shown: Command) -> list[nodes.Node]:
        parts = self._parsed(shown.meaning)
        parts.append(nodes.literal_block("", shown.usage, language="text", classes=["usage"]))
        for name, (meaning, options) in shown.groups.items():
            entries = "\n".join([f"```{{program}} {shown.words}\n```\n", *map(_entry, options)])
            content = [*self._parsed(meaning), *self.parse_text_to_nodes(entries)]
            parts.append(self._section(heading(name), f"{shown.words} {name}", content))
        return parts

    def _parsed(self, text: str) -> list[nodes.Node]:
        return self.parse_text_to_nodes(_text(text)) if text else []

    def _section(self, heading: str, name: str, content: Sequence[nodes.Node]) -> nodes.section:
        title = nodes.literal("", heading) if heading.startswith("-") else nodes.Text(heading)
        section = nodes.section("", nodes.title("", "", title), *content, names=[nodes.fully_normalize_name(name)])
        self.state.document.note_implicit_target(section, section)
        return section


def _entry(option: Option) -> str:
    ending = " **Required.**" if option.required else f" *Default:* `{option.default}`" if option.default else ""
    return f"````{{option}} {option.title}\n\n{_text(option.help)}{ending}\n````\n"


def _text(text: str) -> str:
    """Text of a docstring as Markdown: names of options as code, and no other marks than backticks."""
    parts = re.split(r"(`[^`]+`)", text)
    return "".join(part if i % 2 else _marked(part) for i, part in enumerate(parts))


def _marked(text: str) -> str:
    text = re.sub(r"([\\*_<>\[\]{}$|#])", r"\\\1", text)
    return re.sub(r"(?<![\w-])--[a-z][\w.-]*\w", lambda found: f"`{found[0]}`", text)


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.add_directive("command-help", CommandHelp)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
