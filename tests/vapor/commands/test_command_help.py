"""Help on a command: whole paragraphs, what a newcomer needs first, and nothing of how the parser sees options."""

import re
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Annotated, Literal

import pytest
import tyro

from vapor.commands.command_help import Command


@dataclass(frozen=True)
class Reading:
    """What to read."""

    topic: str | None = None
    """A topic. Default: the only one."""


@dataclass(frozen=True)
class Options:
    """Do something."""

    data: Annotated[tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="DATA ...")]
    """Files."""
    reading: Annotated[Reading, tyro.conf.arg(name="")] = field(default_factory=Reading)
    way: Literal["up", "down"] | None = None
    """Where to: a sentence that is longer than one line of the source code, so that it goes on in the next line of
    it. (In brackets.)"""
    pose: tuple[float, float] | None = None
    """A pair, with 100 %."""
    fast: bool = True
    """Whether it is fast."""
    long_s: float = 1e9
    """A long time."""
    output: str = field(kw_only=True)
    """Where to write."""


@pytest.fixture(scope="module")
def shown() -> Command:
    return Command.of("program do", Options)


def test_values_and_defaults_are_as_one_would_type_them(shown):
    options = {each.title: each.default for _, group in shown.groups.values() for each in group}
    assert options == {
        "DATA ...": None,
        "--output STR": None,
        "--topic STR": None,
        "--way {up,down}": None,
        "--pose FLOAT FLOAT": None,
        "--fast, --no-fast": "--fast",
        "--long-s FLOAT": "1e+09",
    }
    assert shown.usage == "program do DATA ... --output STR [OPTIONS]"


def test_what_is_needed_comes_first_and_what_to_read_apart(shown):
    assert [*shown.groups] == ["positional arguments", "options", "reading"]
    assert shown.groups["options"][1][0].names == ("--output",)
    assert shown.groups["reading"][0] == "What to read."


def test_names_that_an_option_takes_are_known_and_what_it_takes_is_said_in_words(shown):
    options = {each.names[0]: each for _, group in shown.groups.values() for each in group if each.names}
    assert {name: [*each.choices] for name, each in options.items() if each.choices} == {"--way": ["up", "down"]}
    assert {name: each.expected for name, each in options.items() if each.value} == {
        "--output": "text",
        "--topic": "text",
        "--way": "one of up, down",
        "--pose": "2 numbers",
        "--long-s": "a number",
    }


@dataclass(frozen=True)
class Shell:
    """Print something."""

    shell: tyro.conf.Positional[Literal["bash", "zsh"]]
    """The shell."""


def test_the_usage_of_a_command_without_options_names_none():
    assert Command.of("program print", Shell).usage == "program print {bash,zsh}"


@pytest.mark.parametrize("columns", [40, 80])
def test_paragraphs_fill_the_lines(shown, columns):
    lines = shown.shown(columns).plain.splitlines()
    assert max(map(len, lines)) <= columns
    help_on_way = re.search(r"--way {up,down}\n((?:      .*\n)+)", shown.shown(columns).plain)[1].splitlines()
    assert all(len(line) + 1 + len(after.split()[0]) > columns for line, after in pairwise(help_on_way))
    assert "100 %." in shown.shown(columns).plain
