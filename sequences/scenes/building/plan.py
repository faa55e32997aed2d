"""The plan of a building, in two dimensions, drawn from its number.

A building has levels alike in plan. A block is a corridor with slots along both sides: rooms, closed doors, windows,
stairwells, or a wing, which is a block of its own that begins there. Frames are turned about z: a block's x runs along
its corridor from one end wall to the other, and y across it; a room's x runs along the wall with its door, and y away
from the corridor.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
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
        """The same frame, from coordinates of `outer` to those that `outer` is given in."""
        x, y = outer.points(np.array([[self.x, self.y]]))[0]
        return Spot(float(x), float(y), outer.heading + self.heading)

    def points(self, xy: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 2"]:
        """Points (n, 2) of this frame in the outer one."""
        cos, sin = np.cos(self.heading), np.sin(self.heading)
        return xy @ np.array([[cos, sin], [-sin, cos]]) + np.array([self.x, self.y])


@dataclass(frozen=True)
class Slot:
    """A segment of one side of a corridor, of high y or low y of the block, and the kind of space behind it.

    It runs from `begin` to `end` along the corridor, metres, with a door centred on `door`: stairs and wings have their
    middle there. `look` chooses the building's kind of rooms, or the paint of a closed door. Rooms of variant 0 are
    furnished alike, those of any other number each in its own way.
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
    """A corridor of a length and width in metres, with slots along its sides; the frame is in the world.

    With `open_start` it begins at the opening of another block and has no wall there.
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
        """Limits of the flight up from a level."""
        w = self.flight_width
        return (self.width - w, self.width) if self.mirrored else (0.0, w)

    @property
    def down_x(self) -> tuple[float, float]:
        """Limits of the flight from the level below."""
        w = self.flight_width
        return (0.0, w) if self.mirrored else (self.width - w, self.width)


@dataclass(frozen=True)
class Plan:
    """The shape of a building, by its number, in metres.

    A storey measures `storey` from floor to floor, of which `slab` is the floor between. Walls are `wall` thick, and
    rooms `depth_high` and `depth_low` deep on either side of a corridor. The blocks are the main corridor and its wing,
    if any; all stairwells are alike. `kinds` are kinds of rooms, to which a slot's `look` is an index. `styles` names
    the palette of each level; levels of one palette look the same but for unique things. With `signs`, the number of
    the level is painted by the stairs.
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


ROOM_KINDS = ("office", "bedroom", "kitchen", "class", "living", "store", "library")
MOST_ROOMS = 36  # that can be entered, on all levels together


@cache
def draw_plan(number: int) -> Plan:
    """The shape of the building of this number."""
    rng = np.random.default_rng([2718, number])
    levels = int(rng.integers(2, 7))
    length = float(np.exp(rng.uniform(np.log(8.0), np.log(60.0))))
    storey = rng.uniform(2.8, 3.7)
    slab = float(rng.uniform(0.2, min(0.45, storey - 2.45)))
    wall = rng.uniform(0.12, 0.28)
    width = float(rng.uniform(1.7, 2.2) if length < 14 else rng.uniform(1.7, 3.2))
    flight = rng.uniform(1.05, 1.4)
    stairs = Stairs(
        flight_width=flight,
        well=rng.uniform(0.1, 0.5),
        landing=rng.uniform(1.3, 1.9),
        half_landing=rng.uniform(flight + 0.1, flight + 0.5),
        risers=round(storey / 2 / rng.uniform(0.16, 0.18)),
        going=rng.uniform(0.26, 0.30),
        mirrored=bool(rng.random() < 0.5),
    )
    depth_high, depth_low = (float(d) for d in rng.uniform(3.0, 6.2, 2))
    kinds = tuple(str(kind) for kind in rng.choice(ROOM_KINDS, rng.integers(2, 5), replace=False))
    one_sided = bool(rng.random() < 0.3)
    main_high = bool(rng.random() < 0.5)  # the side with rooms where there is only one
    reserved: list[Slot] = []  # stairs and the wing
    stairs_at = [float(rng.choice([0.06, 0.5, 0.94]))] + ([rng.uniform(0.3, 0.7)] if length > 35 else [])
    if len(stairs_at) == 2 and abs(stairs_at[0] - stairs_at[1]) < 0.3:
        stairs_at[1] = 1.0 - 0.06 if stairs_at[0] < 0.5 else 0.06
    for fraction in stairs_at:
        begin = wall + (length - 2 * wall - stairs.width) * fraction
        high = main_high if one_sided else bool(rng.random() < 0.5)
        reserved.append(_slot("stairs", high, begin, begin + stairs.width))
    wing_width = rng.uniform(1.7, 2.6)
    has_wing, wing_high = length > 16 and rng.random() < 0.5, bool(rng.random() < 0.5)
    wing_begin = wall + (length - 2 * wall - wing_width) * float(rng.choice([0.0, 0.35, 1.0]))
    if has_wing and not any(
        slot.high == wing_high and slot.begin < wing_begin + wing_width + 1.0 and wing_begin - 1.0 < slot.end
        for slot in reserved
    ):
        reserved.append(_slot("wing", wing_high, wing_begin, wing_begin + wing_width))
    fraction_alike = float(rng.choice([0.3, 0.7, 1.0]))
    fraction_open = min(1.0, rng.uniform(0.55, 1.1))
    module = rng.uniform(3.0, 6.5)
    pattern = rng.integers(len(kinds), size=rng.integers(1, 4))
    if rng.random() < 0.5:
        pattern[:] = pattern[0]  # rooms alike all along
    door_fraction = float(rng.choice([0.25, 0.5, 0.75]))

    def fill(low: float, high: float, taken: list[Slot], with_rooms: bool, side: bool) -> list[Slot]:
        """Slots between those that are taken: as many rooms as fit, all of one width."""
        edges = [low, *(edge for slot in sorted(taken, key=lambda s: s.begin) for edge in (slot.begin, slot.end)), high]
        filled = []
        for begin, end in zip(edges[::2], edges[1::2], strict=True):
            if end - begin < 1.3:
                continue
            count = max(1, int((end - begin) / module))
            each = (end - begin) / count
            for k in range(count):
                a, b = begin + k * each, begin + (k + 1) * each
                if not with_rooms:
                    filled.append(Slot("window", side, a, b, (a + b) / 2))
                    continue
                margin = wall + DOOR_WIDTH / 2 + 0.15
                fraction = door_fraction if side else 1 - door_fraction
                door = (
                    float(np.clip(a + (b - a) * fraction, a + margin, b - margin)) if each > 2 * margin else (a + b) / 2
                )
                is_room = each > 2.7 and rng.random() < fraction_open
                look = int(pattern[k % len(pattern)])
                variant = 0 if rng.random() < fraction_alike else int(rng.integers(1, 1 << 30))
                filled.append(Slot("room" if is_room else "door", side, a, b, door, look, variant))
        return filled

    main = list(reserved)
    for side in (False, True):
        taken = [slot for slot in reserved if slot.high == side]
        main += fill(wall, length - wall, taken, not one_sided or side == main_high, side)
    blocks = [Block(Spot(0.0, 0.0, 0.0), length, width, tuple(main))]
    wings = [slot for slot in reserved if slot.kind == "wing"]
    if wings:
        first = max(depth_high if wing_high else depth_low, stairs.depth) + 3 * wall + 0.4
        wing_length = first + rng.uniform(5.0, 14.0)
        slots = [slot for side in (False, True) for slot in fill(first, wing_length - wall, [], True, side)]
        frame = Spot(wings[0].end, width + wall, np.pi / 2) if wing_high else Spot(wings[0].begin, -wall, -np.pi / 2)
        blocks.append(Block(frame, wing_length, wing_width, tuple(slots), open_start=True))
    pick = rng.random()
    if pick < 0.5:
        styles = [0] * levels
    elif pick < 0.75:
        styles = [0] + [1] * (levels - 1)
    else:
        styles = [level % 2 for level in range(levels)]
    return Plan(
        number=number,
        levels=levels,
        storey=storey,
        slab=slab,
        wall=wall,
        blocks=tuple(_limited(blocks, levels, rng)),
        depth_high=depth_high,
        depth_low=depth_low,
        stairs=stairs,
        kinds=kinds,
        styles=tuple(styles),
        cues_per_level=float(np.exp(rng.uniform(np.log(0.7), np.log(6.0)))) * (0.5 + length / 40),
        signs=bool(rng.random() < 0.35),
    )


def _slot(kind: SlotKind, high: bool, begin: float, end: float) -> Slot:
    return Slot(kind, high, begin, end, (begin + end) / 2)


def _limited(blocks: list[Block], levels: int, rng: np.random.Generator) -> list[Block]:
    """The same blocks with some rooms behind closed doors, so that walks can go everywhere; one room at least."""
    rooms = [(i, slot) for i, block in enumerate(blocks) for slot in block.slots if slot.kind == "room"]
    shut = rng.permutation(len(rooms))[max(1, MOST_ROOMS // levels) :]
    closed = {rooms[index] for index in shut}
    if not rooms:
        widest = max((s for s in blocks[0].slots if s.kind == "door"), key=lambda s: s.end - s.begin, default=None)
        closed = set()
    else:
        widest = None

    def after(index: int, slot: Slot) -> Slot:
        if slot is widest:
            return replace(slot, kind="room")
        if (index, slot) in closed:
            return replace(slot, kind="door")
        return slot

    return [replace(b, slots=tuple(after(i, slot) for slot in b.slots)) for i, b in enumerate(blocks)]
