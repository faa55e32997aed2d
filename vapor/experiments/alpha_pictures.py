"""Pictures of the α experiment: recall over α as boxes, and where the samples lie, as the paper shows them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np

from filtering.se3 import Poses
from sequences.scenes import tables
from vapor.experiments.alpha import MODES
from vapor.pictures import COLORS, new_figure, save_figure

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
        medians = PAPER_MEDIANS[scene]
        if paper:
            alphas_there = [0.01, *(0.05 * np.arange(1, len(medians)))]
            ax.plot(alphas_there, medians, ".--", color=COLORS["other"], lw=0.8, label="paper")
        ax.axvline(1 / MODES[scene], color="#888888", lw=0.8, ls=":", label=f"1 / {MODES[scene]} modes")
        ax.set(xlim=(-0.02, 1.03), ylim=(-0.03, 1.03), ylabel="recall", title=scene)
        ax.legend(loc="upper right", frameon=False)
    figure.axes[-1].set_xlabel("α")
    figure.suptitle(title, x=0.01, ha="left", fontsize=12, fontweight="bold")
    return save_figure(figure, path)


def draw_positions(
    path: Path, posteriors: Mapping[float, tuple[Poses, Sequence[Poses]]], scene: str, *, image: int
) -> Path:
    """Where the samples of one test image lie from above, for every α, over the outline of the table.

    Args:
        path: The picture, PNG.
        posteriors: By α: true poses of some images, and the samples of each.
        scene: Name of the scene.
        image: Which of the images.
    """
    figure = new_figure(3.4 * len(posteriors), 3.7)
    edges = np.linspace(-_REACH_M, _REACH_M, 105)
    for ax, (alpha, (truth, samples)) in zip(
        figure.subplots(1, len(posteriors), squeeze=False)[0], posteriors.items(), strict=True
    ):
        x, y, _ = samples[image].translation.T
        count, _, _ = np.histogram2d(x, y, bins=(edges, edges))
        ax.imshow(
            np.sqrt(count.T), origin="lower", extent=(-_REACH_M, _REACH_M) * 2, cmap="Blues", interpolation="bilinear"
        )
        ax.plot(*_outline(scene), color="#555555", lw=1.0)
        ax.plot(*truth[image].translation[:2], "x", color=COLORS["other"], label="true position")
        ax.set(title=f"α = {alpha:g}", xlabel="x [m]", ylabel="y [m]", aspect="equal")
    figure.axes[0].legend(loc="upper left", frameon=False, fontsize=8)
    figure.suptitle(scene, x=0.01, ha="left", fontsize=12, fontweight="bold")
    return save_figure(figure, path)


def _outline(scene: str) -> tuple[np.ndarray, np.ndarray]:
    if scene == "round-table":
        angle = np.linspace(0, 2 * np.pi, tables.ROUND_CORNERS + 1)
        return tables.ROUND_RADIUS * np.cos(angle), tables.ROUND_RADIUS * np.sin(angle)
    x, y = tables.DINNER_LENGTH / 2, tables.DINNER_BREADTH / 2
    return np.array([x, -x, -x, x, x]), np.array([y, y, -y, -y, y])
