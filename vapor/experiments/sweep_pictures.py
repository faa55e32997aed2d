"""Pictures of the sweeps: recall over α as boxes, figures over weight decay, and where the samples lie."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from filtering.se3 import Poses
from sequences.scenes import find_scene
from vapor.experiments.sweep import MODES, by_value
from vapor.reporting.colors import COLORS
from vapor.reporting.drawing import new_figure, save_figure

# Medians read off the paper's figure of recall at 0.1 m / 10° over α, at 0.01 and then in steps of 0.05.
PAPER_MEDIANS: Mapping[str, tuple[float, ...]] = MappingProxyType(
    {
        "round-table": (0.0, 0.05, 0.50, 0.69, 0.47, 0.45, 0.37, *[0.0] * 14),
        "dinner-table": (
            *(0.0, 0.46, 0.98, 0.98, 0.98, 0.94, 0.94, 0.94, 0.86, 0.80, 0.74),
            *(0.85, 0.78, 0.62, 0.48, 0.22, 0.0, 0.0, 0.0, 0.0, 0.0),
        ),
    }
)
_REACH_M = 2.6  # from the middle of the table; cameras come no further


def draw_recall(path: Path, recalls: Mapping[str, Mapping[float, Sequence[float]]], *, title: str, paper: bool) -> Path:
    """A box for every α: the quartiles of its runs, and beside them the medians that the paper's figure shows.

    Args:
        path: The picture, PNG.
        recalls: By scene and α, one for each run.
        title: What is drawn.
        paper: Whether the recall is the paper's, so that its medians may stand beside it.
    """
    figure = new_figure(9.5, 0.6 + 2.9 * len(recalls))
    for ax, (scene, by_alpha) in zip(
        figure.subplots(len(recalls), 1, squeeze=False)[:, 0], recalls.items(), strict=True
    ):
        alphas = sorted(by_alpha)
        boxes = ax.boxplot(
            [by_alpha[alpha] for alpha in alphas],
            positions=alphas,
            widths=0.022,
            manage_ticks=False,
            patch_artist=True,
            flierprops={"marker": ".", "markersize": 4},
            medianprops={"color": "black"},
        )
        for box in boxes["boxes"]:
            box.set(facecolor=COLORS["converged"], edgecolor=COLORS["filter"])
        if paper and scene in PAPER_MEDIANS:
            medians = PAPER_MEDIANS[scene]
            alphas_there = [0.01, *(0.05 * np.arange(1, len(medians)))]
            ax.plot(alphas_there, medians, ".--", color=COLORS["other"], lw=0.8, label="paper")
        ax.axvline(1 / MODES[scene], color="#888888", lw=0.8, ls=":", label=f"1 / {MODES[scene]} modes")
        ax.set(xlim=(-0.02, 1.03), ylim=(-0.03, 1.03), ylabel="recall", title=scene)
        ax.legend(loc="upper right", frameon=False)
    figure.axes[-1].set_xlabel("α")
    figure.suptitle(title, x=0.01, ha="left", fontsize=12, fontweight="bold")
    return save_figure(figure, path)


def draw_positions(
    path: Path, posteriors: Mapping[str, tuple[Poses, Sequence[Poses]]], scene: str, *, images: Sequence[int] = (0,)
) -> Path:
    """Where the samples of test images lie from above, over the outline of the table: a row an image.

    Args:
        path: The picture, PNG.
        posteriors: By what is written over a column: true poses of some images, and the samples of each.
        scene: Name of the scene.
        images: Which of the images.
    """
    figure = new_figure(3.4 * len(posteriors), 0.2 + 3.5 * len(images))
    axes = figure.subplots(len(images), len(posteriors), squeeze=False, sharex=True, sharey=True)
    edges = np.linspace(-_REACH_M, _REACH_M, 105)
    for column, (title, (truth, samples)) in zip(axes.T, posteriors.items(), strict=True):
        column[0].set_title(title)
        column[-1].set_xlabel("x [m]")
        for ax, image in zip(column, images, strict=True):
            x, y, _ = samples[image].translation.T
            count, _, _ = np.histogram2d(x, y, bins=(edges, edges))
            extent = (-_REACH_M, _REACH_M) * 2
            ax.imshow(np.sqrt(count.T), origin="lower", extent=extent, cmap="Blues", interpolation="bilinear")
            if (outline_m := find_scene(scene).outline_m) is not None:
                ax.plot(*outline_m.T, color="#555555", lw=1.0)
            ax.plot(*truth[image].translation[:2], "x", color=COLORS["other"], label="true position")
            ax.set_aspect("equal")
    for ax in axes[:, 0]:
        ax.set_ylabel("y [m]")
    axes[0, 0].legend(loc="upper left", frameon=False, fontsize=8)
    figure.suptitle(scene, x=0.01, ha="left", fontsize=12, fontweight="bold")
    return save_figure(figure, path)


def draw_decay(path: Path, results: Sequence[Mapping[str, Any]], threshold: str) -> Path:
    """Modes, recall and −log p̂ over the encoder's weight decay, of test and of training images: a row a scene.

    Args:
        path: The picture, PNG.
        results: Of `Sweep.train`, at least one of them without error; lines are medians of runs, dots the runs.
        threshold: Limits of what is near the true pose.
    """
    figures: dict[str, Callable[[Mapping[str, Any]], float]] = {
        "modes": lambda r: r["modes"],
        f"recall {threshold}": lambda r: r["recall"][threshold],
        "−log p̂ [nats]": lambda r: r["negative_log_density"],
    }
    scenes = list(by_value(results, "decay", lambda r: r["modes"]))
    figure = new_figure(11.0, 0.5 + 3.0 * len(scenes))
    axes = figure.subplots(len(scenes), len(figures), squeeze=False)
    for column, (name, value) in zip(axes.T, figures.items(), strict=True):
        test = by_value(results, "decay", value)
        training = by_value(results, "decay", lambda r, value=value: value(r["training"]))
        for ax, scene in zip(column, scenes, strict=True):
            for label, by_decay, color in (
                ("test images", test[scene], COLORS["filter"]),
                ("training images", training[scene], COLORS["single_image"]),
            ):
                where = range(len(by_decay))  # evenly: 0 has no place on a logarithmic axis
                ax.plot(where, [np.median(runs) for runs in by_decay.values()], color=color, label=label)
                for k, runs in zip(where, by_decay.values(), strict=True):
                    ax.plot([k] * len(runs), runs, ".", color=color)
            ax.set_xticks(range(len(test[scene])), [f"{decay:g}" for decay in test[scene]])
            ax.set(title=f"{scene}: {name}", xlabel="weight decay of the encoder")
            ax.spines[["top", "right"]].set_visible(False)
    for ax, scene in zip(axes[:, 0], scenes, strict=True):
        ax.axhline(MODES[scene], color="#888888", lw=0.8, ls=":", label="poses that look alike")
    axes[0, 0].legend(frameon=False, fontsize=8)
    return save_figure(figure, path)
