import numpy as np
import pytest

from filtering.se3 import Poses
from sequences.frame import Camera
from sequences.rendering import texture
from sequences.rendering.light import bake_light
from sequences.rendering.mesh import Part, Placement, Tracer, assemble
from sequences.rendering.render import LitScene, pixel_rays, render
from sequences.rendering.texture import Material, plain
from tests.helpers.views import depth_and_quads

CAMERA = Camera(64, 48, 50.0, 50.0, 31.5, 23.5)
HERE = np.zeros((1, 3))


def wall(material: Material, at_z: float = 2.0, half: float = 5.0) -> Part:
    part = Part()
    part.quad((-half, half, at_z), (2 * half, 0, 0), (0, -2 * half, 0), material)  # seen along +z
    return part


def glow(paint=None) -> Material:
    return Material(paint or (lambda canvas: canvas.colour((1.0, 1.0, 1.0))), emission=1.0)


def test_a_ray_finds_the_point_of_the_parallelogram_that_it_was_aimed_at():
    part, rng = Part(), np.random.default_rng(0)
    part.quad((1.0, 2.0, 3.0), (0.5, 0.2, 0.1), (-0.1, 0.6, 0.3), plain((0.5, 0.5, 0.5)))
    tracer = Tracer(assemble([Placement(part, HERE)]))
    st = rng.uniform(0.02, 0.98, (500, 2))
    target = np.array([1.0, 2, 3]) + st[:, :1] * [0.5, 0.2, 0.1] + st[:, 1:] * [-0.1, 0.6, 0.3]
    origin = np.array([1.0, 2, 6]) + rng.uniform(-1, 1, (500, 3))
    quad, s, t, distance = tracer.first_hit(origin, target - origin)
    assert (quad == 0).all()
    np.testing.assert_allclose(np.stack([s, t], axis=1), st, atol=1e-4)
    np.testing.assert_allclose(distance, 1.0, atol=1e-5)
    assert tracer.blocked(origin, 1.01 * (target - origin)).all()
    assert not tracer.blocked(origin, 0.99 * (target - origin)).any()


def test_depth_is_the_distance_along_the_axis_of_the_first_wall_and_infinite_without_one():
    scene = LitScene([Placement(wall(glow(), half=1.5), HERE)], seed=0)
    depth, quads = depth_and_quads(scene, CAMERA, Poses.exp(np.array([0.0, 0, 0.5, 0, 0, 0])))
    np.testing.assert_allclose(depth, 1.5, atol=1e-5)
    assert (quads == 0).all()
    away, nothing = depth_and_quads(scene, CAMERA, Poses.exp(np.array([0.0, 0, 0, 0, np.pi, 0])))
    assert np.isinf(away).all()
    assert (nothing == -1).all()


def test_a_painted_corner_appears_at_the_pixel_where_the_pinhole_model_puts_it():
    def quadrant(canvas):
        return canvas.colour((1.0, 1.0, 1.0)) * ((canvas.x > 5.3) & (canvas.y > 4.9))[..., None]

    scene = LitScene([Placement(wall(glow(quadrant)), HERE)], seed=0)
    pose = Poses.exp(np.array([0.1, -0.05, 0.2, 0.05, -0.08, 0.0]))
    corner = pose.inverse().apply(np.array([-5 + 5.3, 5 - 4.9, 2.0]))
    u = CAMERA.fx * corner[0] / corner[2] + CAMERA.cx
    v = CAMERA.fy * corner[1] / corner[2] + CAMERA.cy
    picture = render(scene, CAMERA, Poses.stack([pose] * 16), rng=np.random.default_rng(0))[..., 0]
    # The bright part is right of u and above v: edges are found as the mean brightness beside them.
    row, column = round(v) - 10, round(u) + 10
    assert picture[row].sum() == pytest.approx(CAMERA.width - 0.5 - u, abs=1.2)  # the edge leans by pixels in 10
    assert picture[:, column].sum() == pytest.approx(v + 0.5, abs=1.2)
    assert picture[round(v) + 3, round(u) - 3] == 0
    assert picture[round(v) - 3, round(u) + 3] == pytest.approx(1, abs=1e-3)


def test_an_exposure_during_which_the_camera_turns_smears_an_edge_over_the_pixels_it_crosses():
    half = glow(lambda c: c.colour((1.0, 1.0, 1.0)) * (c.x > 5)[..., None] + 0 * c.y[..., None])
    scene = LitScene([Placement(wall(half), HERE)], seed=0)
    turn = np.zeros((32, 6))
    turn[:, 4] = np.linspace(-0.05, 0.05, 32)
    sharp = render(scene, CAMERA, Poses.exp(np.zeros((32, 6))), rng=np.random.default_rng(0))[24, :, 0]
    blurred = render(scene, CAMERA, Poses.exp(turn), rng=np.random.default_rng(0))[24, :, 0]
    partly_lit = [int(((row > 0.02) & (row < 0.98)).sum()) for row in (sharp, blurred)]
    assert partly_lit[0] <= 2
    assert partly_lit[1] == pytest.approx(0.1 * CAMERA.fx, abs=1.5)


def test_pixel_rays_pass_through_the_principal_point_straight_ahead():
    camera = Camera(65, 49, 50.0, 60.0, 32.0, 24.0)
    np.testing.assert_array_equal(pixel_rays(camera)[24, 32], [0, 0, 1])
    np.testing.assert_allclose(pixel_rays(camera)[34, 57], [0.5, 10 / 60, 1], rtol=1e-6)


def test_direct_light_below_a_square_lamp_follows_the_form_factor():
    part = Part()
    half, height = 0.5, 1.5
    part.quad((-half, half, height), (2 * half, 0, 0), (0, -2 * half, 0), texture.lit((1.0, 1.0, 1.0), 1.0))
    part.quad((-0.02, -0.02, 0), (0.04, 0, 0), (0, 0.04, 0), plain((0.5, 0.5, 0.5)))
    geometry = assemble([Placement(part, HERE)])
    emitted = np.array([[2.0] * 3, [0.0] * 3])
    light = bake_light(geometry, Tracer(geometry), np.zeros((2, 3)), emitted, rng=np.random.default_rng(0))
    # A small element below the corner of a rectangle (Howell, Catalog of Configuration Factors, B-4), four times.
    x = half / height
    corner = x / np.sqrt(1 + x**2) * np.arctan(x / np.sqrt(1 + x**2)) / np.pi
    np.testing.assert_allclose(light[1], 2.0 * 4 * corner, rtol=0.02)


def test_nothing_lights_what_a_screen_hides_from_the_lamp():
    part = Part()
    part.quad((-0.5, 0.5, 2.0), (1, 0, 0), (0, -1, 0), texture.lit((1.0, 1.0, 1.0), 1.0))
    part.box((-3, -3, 1.0), (3, 3, 1.1), plain((0.5, 0.5, 0.5)))
    part.quad((-0.5, -0.5, 0), (1, 0, 0), (0, 1, 0), plain((0.5, 0.5, 0.5)))
    geometry = assemble([Placement(part, HERE)])
    charts = len(geometry.materials)
    emitted = np.zeros((charts, 3))
    emitted[0] = 1.0
    light = bake_light(geometry, Tracer(geometry), np.zeros((charts, 3)), emitted, rng=np.random.default_rng(0))
    assert light[charts - 1].max() == 0
    assert light[6].min() > 0  # the screen's upper side


def test_light_in_a_closed_white_box_is_what_bounces_add_to_it():
    part = Part()
    part.box((1, 1, 1), (0, 0, 0), plain((0.5, 0.5, 0.5)))  # inside out
    part.quad((0.3, 0.7, 0.99), (0.4, 0, 0), (0, -0.4, 0), texture.lit((1.0, 1.0, 1.0), 1.0))
    geometry = assemble([Placement(part, HERE)])
    emitted, albedo = np.zeros((7, 3)), np.full((7, 3), 0.5)
    emitted[6], albedo[6] = 1.0, 0.0
    direct, bounced = (
        bake_light(geometry, Tracer(geometry), reflectance, emitted, rng=np.random.default_rng(0))
        for reflectance in (0 * albedo, albedo)
    )
    # On the floor. Every bounce passes on about half: two of them add less than the 1/(1 − 0.5) of all, but much.
    assert 1.25 < bounced[5].mean() / direct[5].mean() < 2.0
