"""What a benchmark writes, as the page of the measurements takes it."""

from pathlib import Path
from typing import Any

from docs.measuring.measurement import Measurements
from docs.measuring.tables import table_of
from tests.helpers.checkout import CHECKOUT


def tables_on_the_page(name: str, file: Path) -> list[dict[str, Any]]:
    """The tables of a measurement, of this file in place of all files that its commands write, and with all rows."""
    specs = Measurements(CHECKOUT / "docs").entries[name].table
    own = [{key: value for key, value in spec.items() if key not in ("files", "names")} for spec in specs]
    return [table_of(spec | {"file": file.name}, file.parent) for spec in own]
