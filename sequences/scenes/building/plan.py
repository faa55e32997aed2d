"""What is where in a building, in two dimensions, before anything is built of it.

A building has levels alike in plan. A block is a corridor with slots along both sides: rooms, closed doors, windows,
stairwells, or a wing, which is a block of its own that begins there. All is told in frames turned about z: a block's
x runs along its corridor from one end wall to the other, and y across it; a room's x runs along the wall with its
door, and y away from the corridor.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float64

DOOR_WIDTH, DOOR_HEIGHT = 0.95, 2.08  # metres
SlotKind = Literal["room", "door", "window", "stairs", "wing"]


@dataclass(frozen=True)
class Spot:
    """A frame turned about z: origin in metres and heading in radians."""

    x: float
    y: float
    heading: float

    def within(self, outer: Spot) -> Spot:
        """The same frame, told in the frame that `outer` is told in; this one is told in `outer`."""
        x, y = outer.points(np.array([[self.x, self.y]]))[0]
        return Spot(float(x), float(y), outer.heading + self.heading)

    def points(self, xy: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 2"]:
        """Points (n, 2) of this frame in the frame that it is told in."""
        cos, sin = np.cos(self.heading), np.sin(self.heading)
        return xy @ np.array([[cos, sin], [-sin, cos]]) + np.array([self.x, self.y])


@dataclass(frozen=True)
class Slot:
    """A segment of one side of a corridor, and what is behind it.

    Attributes:
        kind: What is there.
        high: On the side of high y of the block, or of low y.
        begin, end: Where along the corridor, metres.
        door: Centre of the door along the corridor; of stairs and wings the middle.
        look: Which of the building's kinds of rooms; of a closed door, how its leaf is painted.
        variant: 0 for rooms that are furnished alike; any other number for one that is furnished in its own way.
    """

    kind: SlotKind
    high: bool
    begin: float
    end: float
    door: float
    look: int = 0
    variant: int = 0


@dataclass(frozen=True)
class Block:
    """A corridor with slots.

    Attributes:
        frame: Of the block in the world.
        length, width: Of the corridor, metres.
        slots: Along its sides.
        open_start: Whether it begins at the opening of another block and has no wall there.
    """

    frame: Spot
    length: float
    width: float
    slots: tuple[Slot, ...]
    open_start: bool = False


@dataclass(frozen=True)
class Stairs:
    """Two flights with a half landing between them: metres, and the number of risers of a flight.

    Flights are at the low and high end of x of the slot, landings before and behind them along y.
    """

    flight_width: float
    well: float
    landing: float
    half_landing: float
    risers: int
    going: float
    mirrored: bool

    @property
    def width(self) -> float:
        """Of the stairwell in x."""
        return 2 * self.flight_width + self.well

    @property
    def run(self) -> float:
        """Length of a flight in y."""
        return (self.risers - 1) * self.going

    @property
    def depth(self) -> float:
        """Of the stairwell in y."""
        return self.landing + self.run + self.half_landing

    @property
    def up_x(self) -> tuple[float, float]:
        """Where the flight is that leads up from a level."""
        w = self.flight_width
        return (self.width - w, self.width) if self.mirrored else (0.0, w)

    @property
    def down_x(self) -> tuple[float, float]:
        """Where the flight arrives that leads up from the level below."""
        w = self.flight_width
        return (0.0, w) if self.mirrored else (self.width - w, self.width)


@dataclass(frozen=True)
class Plan:
    """What a building's number draws of its shape.

    Attributes:
        number: Of the building.
        levels: How many floors there are.
        storey, slab: From floor to floor, and how thick the floor between is, metres.
        wall: Thickness of the walls, metres.
        blocks: The main corridor, and its wing where there is one.
        depth_high, depth_low: Of the rooms on either side, metres.
        stairs: All stairwells are alike.
        kinds: What kinds of rooms there are; a slot's `look` is an index into it.
        styles: For each level the palette it wears; levels of one palette look the same but for what is unique.
        cues_per_level: How many unique things hang on a level, on average.
        signs: Whether the number of the level is painted by the stairs.
    """

    number: int
    levels: int
    storey: float
    slab: float
    wall: float
    blocks: tuple[Block, ...]
    depth_high: float
    depth_low: float
    stairs: Stairs
    kinds: tuple[str, ...]
    styles: tuple[int, ...]
    cues_per_level: float
    signs: bool

    @property
    def clear(self) -> float:
        """Height of corridors and rooms, metres."""
        return self.storey - self.slab

    def rng(self, *what: int) -> np.random.Generator:
        """Random numbers of this building for one purpose."""
        return np.random.default_rng([2718, self.number, *what])

    def depth(self, slot: Slot) -> float:
        """Of the room behind a slot, metres."""
        return self.depth_high if slot.high else self.depth_low

    def frame_of(self, block: Block, slot: Slot) -> Spot:
        """The frame of the room or stairwell behind a slot, in the world; its x and y begin at its inner walls."""
        half = self.wall / 2 if slot.kind == "room" else 0.0
        if slot.high:
            return Spot(slot.begin + half, block.width + self.wall, 0.0).within(block.frame)
        return Spot(slot.end - half, -self.wall, np.pi).within(block.frame)

    def slots(self, *kinds: SlotKind) -> list[tuple[Block, Slot]]:
        """All slots of some kinds, block by block."""
        return [(block, slot) for block in self.blocks for slot in block.slots if slot.kind in kinds]
