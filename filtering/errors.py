"""The one exception type that every error of this project derives from, how messages quote and list what was found, and
the check of settings that raises it."""

from __future__ import annotations

import re
import reprlib
from collections.abc import Iterable

MAX_MESSAGE = 1000
"""Characters of a message, at most."""
_LONG_MESSAGE = 300  # characters beyond which long words and paths lose some; all else stays whole
_MAX_QUOTED = 60
_MAX_NAME = 255  # characters of the name of a file
_COMMAND = r"`vapor-track [^`]*`\S*"  # to be copied: it stays whole
_LONG_PATH, _PATH_END = re.compile(rf"({_COMMAND})|/[^\s'\"]{{50,}}"), 40  # the end of a path matters most
_MAX_BITS = 256  # of an integer that is written out: beyond some thousand digits Python refuses to


class VaporTrackError(Exception):
    """An input cannot be used; the message names what, where, the value found and the value expected.

    Example:
        >>> import vapor
        >>> try:
        ...     vapor.SequenceReader("nowhere.mcap")
        ... except vapor.VaporTrackError as error:
        ...     print(error)
        nowhere.mcap: ...
    """

    def __str__(self) -> str:
        """The message; of a long one, long paths lose beginnings and long words middles, except in commands."""
        text = super().__str__()
        if len(text) > _LONG_MESSAGE:
            text = _LONG_PATH.sub(lambda found: found[1] or _end_of(found[0]), text)
        return shortened(text, MAX_MESSAGE)


def shortened(message: str, length: int = MAX_MESSAGE) -> str:
    """A message of at most so many characters: the middle of long words goes, and of the whole only beyond that.

    Names in paths stay whole where there is room for any. Commands of `vapor-track` between backticks keep their words.
    """
    words, excess = message.split(" "), len(message) - min(length, _LONG_MESSAGE)
    kept = {word for command in re.findall(_COMMAND, message) for word in command.split(" ")}
    for index in sorted(range(len(words)), key=lambda index: -len(words[index])):
        word = words[index]
        if excess <= 0 or len(word) <= _MAX_QUOTED:
            break
        if word in kept:
            continue
        words[index] = _without_middle(word, max(len(word) - excess, _MAX_QUOTED, len("...") + len(_name(word))))
        excess -= len(word) - len(words[index])
    return _without_middle(" ".join(words), length)


def _end_of(path: str) -> str:
    """Name and last folders of a path, as many as fit; a long name alone."""
    begin = path.find("/", len(path) - _PATH_END, _end(path))
    begin = begin if begin >= 0 else path.rfind("/", 0, _end(path))
    return f"...{path[begin:]}" if begin > len("...") else path


def _name(word: str) -> str:
    """The name at the end of a path, with what is around it; nothing if that is no path, or no name of a file."""
    begin = word.rfind("/", 0, _end(word))
    return word[begin:] if begin >= 0 and _end(word) - begin - 1 <= _MAX_NAME else ""


def _end(path: str) -> int:
    return len(path.rstrip("/:;,'\""))


def _without_middle(text: str, length: int) -> str:
    if len(text) <= length:
        return text
    name = _name(text) if " " not in text else ""
    end = max((length - 1) // 3, len(name) if len(name) < length else 0)
    before, after = text[: length - 1 - end], text[len(text) - end :]
    if " " not in text:  # names in a path stay whole
        before, after = before[: before.rfind("/", 1) + 1] or before, after[max(after.find("/"), 0) :]
    return f"{before}…{after}"


def few(items: Iterable[object], most: int, *, others: str = "more") -> list[str]:
    """All things as text, or the first so many and the number of the others: it is never 1, as that one is named."""
    words = [str(item) for item in items]
    return words if len(words) <= most + 1 else [*words[:most], f"{len(words) - most} {others}"]


def listed(items: Iterable[object], most: int, separator: str = ", ", *, others: str = "more") -> str:
    """`few` in a sentence: "a, b and c", "a, b and 2 more"; between semicolons "a; b; and 2 more"."""
    words = few(items, most, others=others)
    ends = [separator.join(words[:-1]), words[-1]] if len(words) > 1 else words
    return f"{separator.strip(', ')} and ".join(ends)


def counted(number: int, noun: str) -> str:
    """How many there are, in words: "1 image", "2 images"; the noun is a singular whose plural ends in s."""
    return f"{number} {noun}{'s' * (number != 1)}"


def length_said(metres: float) -> str:
    """A length in words, two digits: "0.72 mm", "3.1 cm", "1.2 m"."""
    unit, name = (1.0, "m") if metres >= 0.995 else (1e2, "cm") if metres >= 0.00995 else (1e3, "mm")
    return f"{unit * metres:.2g} {name}"


def quoted(value: object) -> str:
    """A value that was found in an input, as a message shows it: on one line, in 60 characters or fewer."""
    return shortened(_Short().repr(value), _MAX_QUOTED)


class _Short(reprlib.Repr):
    """`repr` of the first few of many things, and of the outer few of nested ones."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel, self.maxlist, self.maxtuple, self.maxdict = 3, 6, 6, 4
        self.maxstring = self.maxother = _MAX_QUOTED

    def repr_int(self, x: int, level: int) -> str:
        """An integer, or how large it is."""
        return repr(x) if x.bit_length() <= _MAX_BITS else f"an integer of {x.bit_length()} bits"


def require_within(settings: object, **ranges: tuple[int | float, int | float]) -> None:
    """Check numbers among the attributes of an object.

    Args:
        settings: The object.
        ranges: Name of an attribute -> its smallest and its largest value.

    Raises:
        VaporTrackError: one lies outside, or is NaN.
    """
    for name, (low, high) in ranges.items():
        value = getattr(settings, name)
        if not low <= value <= high:  # NaN compares as false
            raise VaporTrackError(f"{name} is {quoted(value)}, expected between {low} and {high}")
