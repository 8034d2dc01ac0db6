"""Bodies at rest against geometry: joints meet, the robot stands on y = 0, masses and inertias are a rectangle's."""

from dataclasses import replace

import numpy as np
import pytest

from tasks.design import Designs, kinematic_trees, random_designs, rest_pose, rigid_bodies

HALF_ULP = 2.0**-24
"""Relative rounding of float32."""


@pytest.fixture(scope="module")
def designs() -> Designs:
    return random_designs(300, np.random.default_rng(1))


def test_a_body_worked_out_by_hand() -> None:
    # The root is 2 m high, links 1 to 5 are squares of 1 m. Link 1 hangs with its lower end from the root's top,
    # turned by +90°: its long axis points to -x. Link 2 goes on from its far end in the same direction. Link 3 turns
    # by another 90°: it starts at the middle of link 2 and points down. Links 4 and 5 sit in the middle of the root.
    def row(*values: float) -> np.ndarray:
        return np.array([values], dtype=float)

    designs = replace(
        random_designs(1, np.random.default_rng(0)),
        length_scale=row(2, 1, 1, 1, 1, 1),
        parent=np.array([[-1, 0, 1, 2, 0, 0]]),
        parent_attachment=row(0, 1, 1, 0, 0, 0),
        child_attachment=row(0, -1, -1, -1, 0, 0),
        rest_angle=row(0, np.pi / 2, 0, np.pi / 2, 0, np.pi / 4),
    )
    trees = kinematic_trees(designs, density=1.0)
    np.testing.assert_allclose(trees.x[0], [0, -0.5, -1.5, -1.5, 0, 0], atol=1e-7)
    # The root's foot is the lowest point, 1 m below its centre.
    np.testing.assert_allclose(trees.y[0], [1, 2, 2, 1.5, 1, 1], atol=1e-7)
    np.testing.assert_allclose(trees.angle[0], [0, np.pi / 2, np.pi / 2, np.pi, 0, np.pi / 4], atol=1e-7)
    np.testing.assert_array_equal(trees.parent_anchor[0], np.float32([0, 1, 0.5, 0, 0, 0]))
    np.testing.assert_array_equal(trees.child_anchor[0], np.float32([0, -0.5, -0.5, -0.5, 0, 0]))


# -- rigid bodies -----------------------------------------------------------------------------------------------------


def random_motors(designs: Designs, rng: np.random.Generator, n_actuated: int) -> Designs:
    on = np.zeros_like(designs.motor_on)
    for row in on:
        row[rng.choice(np.arange(1, 6), n_actuated, replace=False)] = True
    return replace(designs, motor_on=on)


@pytest.mark.parametrize("n_actuated", range(6))
def test_so_many_motors_make_one_body_more(designs: Designs, n_actuated: int) -> None:
    built = random_motors(designs, np.random.default_rng(7), n_actuated)
    rigid = rigid_bodies(built, passive_joints="locked")
    assert (rigid.is_first.sum(axis=1) == n_actuated + 1).all()
    np.testing.assert_array_equal(rigid.is_first[:, 1:], built.motor_on[:, 1:])  # first links hang from motors
    joint = ~rigid.is_first
    parents_body = np.take_along_axis(rigid.first_link, np.maximum(built.parent, 0), axis=1)
    np.testing.assert_array_equal(rigid.first_link[joint], parents_body[joint])
    assert (rigid.first_link <= np.arange(6)).all()


def test_a_bent_pair_of_links_has_the_inertia_that_steiner_gives_it() -> None:
    # Two links of 2 m by 0.5 m. The second lies across the first's end, its own end at the joint (0, 1): its long axis
    # points to (-1, 0), its centre is 1 m along it. All other joints have motors.
    pair = random_designs(1, np.random.default_rng(10))
    pair = replace(
        pair,
        parent=np.array([[-1, 0, 0, 0, 0, 0]]),
        length_scale=np.full((1, 6), 2.0),
        parent_attachment=np.array([[0, 1.0, 0, 0, 0, 0]]),
        child_attachment=np.array([[0, -1.0, 0, 0, 0, 0]]),
        rest_angle=np.array([[0, np.pi / 2, 0, 0, 0, 0]]),
        motor_on=np.array([[False, False, True, True, True, True]]),
    )
    rigid = rigid_bodies(pair, passive_joints="locked")
    assert rigid.first_link[0].tolist() == [0, 0, 2, 3, 4, 5]
    own = (2**2 + 0.5**2) / 12
    body = 2 * own + 2 * 0.5  # each centre lies √½ m from the body's, at (-½, ½)
    for name, expected in {
        "x": [0, -1],
        "y": [0, 1],
        "angle": [0, np.pi / 2],
        "cos": [1, 0],
        "sin": [0, 1],
        "lever_x": [0.5, -0.5],
        "lever_y": [-0.5, 0.5],
        "mass_share": [0.5, 0.5],
        "inertia_share": [own / body] * 2,
        "mass_over_inertia": [1 / body] * 2,
    }.items():
        np.testing.assert_allclose(getattr(rigid, name)[0, :2], expected, rtol=HALF_ULP, atol=2 * HALF_ULP)


def test_links_and_joints_lie_in_their_body_as_they_lie_at_rest(designs: Designs) -> None:
    built = random_motors(designs, np.random.default_rng(8), 2)
    rigid = rigid_bodies(built, passive_joints="locked")
    x, y, angle = rest_pose(built)
    parents_body = np.take_along_axis(rigid.first_link, np.maximum(built.parent, 0), axis=1)
    along = built.child_attachment * built.length_scale / 2  # of the joint; the long axis points to (-sin θ, cos θ)
    joint = np.stack([x - np.sin(angle) * along, y + np.cos(angle) * along])
    for body, own_x, own_y, at in (
        (rigid.first_link, rigid.x, rigid.y, np.stack([x, y])),
        (parents_body, rigid.joint_x, rigid.joint_y, joint),
    ):
        of_body = [np.take_along_axis(q, body, axis=1) for q in (x, y, angle)]
        cos, sin = np.cos(of_body[2]), np.sin(of_body[2])
        found = np.stack([of_body[0] + cos * own_x - sin * own_y, of_body[1] + sin * own_x + cos * own_y])
        # Within a body places of up to 18 m and angles of up to 5π are rounded once; two of them meet in each place.
        np.testing.assert_allclose(found[..., 1:], at[..., 1:], rtol=0, atol=2 * 18 * HALF_ULP)
    turned = np.take_along_axis(angle, rigid.first_link, axis=1) + rigid.angle
    np.testing.assert_allclose(turned, angle, rtol=0, atol=2 * 18 * HALF_ULP)
