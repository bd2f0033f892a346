"""A member by cells has one view of all that it takes."""

import numpy as np
import pytest

import rhumb


def owner_of(divided, name, **options):
    """The member who makes a scene without gravity, and has all of it."""
    return divided.connect().join(name, condition="create", gravity=(0, 0, 0), tolerance=0.001, **options)


def walker_of(divided, name, **options):
    return divided.connect().join(name, condition="join", cells=True, **options)


def arrive(scene):
    while "awaited" in scene.cells.values():
        scene.advance()


def catch_up(owner, tick):
    while owner.poll()[0] < tick:
        owner.idle(0.001)


def test_a_member_that_walks_has_each_body_of_its_cells_once_and_within_its_bound(divided):
    with owner_of(divided, "walk") as owner, walker_of(divided, "walk") as walker:
        floor = owner.add_body(rhumb.Shape.cuboid(200, 0.5, 200), (0, -3, 0), "fixed")
        place = np.arange(40)
        owner.add_bodies(
            rhumb.Shape.ball(0.5),
            np.stack([place * 2.0, np.full(40, 5.0), place % 5 * 3.0 - 6], axis=1),
            linear_velocities=np.stack([place % 7 - 3.0, place * 0, place % 7 * 0.4 - 1.2], axis=1),
        )
        owner.advance()
        assert walker.cell_grid == (10, 0, 10) and owner.cell_grid is None
        before, gone, compared = set(), 0, 0
        for step in range(200):
            if step % 10 == 0:
                walker.take_cells_around((step * 0.4, 5, 0), [(8, 0.01), (25, 0.2)])
            tick = walker.advance()
            catch_up(owner, tick)
            shown = set(walker.bodies.tolist())
            assert len(shown) == len(walker) and floor in walker
            assert set(walker.removed.tolist()) == before - shown
            assert before | set(walker.bodies[walker.changed].tolist()) >= shown
            gone += len(before - shown)
            truth = owner.positions[owner.places(walker.bodies)]
            errors = np.linalg.norm(walker.positions - truth, axis=1)
            bounds = walker.error_bounds
            assert np.all(bounds <= 0.2 + 1e-5) and np.all(errors <= bounds + 0.001 + 1e-5)
            assert [walker.error_bound(body) for body in walker.bodies] == bounds.tolist()
            before = shown
            compared += len(shown)
        assert compared > 1_500 and gone > 10


def test_a_cell_has_the_tolerance_that_is_asked_for_or_exact_states(divided):
    with owner_of(divided, "choice") as owner, walker_of(divided, "choice") as walker:
        ball = rhumb.Shape.ball(0.5)
        bodies = owner.add_bodies(ball, [(5, 5, 5), (15, 5, 5), (25, 5, 5)], linear_velocities=(0.1, 0, 0))
        owner.advance()
        walker.take_cells({(0, 0, 0): None, (1, 0, 0): 0.02, (2, 1, 0): 0.5})
        arrive(walker)
        assert walker.cells == {(0, 0, 0): "shown", (1, 0, 0): "shown", (2, 1, 0): "denied"}
        assert list(walker.denied_cells) == [(2, 1, 0)]
        assert "the grid has no such cell" in walker.denied_cells[2, 1, 0]
        assert set(walker.bodies.tolist()) == set(bodies[:2].tolist())
        exact, coarse = walker.error_bound(bodies[:2])
        assert exact < 0.0011 and 0.015 < coarse <= 0.02 + 1e-5
        walker.take_cells({})
        walker.advance()
        assert len(walker) == 0 and walker.cells == {}
        assert walker.place(bodies[0]) is None


def test_places_of_cells_are_along_the_axes_of_the_scene(divided):
    for coordinates, grid, at in (
        ("unity", (10, 0, 10), (5, 5, -5)),
        ("unreal", (1000, 1000, 0), (500, -500, 500)),
        ("z-up", (10, 10, 0), (5, -5, 5)),
    ):
        name = f"axes-{coordinates}"
        with owner_of(divided, name, coordinates=coordinates) as owner:
            with walker_of(divided, name, coordinates=coordinates) as walker:
                ball = owner.add_body(rhumb.Shape.ball(grid[0] / 20), at)
                owner.advance()
                assert walker.cell_grid == grid
                cell = tuple(0 if edge == 0 else int(np.floor(x / edge)) for x, edge in zip(at, grid))
                walker.take_cells({cell: 0.01})
                arrive(walker)
                assert walker.bodies.tolist() == [ball] and np.allclose(walker.positions, [at], atol=grid[0] / 500)
                walker.take_cells_around(at, [(0, 0.01)])
                assert list(walker.cells) == [cell]


def test_a_hull_that_comes_back_is_where_its_points_are(divided):
    with owner_of(divided, "hull") as owner, walker_of(divided, "hull") as walker:
        owner.advance()
        corners = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
        box = walker.add_body(rhumb.Shape.hull(corners), (2, 5, 5), "kinematic")
        for cells in ({(0, 0, 0): 0.01}, {}, {(0, 0, 0): 0.01}):
            walker.take_cells(cells)
            arrive(walker)
            walker.advance()
            if cells:
                assert np.allclose(walker.positions[walker.place(box)], (2, 5, 5), atol=0.02)


def test_what_cannot_be_taken_is_an_error(divided, scene):
    with pytest.raises(rhumb.InvalidError, match="not divided"):
        scene.take_cells_around((0, 0, 0), [(5, 0.1)])
    with pytest.raises(rhumb.InvalidError, match="not divided"):
        scene.take_cells({(0, 0, 0): 0.1})
    assert scene.cell_grid is None and scene.cells == {}
    with owner_of(divided, "errors") as _, walker_of(divided, "errors") as walker:
        for call, words in (
            (lambda: walker.take_cells_around((0, 0, 0), [(500, 0.1)]), "256 cells"),
            (lambda: walker.take_cells({(place, 0, 0): 0.1 for place in range(257)}), "256 cells"),
            (lambda: walker.take_cells_around((1e30, 0, 0), [(1, 0.1)]), "position"),
            (lambda: walker.take_cells_around((0, 0, 0), [(-1, 0.1)]), "radius"),
            (lambda: walker.take_cells_around((0, 0, 0), [(1, 1e-9)]), "tolerance"),
            (lambda: walker.take_cells_around((0, float("nan"), 0), [(1, 0.1)]), "point"),
            (lambda: walker.take_cells({(2**40, 0, 0): 0.1}), "cells is"),
        ):
            with pytest.raises(rhumb.InvalidError, match=words):
                call()
        for wrong in ([(0, 0, 0)], {(0, 0): 0.1}, {0: 0.1}, {(0.5, 0, 0): 0.1}, None):
            with pytest.raises((TypeError, rhumb.InvalidError)):
                walker.take_cells(wrong)
        assert walker.cells == {}
