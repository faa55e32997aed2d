"""What furniture there is in a building, and which of it a room gets."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sequences.scenes.building.furniture import fixtures, storage, tables
from sequences.scenes.building.furniture.piece import Piece

WANTED = {
    "office": ("desk", "desk", "shelf", "cabinet", "plant", "desk", "shelf", "bin", "desk", "cabinet"),
    "bedroom": ("bed", "wardrobe", "cabinet", "rack", "plant", "desk", "bed", "shelf"),
    "kitchen": ("counter", "fridge", "counter", "cabinet", "bin", "counter", "rack", "plant"),
    "class": ("board", "cabinet", "shelf", "bin", "board", "lockers", "cabinet", "shelf"),
    "living": ("sofa", "television", "shelf", "plant", "armchair", "cabinet", "shelf", "plant"),
    "store": ("rack", "rack", "boxes", "rack", "boxes", "lockers", "rack", "rack", "boxes", "bin"),
    "library": ("shelf", "shelf", "shelf", "shelf", "armchair", "shelf", "shelf", "plant", "shelf", "shelf"),
}
"""What a room of each kind gets as far as there is space for it, in this order."""

MIDDLE = {
    "office": "place",
    "bedroom": "rug",
    "kitchen": "dining",
    "class": "place",
    "living": "low table",
    "store": "crates",
    "library": "dining",
}
"""What stands in the middle of a room of each kind, once or in rows."""


def draw_furniture(rng: np.random.Generator) -> dict[str, Piece]:
    """The furniture of one building: a piece of each type, in its sizes and colours."""
    makers: dict[str, Callable[[np.random.Generator], Piece]] = {
        "desk": tables.desk,
        "shelf": storage.shelf,
        "cabinet": storage.cabinet,
        "plant": fixtures.plant,
        "bin": storage.waste_bin,
        "bed": tables.bed,
        "wardrobe": storage.wardrobe,
        "rack": storage.rack,
        "counter": storage.counter,
        "fridge": storage.fridge,
        "board": fixtures.board,
        "sofa": tables.sofa,
        "armchair": tables.armchair,
        "television": fixtures.television,
        "boxes": storage.boxes,
        "lockers": storage.lockers,
        "place": tables.place,
        "dining": tables.dining,
        "low table": tables.low_table,
        "rug": tables.rug,
        "crates": storage.crates,
    }
    streams = rng.spawn(len(makers))
    return {name: make(stream) for (name, make), stream in zip(makers.items(), streams, strict=True)}
