"""What is wrong with the words of a command line, in one line."""

from __future__ import annotations

import re
from collections.abc import Sequence
from difflib import get_close_matches
from itertools import pairwise, takewhile

from filtering.errors import quoted, shortened
from vapor.commands.command_help import Command, Option

_LIKENESS = 0.75  # from here on an option is one that may have been meant
_LONGEST_NAME = 60  # characters
_OF_OPTION = re.compile(r"(?:Error parsing |(?:invalid choice .*|Missing value) for argument ')(--[^\s:']+)")
_UNEXPECTED = re.compile(r"Unrecognized options: (.*)")
_OF_ARGUMENT = re.compile(r"invalid choice ('.*') for argument '(\w+)'\. Expected one of \(([^()]*)\)")


def what_is_wrong(arguments: Sequence[str], message: str, command: Command) -> str:
    """What is wrong with the arguments of a command.

    Args:
        arguments: The words after the command, which the parser refused.
        message: What the parser says, in a box.
        command: The options.
    """
    given = [_name(word) for word in takewhile(lambda word: word != "--", arguments) if word.startswith("--")]
    if unknown := [_unknown(name, command) for name in given if name not in command.names]:
        return "; ".join(unknown)
    text = _unboxed(message)
    options = _by_name(command)
    if unexpected := _UNEXPECTED.search(text):
        return _unexpected(unexpected[1], arguments, command)
    if (refused := _OF_OPTION.match(text)) and refused[1] in given:
        return _refused_value(refused[1], options[refused[1]], arguments)
    if refused := _OF_ARGUMENT.match(text):
        return f"{refused[2]} is {refused[1]}, expected one of {refused[3].replace(chr(39), '')}"
    return "; ".join([*missing_arguments(arguments, command), text])


def missing_arguments(arguments: Sequence[str], command: Command) -> list[str]:
    """Arguments that may be many and are none, each with its meaning: the parser takes none for enough."""
    options, left, free = _by_name(command), list(arguments), 0
    while left:
        word = left.pop(0)
        if word == "--":
            free += len(left)
            break
        free += not word.startswith("--")
        if "=" not in word and (option := options.get(_name(word))) is not None:
            left = left[len(_values(left, option)) :]
    named = [each for _, group in command.groups.values() for each in group if not each.names]
    many = [each for each in named if "..." in each.value]
    missing = [each for each in many if each.required] if free <= len(named) - len(many) else []
    return [f"missing {each.title}: {each.help.partition('. ')[0].rstrip('.')}" for each in missing]


def _by_name(command: Command) -> dict[str, Option]:
    return {name: option for _, group in command.groups.values() for option in group for name in option.names}


def _name(word: str) -> str:
    """The option that a word names, as `--help` writes it."""
    return word.partition("=")[0].replace("_", "-")


def _unknown(name: str, command: Command) -> str:
    near = get_close_matches(name, sorted(command.names), 1, _LIKENESS)
    hint = f"did you mean {near[0]}?" if near else f"expected one that `{command.words} --help` lists"
    return f"unknown option {shortened(name, _LONGEST_NAME)}, {hint}"


def _unexpected(words: str, arguments: Sequence[str], command: Command) -> str:
    """What to say of words, the first of which is one of the arguments too many."""
    found = before = ""
    for previous, word in pairwise(["", *arguments]):
        name, _, value = word.partition("=") if word.startswith("--") else (previous, "", word)
        if value and words.startswith(value):
            found, before = value, name
    if not before:
        return f"unexpected {quoted(words)}, expected `{command.usage}`"
    if found.startswith("-"):
        return _unknown(found, command)
    if (option := _by_name(command).get(_name(before))) is not None and not option.value:
        return f"unexpected {quoted(found)}, as {_name(before)} takes no value"
    return f"unexpected {quoted(found)} after {shortened(before, _LONGEST_NAME)}, expected `{command.usage}`"


def _refused_value(name: str, option: Option, arguments: Sequence[str]) -> str:
    index = max(i for i, word in enumerate(arguments) if _name(word) == name)
    is_joined = "=" in arguments[index]
    values = [arguments[index].partition("=")[2]] if is_joined else _values(arguments[index + 1 :], option)
    found = f"is {quoted(' '.join(values))}" if values else "has no value"
    return f"{name} {found}, expected {option.expected}"


def _values(following: Sequence[str], option: Option) -> list[str]:
    """Those of the words after an option that are its values."""
    values = [*takewhile(lambda word: not word.startswith("--"), following)]
    return values if "..." in option.value else values[: len(option.value.split())]


def _unboxed(text: str) -> str:
    """The message in a box of tyro's, without help on options that were given."""
    parts: list[list[str]] = [[]]
    for line in text.splitlines()[1:-1]:
        line = line.strip("│|").rstrip()
        if line.strip(" ─-"):
            parts[-1].append(line)
        elif line:  # a rule between two parts
            parts.append([])
    sentences = [_missing(part) or " ".join(" ".join(part).split()) for part in parts]
    return "; ".join(s for s in sentences if s and not s.startswith(("Argument helptext", "For full helptext")))


def _missing(part: Sequence[str]) -> str:
    """The options that are missing, each with its meaning; empty for a part of a message that lists none."""
    if len(part) < 2 or not part[0].strip().startswith("Missing from "):
        return ""
    indent = len(part[1]) - len(part[1].lstrip())  # of a name; its meaning is indented further
    text = ""
    for line in part[1:]:
        is_name = len(line) - len(line.lstrip()) == indent
        text += f"; missing {line.strip()}:" if is_name else f" {line.strip()}"
    return re.sub(r"\.? \(required\)", "", text).removeprefix("; ")
