"""Results cached in files that are named by their settings, the code among them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from sequences.atomic import atomic_output
from sequences.errors import SequenceError
from sequences.files import read_json
from vapor.storage import fetched, published
from vapor.threads import limited_threads


def digest(settings: Mapping[str, Any]) -> str:
    """A hash of settings, ten characters."""
    text = json.dumps(settings, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:10]


def cached(path: Path, settings: Mapping[str, Any], compute: Callable[[], Any]) -> Any:
    """The result of `compute`, called with one thread, or the cached one of the same settings; all are JSON.

    `path` lacks the digest of the settings and `.json`.
    """
    file = path.with_name(f"{path.name}-{digest(settings)}.json")
    try:
        return read_json(fetched(file))["result"]
    except (SequenceError, KeyError, TypeError):  # none, or damaged
        pass
    with limited_threads(1):
        result = compute()
    file.parent.mkdir(parents=True, exist_ok=True)
    with atomic_output(file) as partial:
        partial.write_text(json.dumps({"settings": settings, "result": result}, indent=1), encoding="utf-8")
    published(file)
    return result


@cache
def code_digest(*names: str) -> str:
    """Digest of the code of the filter, and of modules and packages by name."""
    files = [file for name in ("filtering", *names) for file in _files(name)]
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:16]


def _files(name: str) -> list[Path]:
    spec = find_spec(name)
    if spec is None or spec.origin is None:
        raise ModuleNotFoundError(name)
    origin = Path(spec.origin)
    return sorted(origin.parent.rglob("*.py")) if spec.submodule_search_locations else [origin]
