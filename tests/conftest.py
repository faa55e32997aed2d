"""Shapes and types in annotations are executed while the tests run."""

from pathlib import Path

import pytest
from jaxtyping import install_import_hook

install_import_hook(["filtering", "sequences", "vapor"], "beartype.beartype").__enter__()


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Recorded data beside the checkout; tests that need it skip, saying so, where it is absent."""
    path = Path(__file__).resolve().parents[2] / "shared" / "data"
    if not path.is_dir():
        pytest.skip("recorded data is absent: ../shared/data beside the checkout")
    return path
