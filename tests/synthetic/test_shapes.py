"""Analytic hits, and one law for all shapes: a hit lies on the surface that the normal leaves."""

import numpy as np
import pytest

from gsynopsis.synthetic.objects import ball, block, post
from gsynopsis.synthetic.raytracer import nearest
from gsynopsis.synthetic.shapes import (
    ONE_THREAD,
    Cylinder,
    Ellipsoid,
    Plane,
    Ridge,
    column,
    product,
)
from gsynopsis.synthetic.textures import plain


def along(direction, *origins):
    o = np.array(origins, np.float32).T
    d = np.array(direction, np.float32) / np.linalg.norm(direction)
    return o, np.repeat(d[:, None].astype(np.float32), len(origins), axis=1)


def test_a_plane_is_hit_from_its_front_only():
    floor = Plane(column((0, 0, 1)), 0.5)
    down, up = along((0, 3, -4), (0, 0, 2.5), (0, 0, 0)), along((0, 0, 1), (0, 0, -2))
    np.testing.assert_allclose(floor.hit(*down), [2 / 0.8, np.inf], rtol=1e-6)
    assert floor.hit(*up) == [np.inf]


def test_an_ellipsoid_is_hit_where_the_formula_says():
    egg = Ellipsoid(column((1, 0, 0)), column((2, 1, 0.5)))
    np.testing.assert_allclose(egg.hit(*along((1, 0, 0), (-9, 0, 0))), [8], rtol=1e-6)
    np.testing.assert_allclose(egg.hit(*along((0, 0, -1), (1, 0.6, 3))), [3 - 0.5 * 0.8], rtol=1e-6)
    # Missed beside, behind, and from within.
    assert (egg.hit(*along((1, 0, 0), (-9, 1.01, 0), (4, 0, 0), (1, 0, 0))) == np.inf).all()
    dome = Ellipsoid(column((0, 0, 0)), column((5, 5, 5)), inside=True)
    np.testing.assert_allclose(dome.hit(*along((0, 1, 0), (0, 1, 0))), [4], rtol=1e-6)


def test_a_cylinder_is_hit_on_its_side_and_its_caps():
    can = Cylinder(column((0, 0, 1)), 0.5, 1.0)
    np.testing.assert_allclose(can.hit(*along((1, 0, 0), (-3, 0.3, 1))), [3 - 0.4], rtol=1e-6)
    np.testing.assert_allclose(can.hit(*along((0, 0, -1), (0.2, 0.2, 5))), [3], rtol=1e-6)
    assert (can.hit(*along((1, 0, 0), (-3, 0, 2.1), (-3, 0.51, 1))) == np.inf).all()
    top, side = can.normal(np.array([[0.2, 0.5], [0, 0], [2, 1]], np.float32)).T
    assert top.tolist() == [0, 0, 1] and side.tolist() == [1, 0, 0]


def test_a_turned_box_is_hit_on_its_corner():
    cube = block((0, 0, 0), (2, 2, 2), np.pi / 4, plain("#ffffff")).shape
    hit = cube.hit(*along((1, 0, 0), (-5, 0, 1), (-5, 1.5, 1)))
    np.testing.assert_allclose(hit, [5 - np.sqrt(2), np.inf], rtol=1e-5)


def test_a_gable_roof_has_its_ridge_and_eaves_where_it_says():
    roof = block((0, 0, 3), (4, 2, 0.5), 0, plain("#ffffff"), roof=1.0).shape
    hit = roof.hit(*along((0, 0, -1), (0, 0, 9), (0, 0.5, 9), (0, 0.9999, 9), (2.1, 0, 9)))
    np.testing.assert_allclose(hit, [9 - 4.5, 9 - 4.0, 9 - 3.5, np.inf], atol=1e-3)


def test_a_ridge_is_seen_below_its_skyline_only():
    hills = Ridge(100.0, lambda azimuth: 10 + 5 * np.cos(azimuth))
    low, high = along((1, 0, 0.14), (0, 0, 0)), along((1, 0, 0.16), (0, 0, 0))
    np.testing.assert_allclose(hills.hit(*low), 100 * np.hypot(1, 0.14), rtol=1e-5)
    assert hills.hit(*high) == [np.inf]
    behind = along((-1, 0, 0.04), (0, 0, 0)), along((-1, 0, 0.06), (0, 0, 0))
    assert np.isfinite(hills.hit(*behind[0])) and np.isinf(hills.hit(*behind[1]))


OBJECTS = {
    "ball": (ball((0.2, -0.1, 0.3), (0.5, 0.7, 0.4), plain("#ffffff")), (0.5, 0.7, 0.4)),
    "post": (post((0.1, 0.2, -0.4), 0.4, 1.1, plain("#ffffff")), None),
    "block": (block((0, 0.1, -0.2), (0.9, 0.5, 0.7), 0.6, plain("#ffffff")), None),
    "roof": (block((0, 0.1, -0.2), (0.9, 0.5, 0.3), 0.6, plain("#ffffff"), 0.4), None),
}


@pytest.mark.parametrize("name", OBJECTS)
def test_hits_lie_in_the_bound_and_normals_face_the_ray(rng, name):
    surface, _ = OBJECTS[name]
    origin = rng.standard_normal((3, 4000))
    origin = (3 * origin / np.linalg.norm(origin, axis=0)).astype(np.float32)
    direction = (rng.uniform(-0.7, 0.7, (3, 4000)) - origin).astype(np.float32)
    direction /= np.linalg.norm(direction, axis=0)
    t = surface.shape.hit(origin, direction)
    hits = np.isfinite(t)
    assert 400 < hits.sum() < 4000
    position = origin[:, hits] + t[hits] * direction[:, hits]
    *center, radius = surface.bound
    assert (np.linalg.norm(position - np.array(center)[:, None], axis=0) <= radius + 1e-4).all()
    normal = surface.shape.normal(position)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=0), 1, atol=1e-5)
    assert ((normal * direction[:, hits]).sum(axis=0) < 1e-3).all()
    # A step along the normal leaves the shape: a ray from there straight out meets nothing.
    out = surface.shape.hit(position + np.float32(2e-3) * normal, normal)
    assert np.isinf(out).all()
    # The search through bounding spheres finds the same hits as asking the shape itself.
    np.testing.assert_array_equal(nearest([surface], origin, direction)[0], t)


def test_the_nearest_of_several_surfaces_is_found(rng):
    surfaces = [surface for surface, _ in OBJECTS.values()]
    origin = (rng.standard_normal((3, 500)) * 0.1 + 3).astype(np.float32)
    direction = (rng.uniform(-0.5, 0.5, (3, 500)) - origin).astype(np.float32)
    direction /= np.linalg.norm(direction, axis=0)
    distance, which = nearest(surfaces, origin, direction)
    each = np.stack([s.shape.hit(origin, direction) for s in surfaces])
    np.testing.assert_array_equal(distance, each.min(axis=0))
    assert (which == np.where(np.isfinite(distance), each.argmin(axis=0), -1)).all()


def test_a_product_in_parts_is_the_product(rng):
    matrix, columns = rng.normal(size=(7, 3)), rng.normal(size=(3, ONE_THREAD // 9))
    np.testing.assert_allclose(product(matrix, columns), matrix @ columns, rtol=1e-14, atol=1e-14)
    assert product(matrix.astype(np.float32), columns.astype(np.float32)).dtype == np.float32
    assert product(matrix, columns[:, :0]).shape == (7, 0)
