"""Prints docs/licences.md: the packages that an installation brings with it, and their licences as they state them."""

from __future__ import annotations

import re
from importlib.metadata import Distribution, PackageNotFoundError, distribution

_EXTRAS = ("", "dask", "evo", "export", "live", "map", "openvino", "pandas", "video")
_TEXT = """# Licences of the dependencies

vapor-track is under Apache-2.0. This table has its direct and indirect dependencies, with installed versions and
licences as stated by the packages; made by `python docs/licences.py > docs/licences.md`. *Extra* names the first
optional extra (`dask`, `evo`, `export`, `live`, `map`, `openvino`, `pandas`, `video`) that needs a package.

Packages under the GPL come with extras only: evo is GPL-3.0; PyAV is BSD, but its wheels carry FFmpeg with encoders
under the GPL; pycolmap is BSD, but its wheels carry parts of SuiteSparse (CHOLMOD, SPQR) under the GPL. Wheels of
NumPy, SciPy, OpenCV and others carry libraries whose licences are not in this table; opencv-python-headless has FFmpeg
under the LGPL-2.1. The GPL of gcc's runtime libraries, in wheels of
NumPy and SciPy, has an exception: programs that link to them keep their own licence.
"""


def main() -> None:
    """Print the page."""
    brought: dict[str, str] = {}
    for extra in _EXTRAS:
        follow("vapor-track", extra, brought)
    print(_TEXT)
    print("| package | version | licence | extra |\n|---|---|---|---|")
    for name, extra in sorted(brought.items()):
        package = distribution(name)
        print(f"| {name} | {package.version} | {licence(package)} | {extra} |")


def follow(name: str, extra: str, brought: dict[str, str]) -> None:
    """Add what a package needs, and what that needs, where it is installed here."""
    for requirement in distribution(name).requires or []:
        wanted, _, condition = requirement.partition(";")
        asked = re.search(r"extra *== *['\"]([^'\"]*)", condition)
        needed = re.sub(r"[-_.]+", "-", re.split(r"[^\w.-]", wanted, maxsplit=1)[0]).lower()
        if (asked[1] if asked else "") != (extra if name == "vapor-track" else "") or needed in brought:
            continue
        try:
            distribution(needed)
        except PackageNotFoundError:
            continue  # of another system
        brought[needed] = extra
        follow(needed, extra, brought)


def licence(package: Distribution) -> str:
    """What a package states: an expression, classifiers, or the first line of its text."""
    stated = package.metadata
    classifiers = [each.rpartition(" :: ")[2] for each in stated.get_all("Classifier") or [] if "License ::" in each]
    text = stated.get("License-Expression") or ", ".join(each for each in classifiers if each != "OSI Approved")
    return (text or (stated.get("License") or "not stated").strip().splitlines()[0])[:80].replace("|", "/")


if __name__ == "__main__":
    main()
