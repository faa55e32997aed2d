"""What this process keeps of the memory that it frees."""

from __future__ import annotations

import ctypes
from contextlib import suppress

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # of glibc's malloc.h
_KEPT_BYTES, _BLOCK_BYTES = 2**28, 2**25


def keep_freed_memory() -> None:
    """Keep freed blocks of up to 32 MB, 256 MB in all, to be used again; other C libraries than glibc stay as they are.

    Otherwise each layer of a network, and each sum over all landmarks, has the system map the same pages anew, which
    takes as long as the arithmetic.
    """
    with suppress(OSError, TypeError, AttributeError):
        adjust = ctypes.CDLL(None).mallopt
        adjust(_MMAP_THRESHOLD, _BLOCK_BYTES)
        adjust(_TRIM_THRESHOLD, _KEPT_BYTES)
