"""The directive `command-help`: what a command does and its options, from the parser that reads the command line.

    ```{command-help} vapor-track train
    ```

Nothing is written down twice: an option that is added, renamed or given another default is so on the page, too.
"""

from __future__ import annotations

import re
import warnings
from argparse import Action, ArgumentParser
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from inspect import cleandoc
from typing import Any, NoReturn
from unittest.mock import patch

import tyro
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from vapor import track
from vapor.benchmark import __main__ as benchmark

PROGRAMS = {"vapor-track": track, "vapor-benchmark": benchmark}
"""Each with its `COMMANDS` and its `main`."""


@dataclass(frozen=True)
class Option:
    """An option or an argument."""

    names: Sequence[str]
    """`--undistort` and `--no-undistort`; of an argument that has no name, nothing."""
    value: str
    """What it takes, such as PATH."""
    help: str
    default: str | None
    """As one would type it; None where it must be given, or where `help` says it."""
    required: bool


@dataclass(frozen=True)
class Command:
    """A command."""

    words: str
    """With its program, as one types it."""
    meaning: str
    groups: Mapping[str, tuple[str, Sequence[Option]]]
    """Name of a group of options, such as `localizer.gap` → what they are about, and the options."""

    @property
    def names(self) -> set[str]:
        """The names of all options."""
        return {name for _, options in self.groups.values() for option in options for name in option.names}


@cache
def command(words: str) -> Command:
    """What the command line knows of a command.

    Args:
        words: Such as `vapor-track train`.
    """
    program, name = words.split()
    with patch.object(tyro, "cli", _given):
        try:
            PROGRAMS[program].main([name, "--help"])
        except _Given as given:
            options, default = given.options, given.default
    with warnings.catch_warnings():  # no other function of tyro's gives options as data
        warnings.simplefilter("ignore", DeprecationWarning)
        parser = tyro.extras.get_parser(options, **default)
    return Command(words, cleandoc(options.__doc__ or ""), dict(_groups(parser)))


class _Given(SystemExit):
    """Ends a command once it has told which options it has."""

    def __init__(self, options: type, default: Mapping[str, Any]) -> None:
        self.options, self.default = options, default


def _given(options: type, *, prog: str, args: Sequence[str], **default: Any) -> NoReturn:
    raise _Given(options, default)


def _groups(parser: ArgumentParser) -> Iterator[tuple[str, tuple[str, Sequence[Option]]]]:
    for group in parser._action_groups:
        options = [_option(action) for action in group._group_actions if action.dest != "help"]
        if options:
            name = (group.title or "").removesuffix(" options")
            options.sort(key=lambda option: not option.required)
            yield name, (group.description or "", options)


def _option(action: Action) -> Option:
    text = " ".join((action.help or "").split())
    stated = re.fullmatch(r"(.*?) ?\((?:(required)|default: (.*?))\)", text)
    text, required, default = (stated[1], stated[2] is not None, stated[3]) if stated else (text, False, None)
    if "Default: " in text or default == "":
        default = None
    value = "" if action.nargs == 0 else re.sub(r"^\{None\}\|", "", str(action.metavar or ""))
    return Option(tuple(action.option_strings), value, text, default, required)


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
        parts.append(nodes.literal_block("", _usage(shown), language="text", classes=["usage"]))
        for name, (meaning, options) in shown.groups.items():
            entries = "\n".join([f"```{{program}} {shown.words}\n```\n", *map(_entry, options)])
            content = [*self._parsed(meaning), *self.parse_text_to_nodes(entries)]
            parts.append(self._section(_HEADINGS.get(name, f"--{name}.*"), f"{shown.words} {name}", content))
        return parts

    def _parsed(self, text: str) -> list[nodes.Node]:
        return self.parse_text_to_nodes(_text(text)) if text else []

    def _section(self, heading: str, name: str, content: Sequence[nodes.Node]) -> nodes.section:
        title = nodes.literal("", heading) if heading.startswith("-") else nodes.Text(heading)
        section = nodes.section("", nodes.title("", "", title), *content, names=[nodes.fully_normalize_name(name)])
        self.state.document.note_implicit_target(section, section)
        return section


class CommandList(SphinxDirective):
    """A list of all commands of `vapor-track`, each with what it does."""

    def run(self) -> list[nodes.Node]:
        """What the directive stands for."""
        entries = [f"[{name}](commands/{name}.md)\n: {meaning}\n" for name, meaning in track.COMMANDS.items()]
        return self.parse_text_to_nodes("\n".join(entries))


_HEADINGS = {"positional arguments": "Arguments", "options": "Options"}


def _usage(shown: Command) -> str:
    options = [option for _, group in shown.groups.values() for option in group]
    arguments = [option.value for option in options if not option.names]
    needed = [f"{option.names[0]} {option.value}" for option in options if option.names and option.required]
    return " ".join([shown.words, *arguments, *needed, "[OPTIONS]"])


def _entry(option: Option) -> str:
    names = [f"{name} {option.value}".strip() for name in option.names] or [option.value]
    ending = " **Required.**" if option.required else f" *Default:* `{option.default}`" if option.default else ""
    return f"````{{option}} {', '.join(names)}\n\n{_text(option.help)}{ending}\n````\n"


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
    app.add_directive("command-list", CommandList)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
