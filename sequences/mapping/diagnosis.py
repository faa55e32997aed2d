"""What went wrong with a map, in words: why there is no model, and what of the images is not in it."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence

import numpy as np
from jaxtyping import Bool

from filtering.errors import counted, listed
from sequences.mapping.colmap import LEAST, Match, Reconstructed
from sequences.mapping.walks import Walk

_FEW_FEATURES = 100  # of an image, too few to place it reliably
_STILL = 0.005  # of the width of the image: way of its features from the first image to the last
_WINDOW = 5  # images before and behind a moment that are compared to find a cut
_MOST = 3  # things named of a kind
_LARGE_MODEL = 0.1  # of the images: a part of the place, not a few images that fit by accident


def why_no_model(walks: Sequence[Walk], found: Reconstructed) -> str:
    """The likeliest reason why no image could be placed, and what to do."""
    total = len(found.num_features)
    poor = found.num_features < _FEW_FEATURES
    if poor.mean() > 0.5:
        return (
            f"{poor.sum()} of {total} images have hardly any features (median {np.median(found.num_features):.0f}):"
            " plain walls, darkness or blur; expected something textured in view, in good light"
        )
    matches = found.matches
    if not matches or len({image for m in matches for image in (m.first, m.second)}) < LEAST:
        return (
            "hardly any two images show the same, expected a walk that looks at everything several times; where the"
            " camera is fast, take more images a second (--per-second)"
        )
    shifts = np.array([match.shift for match in matches])
    if np.quantile(shifts, 0.9) < _STILL:
        return "the picture stands still: all images are alike, expected a camera that walks through the place"
    turned = np.mean([match.turned for match in matches])
    if turned > 0.5:
        return (
            f"the camera turned on the spot: in {100 * turned:.0f} % of the pairs of images a rotation explains all"
            " (or all is on one plane), expected a camera that walks, as distances show by parallax only"
        )
    return (
        f"no {LEAST} images fit together: too little parallax, or places that look alike; expected a slow walk with"
        " something textured in view"
    )


def what_is_missing(
    walks: Sequence[Walk], placed: Bool[np.ndarray, " n"], others: Sequence[Collection[int]], matches: Sequence[Match]
) -> Iterator[str]:
    """Sentences on images that are not in the model.

    Args:
        walks: The walks, of n images together.
        placed: Whether each image is in the model.
        others: Indices of the images of each other model.
        matches: Images that show the same.
    """
    begin = 0
    for walk in walks:
        of_walk = placed[begin : begin + len(walk.pictures)]
        if not of_walk.any():
            why = _unconnected(begin, of_walk, placed, matches)
            yield f"{walk.name}: none of its {counted(len(of_walk), 'image')} is placed: {why}"
        elif not of_walk.all():
            spans = _spans(walk, ~of_walk)
            yield f"{walk.name}: {(~of_walk).sum()} of {len(of_walk)} images are not placed: {spans}"
        yield from _cuts(walk, begin, of_walk, matches)
        begin += len(of_walk)
    large = [some for some in others if len(some) >= max(_LARGE_MODEL * len(placed), LEAST)]
    for some in large[:_MOST]:
        yield (
            f"{len(some)} images form a model of their own, which is left out: {_spans_of(walks, some)}; film the way"
            " from there to the rest, slowly"
        )


def _unconnected(
    begin: int, of_walk: Bool[np.ndarray, " k"], placed: Bool[np.ndarray, " n"], matches: Sequence[Match]
) -> str:
    own = range(begin, begin + len(of_walk))
    links = sum((m.first in own) != (m.second in own) and (placed[m.first] or placed[m.second]) for m in matches)
    if not links:
        return "nothing in it was recognised in the other walks; expected walks over the same ground"
    return f"too few pairs with placed images look alike: {links}"


def _cuts(walk: Walk, begin: int, placed: Bool[np.ndarray, " k"], matches: Sequence[Match]) -> Iterator[str]:
    """Moments of a walk over which no two near images match, as far as one side of it is not placed."""
    across = np.zeros(len(placed) + 1, bool)
    for match in matches:
        first, second = match.first - begin, match.second - begin
        if 0 <= first < second < len(placed) and second - first <= 2 * _WINDOW:
            across[first + 1 : second + 1] = True
    unconnected = (np.flatnonzero(~across[1:-1]) + 1).tolist()
    inside = [k for k in unconnected if _WINDOW <= k <= len(placed) - _WINDOW]
    cuts = [k for k in inside if not (placed[:k].any() and placed[k:].any())]
    if cuts:
        named = ", ".join(walk.when(k) for k in cuts[:_MOST])
        yield f"{walk.name}: the images before and after {named} show nothing in common: a cut, or too fast a turn"


def _spans(walk: Walk, which: Bool[np.ndarray, " k"]) -> str:
    """The times of runs of images, or of the longest ones and the number of the others."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], which, [False]]).astype(int)))
    runs = sorted(zip(edges[::2].tolist(), (edges[1::2] - 1).tolist(), strict=True), key=lambda run: run[0] - run[1])
    named = [
        walk.when(first) if first == last else f"{walk.when(first)} to {walk.when(last)}"
        for first, last in [*sorted(runs[:_MOST]), *runs[_MOST:]]
    ]
    return listed(named, _MOST)


def _spans_of(walks: Sequence[Walk], indices: Collection[int]) -> str:
    begin, named = 0, []
    for walk in walks:
        which = np.isin(np.arange(begin, begin + len(walk.pictures)), [*indices])
        if which.any():
            named.append(f"{walk.name} {_spans(walk, which)}")
        begin += len(walk.pictures)
    return "; ".join(named)
