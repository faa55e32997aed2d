"""The tables of `vapor-track benchmark localization`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from rich.table import Table

from vapor.evaluate import FILES, REGIONS, THRESHOLDS
from vapor.summary import OFTEN, WITHIN_IMAGES

Aggregate = Mapping[str, Any]

_KINDS = {"cue": "something unique in the first half", "no-cue": "nothing unique", "kidnap": "carried off"}
_TRUE_NEES = "5.3 is true"


def tables(summary: Mapping[str, Mapping[str, Mapping[str, Aggregate]]]) -> Iterator[Table]:
    """Per scene and kind of run: the methods, their honesty, after a kidnap their recovery, and the variants."""
    for scene, kinds in summary.items():
        for kind, variants in kinds.items():
            full = variants.get("full") or next(iter(variants.values()))
            title = f"{scene}, {_KINDS[kind]}: {full['runs']} runs"
            yield _methods_table(title, full)
            yield _honesty_table(full)
            if kind == "kidnap":
                yield _recovery_table(full)
            if len(variants) > 1:
                yield _variants_table(kind, variants)


def failures(summary: Mapping[str, Mapping[str, Mapping[str, Aggregate]]]) -> Iterator[str]:
    """A line for every scene, kind and variant in which runs failed, with their names."""
    for kinds in summary.values():
        for variants in kinds.values():
            for variant, total in variants.items():
                if total["failed"]:
                    yield f"failed, {variant}: {', '.join(total['failed'])}"


def _methods_table(title: str, total: Aggregate) -> Table:
    after = [f"{name} after" for name in THRESHOLDS]
    table = _table(title, "method", "success", "converged at", "median error", *THRESHOLDS, *after)
    for name in FILES:
        method = total["methods"][name]
        tracking = "successes" in method
        table.add_row(
            name.replace("_", " "),
            str(method["successes"]) if tracking else "",
            _number(method["converged_at_s"], ".1f", " s") if tracking else "",
            f"{method['median_translation_m']:.2f} m {method['median_rotation_deg']:.1f}°",
            *(_share(method["recall"][threshold]) for threshold in THRESHOLDS),
            *(_share(method["recall_after_convergence"][threshold]) if tracking else "" for threshold in THRESHOLDS),
        )
    return table


def _honesty_table(total: Aggregate) -> Table:
    """Twice two rows: over the images that say "converged", and over those after the method was right to stay."""
    coverage = [f"in {region}" for region in REGIONS]
    states = ("converged", "ambiguous", "lost")
    table = _table(None, "over", "images", "wrong 0.5 m", *coverage, f"NEES ({_TRUE_NEES})", *states, "truth in modes")
    for method in ("filter", "kalman"):
        belief = total["belief"][method]
        of_all = [_share(belief["status"][state]) for state in states] + [_share(belief["truth_among_modes"])]
        for key, meaning, more in (
            ("said_converged", "said converged", of_all),
            ("after_convergence", "from convergence on", [""] * len(of_all)),
        ):
            part = belief[key]
            table.add_row(
                f"{method}, {meaning}",
                str(part["images"]),
                _share(part["wrong"], 1),
                *(_share(part["coverage"][region], 1) for region in REGIONS),
                _number(part["median_nees"], ".1f"),
                *more,
            )
    belief, kalman = total["belief"]["filter"], total["belief"]["kalman"]
    table.caption = (
        f"runs converged to a wrong place in any image: {belief['runs_wrongly_converged']} (kalman"
        f" {kalman['runs_wrongly_converged']}), in {100 * OFTEN:.0f} % of their images:"
        f" {belief['runs_wrongly_converged_often']} (kalman {kalman['runs_wrongly_converged_often']}); false recoveries:"
        f" {belief['false_recoveries']} in {belief['runs_with_false_recovery']} runs; truth among the modes of the"
        f" single image: {_share(total['image_truth_among_modes'])}; a step takes {total['step_ms']:.1f} ms"
    )
    return table


def _recovery_table(total: Aggregate) -> Table:
    table = _table(None, "method", "right before", f"right within {WITHIN_IMAGES} images", "ever", "median images")
    for method in ("filter", "kalman"):
        kidnap = total["belief"][method]["kidnap"]
        numbers = [str(kidnap[key]) for key in ("right_before", "recovered_within_50", "recovered")]
        table.add_row(method, *numbers, _number(kidnap["median_images"], ".0f"))
    return table


def _variants_table(kind: str, variants: Mapping[str, Aggregate]) -> Table:
    first = {"cue": ("success",), "no-cue": ("wrong at all", "wrong often"), "kidnap": ("within 50", "median images")}
    table = _table(
        None, "variant", *first[kind], "0.3m/20deg", "converged", "and wrong", "in 95%", "NEES", "ambiguous", "lost",
        "truth in modes", "false rec.", "step",
    )  # fmt: skip
    for variant, total in variants.items():
        belief = total["belief"]["filter"]
        method = total["methods"]["filter"]
        if kind == "cue":
            own = [str(method["successes"])]
        elif kind == "no-cue":
            own = [str(belief["runs_wrongly_converged"]), str(belief["runs_wrongly_converged_often"])]
        else:
            kidnap = belief["kidnap"]
            own = [str(kidnap["recovered_within_50"]), _number(kidnap["median_images"], ".0f")]
        said = belief["said_converged"]
        table.add_row(
            variant,
            *own,
            _share(method["recall"]["0.3m/20deg"]),
            _share(belief["status"]["converged"]),
            _share(said["wrong"], 1),
            _share(said["coverage"]["95%"], 1),
            _number(said["median_nees"], ".1f"),
            _share(belief["status"]["ambiguous"]),
            _share(belief["status"]["lost"]),
            _share(belief["truth_among_modes"]),
            str(belief["false_recoveries"]),
            f"{total['step_ms']:.1f} ms",
        )
    return table


def _table(title: str | None, *columns: str) -> Table:
    table = Table(title=title, title_justify="left", caption_justify="left")
    for i, column in enumerate(columns):
        table.add_column(column, justify="left" if i == 0 else "right")
    return table


def _share(value: float | None, digits: int = 0) -> str:
    return "–" if value is None else f"{100 * value:.{digits}f} %"


def _number(value: float | None, form: str, unit: str = "") -> str:
    return "–" if value is None else f"{value:{form}}{unit}"
