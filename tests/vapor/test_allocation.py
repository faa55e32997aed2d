"""What a process keeps of the memory that it frees."""

import platform
import subprocess
import sys

import pytest

_PAGES_OF = """
import resource
import numpy as np
from vapor.allocation import keep_freed_memory

def pages():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(10):
        one, two = np.ones(2_000_000), np.ones(2_000_000)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

before = pages()
keep_freed_memory()
pages()
print(before, pages())
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc is told what to keep")
def test_freed_blocks_are_used_again_without_new_pages():
    found = subprocess.run([sys.executable, "-c", _PAGES_OF], capture_output=True, text=True, check=True)
    before, after = map(int, found.stdout.split())
    assert after < 0.1 * before


def test_another_c_library_stays_as_it_is(monkeypatch):
    from vapor import allocation

    monkeypatch.setattr(allocation.ctypes, "CDLL", lambda _: object())
    allocation.keep_freed_memory()
