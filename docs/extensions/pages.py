"""What stands in the pages: blocks of code, and the commands in them."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass

from docs.extensions.command_help import PROGRAMS, command

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
    for program, module in PROGRAMS.items():
        yield from re.findall(rf"`({program} (?:{'|'.join(module.COMMANDS)}) [^`\n]+)`", _BLOCK.sub("", page))


def unknown(text: str) -> Iterator[str]:
    """What shell asks of our programs that their parsers do not know: a sentence for each command and option."""
    for words in _simple_commands(text):
        if (program := words[0].rpartition("/")[2]) in PROGRAMS:
            yield from _unknown_words(program, words[1:])
        elif "vapor.track" in words:
            yield from _unknown_words("vapor-track", words[words.index("vapor.track") + 1 :])


def _unknown_words(program: str, words: list[str]) -> Iterator[str]:
    name, *rest = words or [""]
    if name in ("", "--help", "--version") or name.isupper():  # COMMAND stands for any
        return
    if name not in PROGRAMS[program].COMMANDS:
        yield f"{program} has no command {name!r}"
        return
    known = command(f"{program} {name}").names | {"--help"}
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
