"""The tables of `vapor-track benchmark localization`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table

from vapor.evaluate import FILES, REGIONS, THRESHOLDS
from vapor.summary import OFTEN, WITHIN_IMAGES

Aggregate = Mapping[str, Any]
Summary = Mapping[str, Mapping[str, Mapping[str, Aggregate]]]

_KINDS = {
    "cue": "something unique in the first half",
    "no-cue": "nothing unique",
    "kidnap": "carried off",
    "standing": "standing for five minutes where nothing is unique",
    "rate-3": "3 images a second",
    "rate-10": "10 images a second",
    "rate-30": "30 images a second",
}
_STATES = ("converged", "ambiguous", "lost")
_BELIEVERS = ("filter", "kalman", "gaussian_sum")
_OWN = {
    "cue": ("success", "conv.\nat"),
    "no-cue": ("wrong\nruns", "often\nwrong"),
    "kidnap": (f"within\n{WITHIN_IMAGES}", "median\nimages"),
}


def tables(summary: Summary) -> Iterator[Table]:
    """Per scene and kind of run: the methods, how honest they are, after a kidnap their recovery, and the variants."""
    for scene, kinds in summary.items():
        for kind, variants in kinds.items():
            shown, total = ("full", variants["full"]) if "full" in variants else next(iter(variants.items()))
            of_variant = "" if shown == "full" else f", filter {shown}"
            yield _methods_table(f"{scene}, {_KINDS[kind]}: {total['runs']} runs{of_variant}", total)
            yield _honesty_table(total)
            if kind == "kidnap":
                yield _recovery_table(total)
            if len(variants) > 1:
                yield _variants_table(kind, variants)


def failures(summary: Summary) -> Iterator[str]:
    """A line for every scene, kind and variant in which runs failed, with their names."""
    for kinds in summary.values():
        for variants in kinds.values():
            for variant, total in variants.items():
                if total["failed"]:
                    yield f"failed, {variant}: {' '.join(total['failed'])}"


def _methods_table(title: str, total: Aggregate) -> Table:
    limits = " ".join(f"{name:>10}" for name in THRESHOLDS)
    table = _table(title, "method", "success", "converged\nat", "median\nerror", f"recall, %\n{limits}")
    for name in FILES:
        method = total["methods"][name]
        tracking = "successes" in method
        table.add_row(
            name.replace("_", " "),
            str(method["successes"]) if tracking else "",
            _number(method["converged_at_s"], ".1f", " s") if tracking else "",
            f"{method['median_translation_m']:.2f} m {method['median_rotation_deg']:5.1f}°",
            _recalls(method["recall"]),
        )
        if tracking:
            table.add_row("  from convergence on", "", "", "", _recalls(method["recall_after_convergence"]))
    return table


def _honesty_table(total: Aggregate) -> Table:
    """Twice two rows: over the images that say "converged", and over those from when on the method was right."""
    regions = [f"in {region.replace('%', ' %')}\nregion" for region in REGIONS]
    table = _table(None, "over the images", "number", "wrong", *regions, "median\nNEES (5.3)")
    caption = []
    for method in _BELIEVERS:
        belief = total["belief"][method]
        for key, meaning in (("said_converged", "said converged"), ("after_convergence", "from convergence on")):
            part = belief[key]
            shares = [part["wrong"], *(part["coverage"][region] for region in REGIONS)]
            table.add_row(
                f"{method}, {meaning}",
                str(part["images"]),
                *(_share(share, 1) for share in shares),
                _number(part["median_nees"], ".1f"),
            )
        states = ", ".join(f"{_share(belief['status'][state])} {state}" for state in _STATES)
        caption += [
            f"{method}: {states}; truth among its modes in {_share(belief['truth_among_modes'])} of the images; false"
            f" recoveries: {belief['false_recoveries']} in {belief['runs_with_false_recovery']} runs",
            f"{method}: converged to a wrong place in {belief['runs_wrongly_converged']} runs, in at least"
            f" {100 * OFTEN:.0f} % of the images of {belief['runs_wrongly_converged_often']}",
        ]
    caption.append(
        f"single image: truth among its modes in {_share(total['image_truth_among_modes'])};"
        f" a step of the filter: {total['step_ms']:.1f} ms, {total['particles']:.0f} particles"
    )
    table.caption = "\n".join(caption)
    return table


def _recovery_table(total: Aggregate) -> Table:
    table = _table(None, "method", "right before", f"right within {WITHIN_IMAGES} images", "ever", "median images")
    for method in _BELIEVERS:
        kidnap = total["belief"][method]["kidnap"]
        numbers = [str(kidnap[key]) for key in ("right_before", "recovered_in_time", "recovered")]
        table.add_row(method, *numbers, _number(kidnap["median_images"], ".0f"))
    return table


def _variants_table(kind: str, variants: Mapping[str, Aggregate]) -> Table:
    table = Table(
        "variant",
        *_OWN[_like(kind)],
        "recall\n0.3 m",
        "conv./amb./\nlost, %",
        "and\nwrong",
        "in\n95 %",
        "NEES",
        "truth in\nmodes",
        "false\nrec.",
        "step",
        box=SIMPLE_HEAD,
        collapse_padding=True,
    )
    for column in table.columns[1:]:
        column.justify = "right"
    for variant, total in variants.items():
        belief, said = total["belief"]["filter"], total["belief"]["filter"]["said_converged"]
        table.add_row(
            variant,
            *_own_figures(kind, total),
            _share(total["methods"]["filter"]["recall"]["0.3m/20deg"]),
            "/".join(f"{100 * belief['status'][state]:.0f}" for state in _STATES),
            _share(said["wrong"], 1),
            _share(said["coverage"]["95%"]),
            _number(said["median_nees"], ".1f"),
            _share(belief["truth_among_modes"]),
            str(belief["false_recoveries"]),
            f"{total['step_ms']:.0f} ms",
        )
    return table


def _own_figures(kind: str, total: Aggregate) -> tuple[str, str]:
    """The two figures that a kind of run is about, as headed by `_OWN`."""
    belief, method = total["belief"]["filter"], total["methods"]["filter"]
    kind = _like(kind)
    if kind == "cue":
        return str(method["successes"]), _number(method["converged_at_s"], ".1f", " s")
    if kind == "no-cue":
        return str(belief["runs_wrongly_converged"]), str(belief["runs_wrongly_converged_often"])
    return str(belief["kidnap"]["recovered_in_time"]), _number(belief["kidnap"]["median_images"], ".0f")


def _like(kind: str) -> str:
    """The kind of run whose figures tell of this one."""
    return {"standing": "no-cue"}.get(kind, "cue" if kind.startswith("rate-") else kind)


def _table(title: str | None, *columns: str) -> Table:
    table = Table(title=title, title_justify="left", caption_justify="left")
    for i, column in enumerate(columns):
        table.add_column(column, justify="left" if i == 0 else "right")
    return table


def _recalls(recall: Mapping[str, float | None]) -> str:
    return " ".join("–".rjust(10) if share is None else f"{100 * share:10.0f}" for share in recall.values())


def _share(value: float | None, digits: int = 0) -> str:
    return "–" if value is None else f"{100 * value:.{digits}f} %"


def _number(value: float | None, form: str, unit: str = "") -> str:
    return "–" if value is None else f"{value:{form}}{unit}"
