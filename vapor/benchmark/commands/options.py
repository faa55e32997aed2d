"""Options and results of the benchmarks that replay walks."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from filtering.errors import VaporTrackError
from sequences.scenes import find_scene, is_scene, scene_names
from vapor.checkpoints.file_format import find_model
from vapor.commands.console import OutputPath, Overwrite
from vapor.reporting.report import is_report, write_report

SCENE_NAMES = scene_names(with_cues=True)
"""Scenes to choose from: others show nothing by which the filter could find itself."""

Scenes = Annotated[
    tyro.conf.Positional[tuple[str, ...]],
    tyro.conf.arg(
        metavar=f"{{{','.join(SCENE_NAMES)}}} ...",
        help="The scene; the number N of a building is the seed that it is drawn from.",
    ),
]
"""Option: scenes."""


@dataclass(frozen=True, kw_only=True)
class SceneOptions:
    """Options of the benchmarks that replay walks."""

    scenes: Scenes
    output: OutputPath
    """Directory for recordings, results and summary.json; an interrupted benchmark with the same output continues."""
    overwrite: Overwrite = False
    models: tuple[str, ...] = ()
    """Model file, or name of a model that ships, for each scene. Default: the scenes' names; none ships for the
    corridor or for a building."""

    def __post_init__(self) -> None:
        require_each_once("scenes", self.scenes)
        for scene in self.scenes:
            if not is_scene(scene) or not find_scene(scene).has_cues:
                raise VaporTrackError(f"unknown scene {scene!r}, expected one of {', '.join(SCENE_NAMES)}")
        if len(self.models) not in (0, len(self.scenes)):
            raise VaporTrackError(f"{len(self.models)} models for {len(self.scenes)} scenes, expected one for each")

    @property
    def model_of(self) -> dict[str, str]:
        """The model by scene."""
        return dict(zip(self.scenes, self.models or self.scenes, strict=True))

    @property
    def files_read(self) -> list[Path]:
        """The model files."""
        return [find_model(model) for model in self.model_of.values()]


def require_each_once(what: str, chosen: Sequence[str], known: Mapping[str, Any] | None = None) -> None:
    """Check names that are chosen: at least one, each once, and known ones.

    Raises:
        VaporTrackError: they are others.
    """
    if not chosen or len(set(chosen)) < len(chosen):
        raise VaporTrackError(f"{what} are {', '.join(chosen) or 'none'}, expected each at most once, and one")
    for name in chosen:
        if known is not None and name not in known:
            raise VaporTrackError(f"unknown {what.removesuffix('s')} {name!r}, expected one of {', '.join(known)}")


SummaryPath = Annotated[
    Path | None, tyro.conf.arg(help="File for the figures of the table, too, as JSON, new or written so before.")
]
"""Option: where else the rows of a table go."""


def claim_summary(file: Path | None) -> None:
    """Refuse a file that is something else than `write_rows` writes, before anything is measured; make its folder."""
    if file is None:
        return
    if file.exists() and not is_report(file, ("rows",)):
        raise VaporTrackError(f"{file}: exists and is no summary of a benchmark, expected a new file or one")
    file.parent.mkdir(parents=True, exist_ok=True)


def write_rows(file: Path | None, rows: Iterable[Mapping[str, Any]]) -> None:
    """Write the rows of a table, if asked for; no number is infinite or NaN: such ones are None."""
    if file is not None:
        write_report(file, {"rows": [{name: _known(value) for name, value in row.items()} for row in rows]})


def _known(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _known(each) for name, each in value.items()}
    return None if isinstance(value, float) and not math.isfinite(value) else value


def described(meanings: Mapping[str, str]) -> str:
    """The entries of a table, as a help text has them."""
    return "; ".join(f"{name}: {meaning}" for name, meaning in meanings.items())


def write_summary(o: SceneOptions, settings: Mapping[str, Any], summary: Mapping[str, Any], **more: Any) -> None:
    """Write summary.json."""
    settings = {**settings, "models": o.model_of or o.models}
    write_report(o.output / "summary.json", {"settings": settings, "summary": summary, **more})
