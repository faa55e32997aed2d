"""`status.csv`: how good the pose of each image of a run is, a line each."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np
from jaxtyping import Float64, Shaped

from filtering.estimate import STATUSES
from sequences.atomic import atomic_output
from sequences.errors import SequenceError
from sequences.files import read_lines
from sequences.trajectories.tum import format_time
from sequences.values import parse_number, parse_time_ns
from vapor.reporting.record import RunRecord
from vapor.reporting.report import FITS

COLUMNS = (
    "time,status,std_m,std_deg,unassigned,log_likelihood,innovation,smoothed,smoothed_std_m,smoothed_std_deg,"
    "carried_off,camera"
)
_SMOOTHED = ("", "fits", "doubtful", "ambiguous")


def write_status(path: Path, record: RunRecord) -> None:
    """Write how good the pose of each image is, as CSV.

    `status`, `std_m`, `std_deg`: the filter's status, and standard deviations of its pose along the widest axis of
    position and rotation. `unassigned`: probability that the camera is at none of the hypotheses. `log_likelihood`: see
    `Estimate`. `innovation`: normalised innovation squared of the best mode per degree of freedom; empty without one.
    `smoothed`: whether the images about the smoothed pose fit it, `fits` or `doubtful`; or `ambiguous` where the second
    trajectory is at another place. `smoothed_std_m`, `smoothed_std_deg`: of the smoothed pose. `carried_off`: 1 where
    the camera was carried off before the image. `camera`: that of the image, where there are several.
    """
    columns = [format_time(time_ns) for time_ns in record.times_ns.tolist()], record.status, *_widest(record.covariance)
    columns += tuple([f"{each:.4f}" for each in values] for values in (record.unassigned, record.log_likelihood))
    columns += (["" if np.isnan(each) else f"{each:.3f}" for each in record.innovation],)
    if (back := record.look_back) is None:
        columns += ([""] * len(record.times_ns),) * 4
    else:
        fits = np.where(back.agreement < FITS, "doubtful", np.where(back.ambiguous, "ambiguous", "fits"))
        columns += (fits, *_widest(back.trajectories["smoothed"].covariance), back.carried_off.astype(int))
    columns += (record.cameras or [""] * len(record.times_ns),)
    with atomic_output(path) as partial, open(partial, "w", encoding="utf-8") as file:
        file.write(f"{COLUMNS}\n")
        file.writelines(",".join(map(str, row)) + "\n" for row in zip(*columns, strict=True))


def _widest(covariance: Float64[np.ndarray, "n 6 6"]) -> tuple[list[str], list[str]]:
    """Standard deviations along the widest axis of position and rotation, metres and degrees."""
    std_m, std_rad = (
        np.sqrt(np.linalg.eigvalsh(covariance[:, part, part]))[:, -1] for part in (slice(0, 3), slice(3, 6))
    )
    return [f"{each:.4f}" for each in std_m], [f"{each:.3f}" for each in np.degrees(std_rad)]


def read_status(path: Path) -> dict[str, Shaped[np.ndarray, " n"]]:
    """The columns of a `status.csv`, (n,) each, see `write_status`: `time_ns`, and the others by their names.

    Numbers that the file leaves empty are NaN.

    Raises:
        SequenceError: the file is missing, or is not one that `run` or `fuse` wrote.
    """
    path = Path(path)
    lines = read_lines(path, None)
    header = next(lines, (1, ""))[1].strip()
    if header != COLUMNS:
        raise SequenceError(f"{path}: begins with {header[:80]!r}, expected the columns {COLUMNS}")
    names = COLUMNS.split(",")
    rows: list[list[object]] = []
    for number, line in lines:
        where, fields = f"{path}:{number}", line.rstrip("\n").split(",", len(names) - 1)
        if len(fields) != len(names):
            raise SequenceError(f"{where}: {len(fields)} columns, expected the {len(names)} {COLUMNS}")
        rows.append([_READ[name](field, f"{where}: {name}") for name, field in zip(names, fields, strict=True)])
    columns = zip(*rows, strict=True) if rows else ([] for _ in names)
    named = {name: np.array([*column]) for name, column in zip(names, columns, strict=True)}
    return {"time_ns": named.pop("time").astype(np.int64), **named}


def _number(text: str, where: str) -> float:
    return parse_number(text, where) if text else np.nan


def _one_of(known: tuple[str, ...]) -> Callable[[str, str], str]:
    def read(text: str, where: str) -> str:
        if text not in known:
            raise SequenceError(f"{where}: {text!r}, expected one of {', '.join(filter(None, known))}")
        return text

    return read


_READ: Mapping[str, Callable[[str, str], object]] = MappingProxyType(
    {
        **dict.fromkeys(COLUMNS.split(","), _number),
        "time": parse_time_ns,
        "status": _one_of(STATUSES),
        "smoothed": _one_of(_SMOOTHED),
        "camera": lambda text, where: text,
    }
)
