"""Options and output folders of the benchmarks."""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, make_dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_type_hints

import tyro

from filtering.errors import VaporTrackError
from sequences.outputs import MANIFEST, claim_folder, own_manifest, short_list
from sequences.scenes import find_scene, is_scene, scene_names
from vapor.benchmark import PROGRAM
from vapor.checkpoints.file_format import find_model
from vapor.commands.console import Overwrite, path_given_by, path_or_url_to_write
from vapor.commands.workers import Scheduler
from vapor.parallel.jobs import Workers
from vapor.reporting.report import write_report
from vapor.storage import fetched, listed, published, url_of

SharedOutputPath = Annotated[Path, path_given_by(path_or_url_to_write)]
"""A path or a URL to write to, which is not empty; of a URL it is the path of the copy."""


def claim_shared(
    directory: Path, command: str, workers: Workers, *, reads: Iterable[Path] = (), overwrite: bool = False
) -> None:
    """As `claim_folder`, of a folder that all workers see, or of the copy of a URL's folder.

    Raises:
        VaporTrackError: as there, a worker does not see the folder, or the storage cannot be used.
    """
    if (url := url_of(directory)) is not None:
        names = sorted({file.relative_to(directory).parts[0] for file in listed(directory) if file != directory})
        fetched(directory / MANIFEST)
        if own_manifest(directory) is None:
            if names and not overwrite:
                expected = f"expected an empty folder or one of `{PROGRAM} {command}`"
                raise VaporTrackError(f"{url}: {short_list(names)}, {expected}; --overwrite uses it all the same")
            shutil.rmtree(directory, ignore_errors=True)  # of what is no longer there
    claim_folder(directory, f"{PROGRAM} {command}", reads=reads, overwrite=overwrite)
    workers.require_to_see(directory)
    published(directory / MANIFEST)


def publish_results(directory: Path) -> None:
    """Write the result files of a command to the folder's URL, if it has one."""
    for file in sorted(directory.iterdir()) if url_of(directory) is not None else ():
        if file.is_file():
            published(file)


Config = TypeVar("Config")

SCENE_NAMES = scene_names(with_cues=True)
"""Scenes to choose from: others show nothing by which the filter could find itself."""


@dataclass(frozen=True, kw_only=True)
class SceneOptions:
    """Options of the benchmarks that replay walks."""

    scenes: Annotated[
        tyro.conf.Positional[tuple[str, ...]],
        tyro.conf.arg(metavar=f"{{{','.join(SCENE_NAMES)}}} ..."),
    ]
    """The scene; the number N of a building is the seed that it is drawn from."""
    output: SharedOutputPath
    """Directory for recordings, results and summary.json, or its URL; an interrupted benchmark with the same output
    continues."""
    overwrite: Overwrite = False
    models: tuple[str, ...] = ()
    """Model file, or name of a model that ships, for each scene. Default: the scenes' names; none ships for the
    corridor or for a building."""
    scheduler: Scheduler = None

    def __post_init__(self) -> None:
        if not self.scenes or len(set(self.scenes)) < len(self.scenes):
            raise VaporTrackError(f"scenes are {', '.join(self.scenes) or 'none'}, expected each at most once, and one")
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


def with_help(config: type[Config], **texts: str) -> type[Config]:
    """The same settings with help texts for some options, given by the names of their fields."""
    hints = get_type_hints(config, include_extras=True)
    documented = [
        (name, Annotated[hints[name], tyro.conf.arg(help=text)], getattr(config, name)) for name, text in texts.items()
    ]
    namespace = {"__doc__": config.__doc__}
    return make_dataclass(config.__name__, documented, bases=(config,), frozen=True, namespace=namespace)


def described(meanings: Mapping[str, str]) -> str:
    """The entries of a table, as a help text has them."""
    return "; ".join(f"{name}: {meaning}" for name, meaning in meanings.items())


def write_summary(
    o: SceneOptions, settings: Mapping[str, Any], summary: Mapping[str, Any], results: Sequence[Any], **more: Any
) -> None:
    """Write summary.json."""
    settings = {
        **settings,
        "models": o.model_of or o.models,
    }
    write_report(o.output / "summary.json", {"settings": settings, "summary": summary, "runs": results, **more})
