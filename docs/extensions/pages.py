"""What stands in the pages: blocks of code, and the commands in them."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass

from docs.extensions.command_help import command, kinds_of
from vapor.track import COMMANDS

_BLOCK = re.compile(
    r"(?:<!-- (?P<mark>[^\n]*?) -->\n\s*)?^(?P<fence>```+|:::+)(?P<language>[^\n`]*)\n(?P<text>.*?)^(?P=fence)$",
    flags=re.DOTALL | re.MULTILINE,
)
_BEFORE_A_COMMAND = re.compile(r"do|then|else|!|time|exec|\w+=.*")


@dataclass(frozen=True)
class Block:
    """A fenced block of a page."""

    language: str
    """What stands behind its fence, such as `sh` or `{code-cell}`."""
    text: str
    mark: str
    """The comment `<!-- ... -->` on the line before it, if any."""


def blocks(page: str) -> Iterator[Block]:
    """The fenced blocks of a page, in their order."""
    for found in _BLOCK.finditer(page):
        yield Block(found["language"].strip(), found["text"], found["mark"] or "")


def shell(page: str) -> Iterator[str]:
    """All shell of a page: blocks of `sh`, cells that begin with `%%bash`, and commands of ours within a line."""
    for block in blocks(page):
        if block.language == "sh" or (block.language.startswith("{code-cell}") and "%%bash" in block.text):
            yield block.text
    yield from re.findall(rf"`(vapor-track (?:{'|'.join(COMMANDS)}) [^`\n]+)`", _BLOCK.sub("", page))


def unknown(text: str) -> Iterator[str]:
    """What shell asks of `vapor-track` that its parser does not know: a sentence for each command, kind and option."""
    for words in _simple_commands(text):
        if words[0].rpartition("/")[2] == "vapor-track":
            yield from _unknown_words(words[1:])
        elif "vapor.track" in words:
            yield from _unknown_words(words[words.index("vapor.track") + 1 :])


def _unknown_words(words: list[str]) -> Iterator[str]:
    name, *rest = words or [""]
    if name in ("", "--help", "--version") or name.isupper():  # COMMAND stands for any
        return
    if name not in COMMANDS:
        yield f"there is no command {name!r}"
        return
    kinds = kinds_of(name)
    if kinds != [name] and rest and rest[0] != "--help":
        if f"{name} {rest[0]}" not in kinds:
            yield f"{name} has no kind {rest[0]!r}"
            return
        name = f"{name} {rest[0]}"
    elif kinds != [name]:
        return
    known = command(name).names | {"--help"}
    for word in rest:
        option = word.partition("=")[0]
        if re.match(r"--\w", option) and option not in known:
            yield f"{name} has no option {option}"


def _simple_commands(text: str) -> Iterator[list[str]]:
    """The words of each command, without what stands before it, such as `do` or `X=1`."""
    text = re.sub(r"(^|\s)#.*$", r"\1", text.replace("\\\n", " "), flags=re.MULTILINE)
    lexer = shlex.shlex(text, posix=True, punctuation_chars=";|&()\n")
    lexer.whitespace, lexer.whitespace_split, lexer.commenters = " \t", True, ""
    words: list[str] = []
    for word in [*lexer, "\n"]:
        if set(word) <= set(";|&()\n"):
            if words:
                yield words
            words = []
        elif words or not _BEFORE_A_COMMAND.fullmatch(word):
            words.append(word)
