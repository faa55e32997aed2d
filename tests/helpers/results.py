"""Small results of a command, as one writes them and as they are found."""

from collections.abc import Callable
from pathlib import Path

import pytest

from sequences.atomic import atomic_output
from sequences.errors import SequenceError
from sequences.outputs import MANIFEST, results_folder, verify

WRITES = ("a.tum", "b.json", "sometimes.png")


def interrupt() -> None:
    raise KeyboardInterrupt


def write(
    directory: Path, content: str, *, sometimes: bool = False, meanwhile: Callable[[], object] = int, **options
) -> None:
    with results_folder(directory, "run", writes=WRITES, **options) as new:
        for name in WRITES if sometimes else WRITES[:2]:
            with atomic_output(new / name) as partial:
                partial.write_text(content)
        meanwhile()


def contents(folder: Path) -> dict[str, str]:
    return {str(path.relative_to(folder)): path.read_text() for path in folder.rglob("*") if path.is_file()}


def whole(directory: Path) -> str:
    """The content that all files of complete results share."""
    files = contents(directory)
    assert set(files) - {"notes.txt", "sometimes.png"} == {"a.tum", "b.json", MANIFEST}
    verify(directory, WRITES)
    (content,) = {files[name] for name in WRITES if name in files}
    return content


def refused(directory: Path, *said: str, **options) -> None:
    before = contents(directory), sorted(directory.parent.iterdir())  # beside it lie other tests' folders
    with pytest.raises(SequenceError) as error, results_folder(directory, "run", writes=WRITES, **options):
        pytest.fail("the work began")
    assert all(words in str(error.value) for words in (str(directory), "expected", *said))
    assert "\n" not in str(error.value)
    assert (contents(directory), sorted(directory.parent.iterdir())) == before
