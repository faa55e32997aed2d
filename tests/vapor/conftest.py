"""Engines: no network is compiled where a test does not ask for it, as that takes seconds."""

from collections.abc import Iterator

import pytest


@pytest.fixture(scope="session", autouse=True)
def nothing_is_compiled_by_itself(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """`--engine auto` is torch, and networks that are compiled are kept in a cache of the tests."""
    from vapor.engines import start  # after the hook

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(start, "can_be_kept", lambda: False)
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield
