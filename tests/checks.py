"""Shapes and types in annotations, which tests execute, for a while not executed."""

from collections.abc import Iterator
from contextlib import contextmanager

import jaxtyping


@contextmanager
def no_checks() -> Iterator[None]:
    """For what takes thousands of steps, where others check those of the same calls; may be nested."""
    before = jaxtyping.config.jaxtyping_disable
    jaxtyping.config.update("jaxtyping_disable", True)
    try:
        yield
    finally:
        jaxtyping.config.update("jaxtyping_disable", before)
