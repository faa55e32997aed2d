"""Rows of files, of which those that cannot be used are left out, as long as most of them can be used."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import ParamSpec, TypeVar

from sequences.errors import SequenceError

UNUSABLE = "unusable row"
"""Why a row is left out that is not as its format has it."""
_MOST_UNUSABLE = 0.5  # fraction of the rows beyond which the file is another one than it seems

Row = TypeVar("Row")
Read = TypeVar("Read")
Arguments = ParamSpec("Arguments")


def _unusable(_: SequenceError) -> str:
    return UNUSABLE


class Rows:
    """What is left out of rows: lines of a table, files of one pose each, images.

    Attributes:
        num_rows: How many were read so far.
        num_unusable: How many of them could not be used.
        tolerant: Whether any may be left out.
    """

    def __init__(
        self, what: str = "rows", reason: Callable[[SequenceError], str] = _unusable, *, tolerant: bool = True
    ) -> None:
        """Begin to count.

        Args:
            what: What they are, in the plural.
            reason: The reason by which one is counted that could not be used, from the error that said so.
            tolerant: Whether any may be left out; otherwise the first that cannot be used is an error.
        """
        self.num_rows = self.num_unusable = 0
        self._what, self._reason, self._first = what, reason, ""
        self.tolerant = tolerant

    def each(self, rows: Iterable[Row]) -> Iterator[Row]:
        """The rows, one after the other.

        Raises:
            SequenceError: after the last one, more than half of them could not be used; it says of the first why not.
        """
        for row in rows:
            self.num_rows += 1
            yield row
        if self.num_unusable > _MOST_UNUSABLE * self.num_rows:
            raise SequenceError(
                f"{self._first}; {self.num_unusable} of {self.num_rows} {self._what} cannot be used,"
                " expected at most one in two"
            )

    def use(
        self, read: Callable[Arguments, Read], *arguments: Arguments.args, **keywords: Arguments.kwargs
    ) -> Read | str:
        """What a row says, as a function reads it; the reason to leave it out where that raises SequenceError."""
        try:
            return read(*arguments, **keywords)
        except SequenceError as error:
            if not self.tolerant:
                raise
            self.num_unusable += 1
            self._first = self._first or str(error)
            return self._reason(error)

    @property
    def notices(self) -> list[str]:
        """How many could not be used, and why the first could not; nothing where all could."""
        if not self.num_unusable:
            return []
        return [f"{self.num_unusable} of {self.num_rows} {self._what} left out, the first: {self._first}"]
