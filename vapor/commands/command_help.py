"""What a command does and its options, from the parser that reads the command line: for `--help` and for the site."""

from __future__ import annotations

import re
import textwrap
import warnings
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass
from inspect import cleandoc
from typing import Any, get_type_hints

import tyro
from rich.text import Text

_HEADINGS = {"positional arguments": "Arguments", "options": "Options", "reading": "Options for reading the data"}
_LARGE = 1e6  # from here on a default is written with a power of ten


@dataclass(frozen=True)
class Option:
    """An option or an argument."""

    names: Sequence[str]
    """`--undistort` and `--no-undistort`; of an argument that has no name, nothing."""
    value: str
    """What it takes, such as PATH."""
    help: str
    default: str | None
    """As one would type it; None where it must be given, where there is none, or where `help` says it."""
    required: bool
    choices: Sequence[str] = ()
    """Names that it takes, or takes beside others: those in braces in `value`."""

    @property
    def expected(self) -> str:
        """What it takes, in words."""
        return " or ".join(map(_in_words, self.value.strip("[]").split("|")))

    @property
    def title(self) -> str:
        """Its names with what it takes."""
        return ", ".join([f"{name} {self.value}".strip() for name in self.names]) or self.value


@dataclass(frozen=True)
class Command:
    """A command."""

    words: str
    """With its program, as one types it."""
    meaning: str
    groups: Mapping[str, tuple[str, Sequence[Option]]]
    """Name of a group of options, such as `localizer.gap` → what they are about, and the options."""

    @staticmethod
    def of(words: str, options: type) -> Command:
        """A command with its program, such as `vapor-track train`, and the dataclass of its options."""
        with warnings.catch_warnings():  # no other function of tyro's gives options as data
            warnings.simplefilter("ignore", DeprecationWarning)
            parser = tyro.extras.get_parser(options)
        needed = {each.name for each in fields(options) if each.default is each.default_factory is MISSING}
        groups = dict(_groups(parser, needed))
        if (reading := _reading(options)) is not None:  # needed seldom, so these stand apart
            apart = {f"--{each.name.replace('_', '-')}" for each in fields(reading)}
            meaning, own = groups.pop("options")
            first = {name: groups.pop(name) for name in ["positional arguments"] if name in groups}
            first["options"] = meaning, [each for each in own if each.names[0] not in apart]
            about = cleandoc(reading.__doc__ or "")
            groups = first | {"reading": (about, [each for each in own if each.names[0] in apart])} | groups
        return Command(words, cleandoc(options.__doc__ or ""), groups)

    @property
    def names(self) -> set[str]:
        """The names of all options."""
        return {name for _, options in self.groups.values() for option in options for name in option.names}

    @property
    def usage(self) -> str:
        """How it is called: with its arguments and the options that it needs."""
        options = [option for _, group in self.groups.values() for option in group]
        arguments = [option.value for option in options if not option.names]
        needed = [f"{option.names[0]} {option.value}" for option in options if option.names and option.required]
        others = ["[OPTIONS]"] if any(option.names and not option.required for option in options) else []
        return " ".join([self.words, *arguments, *needed, *others])

    def shown(self, columns: int) -> Text:
        """Its help in lines of so many characters."""

        def paragraph(text: str, before: str = "") -> str:
            return textwrap.fill(text, columns, initial_indent=before, subsequent_indent=before, break_on_hyphens=False)

        usage = textwrap.fill(f"usage: {self.usage}", columns, subsequent_indent=" " * 7, break_on_hyphens=False)
        shown = Text(usage + "\n")
        for part in self.meaning.split("\n\n"):
            shown.append(f"\n{paragraph(part)}\n")
        for name, (meaning, options) in self.groups.items():
            shown.append(f"\n{heading(name)}\n", "bold")
            if meaning:
                shown.append(f"{paragraph(meaning, '  ')}\n")
            for option in options:
                ending = " (required)" if option.required and option.names else ""
                ending = f" (default: {option.default})" if option.default else ending
                title = option.title if len(option.title) < columns else option.title.replace(",", ", ")
                shown.append(f"{paragraph(title, '  ')}\n", "bold")
                shown.append(f"{paragraph(option.help + ending, ' ' * 6)}\n")
        shown.rstrip()
        return shown


def heading(group: str) -> str:
    """The heading of a group of options."""
    return _HEADINGS.get(group, f"--{group}.*")


def _groups(parser: Any, needed: Collection[str]) -> Iterator[tuple[str, tuple[str, Sequence[Option]]]]:
    for group in parser._action_groups:  # tyro has an argparse of its own
        options = [_option(action, needed) for action in group._group_actions if action.dest != "help"]
        if options:
            name = (group.title or "").removesuffix(" options")
            options.sort(key=lambda option: not option.required)
            yield name, (" ".join((group.description or "").split()), options)


def _reading(options: type) -> type | None:
    """The dataclass of options on what to read, where a command has them."""
    found = get_type_hints(options).get("reading")
    return found if isinstance(found, type) and is_dataclass(found) else None


def _option(action: Any, needed: Collection[str]) -> Option:
    text = " ".join((action.help or "").replace("%%", "%").split())
    stated = re.fullmatch(r"(.*?) ?\((?:(required)|default: (.*?))\)", text)
    text, required, default = (stated[1], stated[2] is not None, stated[3]) if stated else (text, False, None)
    if "Default: " in text or default in ("", "None"):
        default = None
    names = tuple(action.option_strings)
    if default in ("True", "False") and action.nargs == 0:  # the name of a switch as it is, if it has two
        default = names[default == "False"] if len(names) == 2 else None
    elif default is not None and re.fullmatch(r"\d+\.0", default) and float(default) >= _LARGE:
        default = f"{float(default):g}"
    metavar = "" if action.nargs == 0 else str(action.metavar or "")
    required = required or action.dest in needed  # for the parser no arguments are enough where many may be
    return Option(names, _value(metavar), text, default, required, _choices(metavar))


def _value(metavar: str) -> str:
    """What an option takes, without that it may be absent and without braces around single words."""
    value = re.sub(r"^\{None\}\||(?<=\{)None,", "", metavar)
    value = re.sub(r"\{([A-Z]+(?: [A-Z]+)*|[a-z]+)\}", r"\1", value)
    return re.sub(r"\[(\w+) \[\1 \.\.\.\]\]", r"[\1 ...]", value)


def _choices(metavar: str) -> Sequence[str]:
    """The names in braces, such as those of `{None}|{up,down}`: a kind of value is written in capitals."""
    groups = re.findall(r"\{([^{} ]*)\}", metavar)
    return [name for group in groups for name in group.split(",") if name not in ("None", "True", "False")]


def _in_words(value: str) -> str:
    """One of the kinds of value that an option takes."""
    kinds = {"INT": "a whole number", "FLOAT": "a number", "STR": "text", "PATH": "a path"}
    words = value.split()
    if len(words) > 1 and (many := {"FLOAT": "numbers", "STR": "words"}.get(words[0])) and len(set(words)) == 1:
        return f"{len(words)} {many}"
    if words[1:] == ["..."]:
        return f"{kinds.get(words[0], words[0])}, once or more"
    if value.startswith("{"):
        return f"one of {value.strip('{}').replace(',', ', ')}"
    return kinds.get(value, value)
