"""Buildings by number: what a plan looks like when it is built, and who walks through it with which camera.

What is alike, on several levels or in several rooms, is one part that is placed many times; what is unique hangs
beside it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sequences.odometry import OdometryNoise
from sequences.rendering import texture
from sequences.rendering.light import Sampling
from sequences.rendering.mesh import Placement
from sequences.scenes.building.corridors import corridor
from sequences.scenes.building.cues import unique_things
from sequences.scenes.building.draw_plan import draw_plan
from sequences.scenes.building.looks import Looks, palettes
from sequences.scenes.building.paint.pictures import outdoors
from sequences.scenes.building.parts import place_copies
from sequences.scenes.building.plan import Plan
from sequences.scenes.building.rooms import place_furniture, place_rooms
from sequences.scenes.building.stairwells import place_stairwells
from sequences.scenes.building.visit import Visit, draw_visit, person
from sequences.scenes.building.walk import walk_building
from sequences.scenes.scene import Scene, mounted

SAMPLING = Sampling(grid_m=0.18, shadow_rays=9, bounce_rays=48, reach_m=7.0)
"""How finely light is sampled: buildings are large."""

_SEED_NUMBER = 1000  # that of all buildings; the second one is the building's own
_RATES_HZ = (4.0, 5.0, 6.0, 7.5, 8.0, 10.0, 12.0, 15.0, 20.0, 24.0, 25.0, 30.0)


def draw_scene(number: int) -> Scene:
    """A building with a camera and an odometry of its own, all drawn from its number."""
    plan = draw_plan(number)
    rng = plan.rng(15)
    height, field_of_view = rng.uniform(0.3, 1.8), rng.uniform(50.0, 110.0)
    toward = rng.choice([0.0, 0.0, 0.0, 0.0, 0.0, np.pi, np.pi, 0.8, -0.8]) + rng.uniform(-0.35, 0.35)
    mount = (rng.uniform(-0.15, 0.18), rng.uniform(-0.1, 0.1), height)
    down = rng.uniform(-0.12, 0.2) if height > 1.0 else rng.uniform(-0.25, 0.05)  # a low camera looks up
    low, high = np.log([[0.004, 0.002, 0.0004, 10, 0.003, 0.001], [0.05, 0.02, 0.005, 60, 0.02, 0.008]])
    errors = (float(value) for value in np.exp(rng.uniform(low, high)))
    return Scene(
        name=f"building-{number}",
        seed_numbers=(_SEED_NUMBER, number),
        placements=lambda split, seed: placements(plan, draw_visit(plan, split, seed)),
        path=lambda duration_s, split, seed, rng: walk_building(
            plan, draw_visit(plan, split, seed), duration_s, training=split == "train", seed=seed, rng=rng
        ),
        field_of_view_deg=float(field_of_view),
        base_from_camera=mounted((float(mount[0]), float(mount[1]), float(mount[2])), float(toward), float(down)),
        has_cues=True,
        rate_hz=float(rng.choice(_RATES_HZ)),
        noise=OdometryNoise(*errors),
        changes=True,
        paint_seed=number,
        sampling=SAMPLING,
    )


def placements(plan: Plan, visit: Visit) -> list[Placement]:
    """Everything in the building: x along the main corridor, y across, z up, the lowest floor at z = 0."""
    rng = plan.rng(5)
    strip = bool(rng.random() < 0.5)
    looks = Looks(
        palettes(plan),
        replace(texture.lit(visit.tint, 8.0 * visit.lamps), glare=0.3),
        outdoors(plan.rng(6), 7.0 * visit.daylight),
        (1.2, 0.2) if strip else (0.6, 0.6),
        float(rng.uniform(2.4, 4.5)),
    )
    placed = []
    for style in sorted(set(plan.styles)):
        levels = [level for level in range(plan.levels) if plan.styles[level] == style]
        for index, block in enumerate(plan.blocks):
            placed.append(place_copies(corridor(plan, index, looks, style), [block.frame], levels, plan))
        placed += place_rooms(plan, looks, style, levels)
    placed += place_furniture(plan)
    placed += place_stairwells(plan, looks)
    placed += unique_things(plan)
    for k, (level, spot, who) in enumerate(visit.people):
        someone = person(np.random.default_rng([plan.number, who, k]))
        placed.append(place_copies(someone, [spot], [level], plan))
    return placed
