"""Monotone rational-quadratic splines of [0, 1] onto itself: their slopes are densities, their inverses draw.

Sources: Durkan et al., "Neural spline flows", NeurIPS 2019; on the circle, Rezende et al., "Normalizing flows on tori
and spheres", ICML 2020.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from vapor.regressors.traceable import count_below

_LEAST_WIDTH, _LEAST_HEIGHT = 1e-3, 1e-5  # of a bin: sharpest density, and what float32 resolves
_STEEPEST = 3.0  # log ratio of the slope at a knot and that of the bins beside it, at most


@dataclass(frozen=True)
class Spline:
    """Monotone maps of [0, 1] onto itself, rational quadratics between knots.

    Attributes:
        x: Knots in the coordinate.
        y: Their images: how much of the distribution lies below.
        slope: dy/dx at the knots.
    """

    x: Float[Tensor, "b n k"]
    y: Float[Tensor, "b n k"]
    slope: Float[Tensor, "b n k"]

    @staticmethod
    def of(raw: Float[Tensor, "b n r"], *, circular: bool) -> Spline:
        """From any numbers, three for each bin; on a circle both ends have one slope, as they are one point."""
        widths, heights, steepness = raw.unflatten(-1, (3, -1)).unbind(dim=-2)
        widths, heights = _fractions(widths, _LEAST_WIDTH), _fractions(heights, _LEAST_HEIGHT)
        log_slope = (heights / widths).log()
        before = log_slope.roll(1, dims=-1) if circular else torch.cat([log_slope[..., :1], log_slope[..., :-1]], -1)
        at_knots = 0.5 * (before + log_slope) + _STEEPEST * torch.tanh(steepness / _STEEPEST)
        last = at_knots[..., :1] if circular else log_slope[..., -1:]
        return Spline(_knots(widths), _knots(heights), torch.cat([at_knots, last], dim=-1).exp())

    def log_slope(self, x: Float[Tensor, "b n"]) -> Float[Tensor, "b n"]:
        """Log dy/dx: the log density of x where y is uniform."""
        x0, _, width, height, first, second = self._bin(self.x, x)
        mean = height / width
        inside = ((x - x0) / width).clamp(0.0, 1.0)
        both = inside * (1.0 - inside)
        above = second * inside.square() + 2 * mean * both + first * (1.0 - inside).square()
        return 2 * mean.log() + above.log() - 2 * (mean + (first + second - 2 * mean) * both).log()

    def inverse(self, y: Float[Tensor, "b n"]) -> Float[Tensor, "b n"]:
        """The x of each y."""
        x0, y0, width, height, first, second = self._bin(self.y, y)
        mean, rise = height / width, (y - y0).clamp_min(0.0)
        bend = rise * (first + second - 2 * mean)
        a, b, c = height * (mean - first) + bend, height * first - bend, -mean * rise
        inside = 2 * c / (-b - (b.square() - 4 * a * c).clamp_min(0.0).sqrt())
        return (x0 + width * inside.clamp(0.0, 1.0)).clamp(0.0, 1.0)

    def _bin(self, knots: Tensor, at: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]:
        """x, y, width, height, and the slopes at both ends of the bin in which `at` lies among the knots."""
        left = count_below(knots[..., 1:-1].detach(), at[..., None], or_equal=True)
        (x0, x1), (y0, y1), (first, second) = (
            (values.gather(-1, left)[..., 0], values.gather(-1, left + 1)[..., 0])
            for values in (self.x, self.y, self.slope)
        )
        return x0, y0, x1 - x0, y1 - y0, first, second


def _fractions(raw: Float[Tensor, "*batch k"], least: float) -> Float[Tensor, "*batch k"]:
    """Positive numbers of sum 1, none below `least` (or half of an equal fraction, where that is less)."""
    bins = raw.shape[-1]
    least = min(least, 0.5 / bins)
    return least + (1.0 - bins * least) * torch.softmax(raw, dim=-1)


def _knots(fractions: Float[Tensor, "*batch k"]) -> Float[Tensor, "*batch l"]:
    """From 0 to 1, l = k + 1."""
    sums = fractions[..., :-1].cumsum(dim=-1)
    zero = 0.0 * sums[..., :1]  # by arithmetic, which keeps sizes open while a network is traced
    return torch.cat([zero, sums, zero + 1.0], dim=-1)
