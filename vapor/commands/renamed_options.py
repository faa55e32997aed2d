"""Options that were renamed: they are still understood, with a notice."""

from __future__ import annotations

RENAMED: dict[str, dict[str, str]] = {"benchmark": {"--variants": "--ablations"}}
"""Command -> {what an option was called: what it is called now}."""
