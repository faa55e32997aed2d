"""From the JSON that a benchmark writes to a small table: records are grouped, and a column is a figure of each group.

A table of the list has `file`, or several `files` by a name for each; `records`, the list in them that holds a record
for each run, walk or draw (without it a file is one record); `by`, the keys that name a row, of which `file` is the
name of the file; and `columns`, each with a `name` and one of:

    median, mean   a number of each record, with its 95 % interval by a bootstrap over walks; `weight` of a mean
    total          how many records have a flag, or a number of at most `most` or at least `least`, with
                   Wilson's 95 % interval
    each           the number of every record
    largest, sum   of the numbers
    value          of the first record
    number         how many records there are

A value is a path of keys with spaces between them. `unit` and `digits` say how a column is shown. `walk` is the key of
the walk that a record is cut from: all records of one are drawn together; without it each is a walk. `where` keeps
records with given values, `names` renames rows, and keeps these only. Instead of columns, `printed` takes the lines of
the commands' output that match an expression.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from scipy.stats import binomtest

from vapor.benchmark.figures import Figure, Walks, values_at

Records = Sequence[Mapping[str, Any]]
_DIGITS = 4  # that are kept


def table_of(spec: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """A table: `title`, `first` (heading of the names of its rows), `columns`, and `rows`, each with its cells.

    A cell is a number, a text, None; `[number, ...]` of every record; `{"value", "low", "high"}`; or, of a total,
    `{"value", "of", "low", "high"}`. Of a table that is `printed`, `text` has its lines.

    Raises:
        ValueError: the files lack what is asked for.
    """
    head = {key: spec[key] for key in ("title", "first") if key in spec}
    if "printed" in spec:
        printed = [line for file in sorted(folder.glob("*.txt")) for line in file.read_text().splitlines()]
        lines = [line for line in printed if re.search(spec["printed"], line)]
        if not lines:
            raise ValueError(f"{folder}: no line that was printed matches {spec['printed']!r}")
        return head | {"text": "\n".join(lines)}
    records = _records(spec, folder)
    groups: dict[str, list[Mapping[str, Any]]] = {}
    for record in records:
        name = ", ".join(str(value) for key in spec["by"] for value in values_at([record], *key.split()) if value != "")
        groups.setdefault(name, []).append(record)
    names = spec.get("names", {name: name for name in groups})
    if lacking := names.keys() - groups.keys():
        raise ValueError(f"no row {', '.join(sorted(lacking))} among {', '.join(groups)}")
    return head | {
        "columns": [
            {key: column[key] for key in ("name", "unit", "digits") if key in column} for column in spec["columns"]
        ],
        "rows": [
            [shown, [_cell(column, groups[name], spec.get("walk")) for column in spec["columns"]]]
            for name, shown in names.items()
        ],
    }


def _records(spec: Mapping[str, Any], folder: Path) -> Records:
    records = []
    for name, file in _files(spec).items():
        content = json.loads((folder / file).read_text(encoding="utf-8"))
        (found,) = values_at([content], *spec["records"].split()) if "records" in spec else ([content],)
        records += [{"file": name} | record for record in found]
    where = spec.get("where", {})
    chosen = [record for record in records if all(record[key] == value for key, value in where.items())]
    if not chosen:
        raise ValueError(f"{', '.join(_files(spec).values())}: none of {len(records)} records has {where}")
    return chosen


def _files(spec: Mapping[str, Any]) -> Mapping[str, str]:
    return spec.get("files", {"": spec.get("file")})


def _cell(column: Mapping[str, Any], records: Records, walk: str | None) -> Any:
    ((kind, path),) = ((key, column[key]) for key in _KINDS if key in column)
    values = values_at(records, *path.split()) if isinstance(path, str) else []
    weights = values_at(records, *column["weight"].split()) if "weight" in column else None
    if "most" in column or "least" in column:
        least, most = column.get("least", -math.inf), column.get("most", math.inf)
        values = [value is not None and least <= value <= most for value in values]
    walks = Walks(values_at(records, *walk.split()) if walk else range(len(records)))
    return _rounded(_KINDS[kind](values, walks, records, weights))


def _total(values: Sequence[Any], *_: Any) -> dict[str, Any]:
    right, of = sum(map(bool, values)), len(values)
    interval = binomtest(right, of).proportion_ci(method="wilson")
    return {"value": right, "of": of, "low": float(interval.low), "high": float(interval.high)}


def _figure(figure: Figure) -> Any:
    return figure.value if figure.low is None else figure._asdict()


def _known(values: Sequence[Any]) -> list[Any]:
    return [value for value in values if value is not None]


_KINDS: Mapping[str, Callable[..., Any]] = {
    "median": lambda values, walks, records, weights: _figure(walks.median(values)),
    "mean": lambda values, walks, records, weights: _figure(walks.mean(values, weights)),
    "total": _total,
    "each": lambda values, walks, records, weights: list(values),
    "largest": lambda values, walks, records, weights: max(_known(values), default=None),
    "sum": lambda values, walks, records, weights: sum(_known(values)),
    "value": lambda values, walks, records, weights: values[0],
    "number": lambda values, walks, records, weights: len(records),
}


def _rounded(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _rounded(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_rounded(each) for each in value]
    return float(f"{value:.{_DIGITS}g}") if isinstance(value, float) else value
