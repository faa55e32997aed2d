"""What a fit changed, for a person to read and for the model file to keep."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from filtering.error_model import ErrorModel, Six


@dataclass(frozen=True)
class Change:
    """What one fit changed.

    Attributes:
        what: What was fitted, in words.
        before: Values before the fit, by the name of their setting.
        after: Values after it, likewise.
        gain: Log likelihood gained, nats per held-out image; None where something else than likelihood decides.
    """

    what: str
    before: dict[str, float | Six]
    after: dict[str, float | Six]
    gain: float | None = None


def change_of(
    what: str, names: Sequence[str], before: ErrorModel, after: ErrorModel, gain: float | None = None
) -> Change:
    """The change of these fields of an error model."""
    values, formerly = ({name: getattr(errors, name) for name in names} for errors in (after, before))
    return Change(what, formerly, values, gain)
