"""The slush against a polygon clipper, against integrated differential equations, and against what drag may not do."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from tasks.world import LinkStates, Physics, Slush
from tasks.world.slush import submerged_part

lengths = st.floats(1.0, 3.0)
angles = st.one_of(st.floats(-10, 10), st.sampled_from([0.0, np.pi / 2, -np.pi / 2, np.pi, 1e-9, np.pi / 2 - 1e-9]))
heights = st.floats(-2.0, 2.0)


def clipped_part(a: float, y: float, cos: float, sin: float) -> tuple[float, float]:
    """Area below y = 0 and its second moment about (0, y), by shapely's clipping and the polygon formulas."""
    w, h = 0.5 / a, 0.5 * a
    corners = [(cos * p - sin * q, y + sin * p + cos * q) for p, q in ((-w, -h), (w, -h), (w, h), (-w, h))]
    below = shapely.Polygon(corners).intersection(shapely.box(-10, -20, 10, 0))
    if below.area == 0:
        return 0.0, 0.0
    px, py = np.array(shapely.get_coordinates(shapely.orient_polygons(below))).T
    py = py - y
    cross = px[:-1] * py[1:] - px[1:] * py[:-1]
    squares = px[:-1] ** 2 + px[:-1] * px[1:] + px[1:] ** 2 + py[:-1] ** 2 + py[:-1] * py[1:] + py[1:] ** 2
    return float(below.area), float((cross * squares).sum() / 12)


@given(a=lengths, y=heights, angle=angles)
def test_the_submerged_part_of_any_rectangle_is_the_clippers(a: float, y: float, angle: float) -> None:
    link = a, y, float(np.cos(angle)), float(np.sin(angle))
    measured = np.ravel(submerged_part(*(np.array([value]) for value in link)))
    np.testing.assert_allclose(measured, clipped_part(*link), rtol=0, atol=1e-9)


def link_states(n: int, dtype: type = np.float64) -> LinkStates:
    """Links with the speeds of throws, up to 2 m below and above the surface."""
    rng = np.random.default_rng(17)
    a, angle, y = rng.uniform(1, 3, n), rng.uniform(-np.pi, np.pi, n), rng.uniform(-2, 2, n)
    arrays = (a, np.ones(n), (a**2 + a**-2) / 12, y, np.cos(angle), np.sin(angle), *rng.uniform(-20, 20, (3, n)))
    return LinkStates(*(array.astype(dtype) for array in arrays))


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_numbers_keep_their_precision(kind: type) -> None:
    assert {type(part) for part in submerged_part(*map(kind, (2.0, -0.1, 0.6, 0.8)))} == {kind}


@pytest.mark.parametrize("form", ["vector", "by_component"])
def test_the_forms_of_drag(form: str) -> None:
    # Fully submerged, A_s = 1 m² and m = 1 kg: k = ½ · 1.25 · 10 = 6.25 /m. I_s = I, so k_r = 1.25 · 20 = 25.
    links = replace(link_states(50), y=np.full(50, -9.0))
    change = Slush(drag=form).velocity_change(links, Physics(gravity=0.0))
    speed = np.hypot(links.vx, links.vy)
    of_x, of_y = (speed, speed) if form == "vector" else (abs(links.vx), abs(links.vy))
    rates = {"vx": 6.25 * of_x, "vy": 6.25 * of_y, "omega": 25 * abs(links.omega)}
    for name, rate in rates.items():
        before = getattr(links, name)
        after = before + getattr(change, name)
        np.testing.assert_allclose(after, before / (1 + rate / 60), rtol=1e-9, atol=1e-9)


def test_buoyancy_alone_moves_a_link_that_rests_and_follows_drag() -> None:
    rest = np.zeros(100)
    links = replace(link_states(100), vx=rest, vy=rest, omega=rest, mass=np.full(100, 2.0))
    area, _ = submerged_part(links.length_scale, links.y, links.cos, links.sin)
    change = Slush().velocity_change(links, Physics())
    np.testing.assert_allclose(change.vy, 1.25 * 9.8 * area / 2.0 / 60.0, rtol=1e-14)
    assert (change.vx == 0).all() and (change.omega == 0).all()
    sinking = replace(links, y=rest - 9, vy=rest - 12)
    # A_s = 1 m² and m = 2 kg, so k = ½ · 1.25 · 10 / 2 = 3.125 /m.
    expected = -12.0 / (1 + 3.125 * 12.0 / 60) + 1.25 * 9.8 / 2 / 60
    assert Slush().velocity_change(sinking, Physics()).vy - 12 == pytest.approx(np.full(100, expected), abs=1e-13)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_dry_links_are_left_alone(dtype: type) -> None:
    links = link_states(1000, dtype)
    high = replace(links, y=links.y + dtype(4))  # over 2 m: clear of the surface by half a diagonal
    change = Slush().velocity_change(high, Physics())
    for name in ("vx", "vy", "omega"):
        assert (getattr(change, name) == 0).all() and getattr(change, name).dtype == dtype
