"""The steps of docs/assembly.md are in an order in which a robot can be assembled."""

import re
from pathlib import Path

from build123d import Plane, Solid

from tasks.fabrication.kit import Kit

ASSEMBLY = Path(__file__).parents[3] / "docs/assembly.md"


def steps() -> list[str]:
    """Return the names of the steps in order."""
    assembly = ASSEMBLY.read_text("utf-8").split("## Assembly\n")[1]
    return re.findall(r"^\d+\. \*\*(.+?)\.\*\*", assembly, flags=re.MULTILINE)


def blocked(kit: Kit, order: list[str]) -> set[str]:
    """Return the rods that can be inserted from neither side because of what earlier steps put in their way."""
    settings, outer = kit.settings, kit.layers.outer

    def step(body: int, of_outer: str, of_inner: str) -> int:
        return order.index(of_outer if outer[body] else of_inner)

    in_place = [(step(part.body, "Outer parts", "Short rods"), part.solid) for part in kit.parts]
    for servo_joint in kit.servo_joints:  # servos and horns move with the parts that hold them
        holder = {"servo": servo_joint.carrier, "horn": servo_joint.driven}
        in_place += [
            (step(holder[item.kind], "Outer parts", "Short rods"), item.solid)
            for item in kit.bought
            if item.kind in holder and f"joint {servo_joint.joint.link}," in item.name
        ]
    kept_out = set()
    for body, rods in enumerate(kit.layers.rods):
        now = step(body, "Long rods", "Short rods")
        low, length = kit.layers.low_mm(body, settings), kit.layers.rod_length_mm(body, settings)
        there = [solid for when, solid in in_place if when <= now]
        for number, rod in enumerate(rods, 1):
            ways = [
                Solid.make_cylinder(settings.rod_mm / 2, 2 * length, Plane((*rod, start)))
                for start in (low, low - length)
            ]
            if not any(all(_apart(way, solid) for solid in there) for way in ways):
                kept_out.add(f"rod {number} of part {body + 1}")
    return kept_out


def _apart(way: Solid, solid: Solid) -> bool:
    shared = way.intersect(solid)
    return shared is None or sum(piece.volume for piece in shared.solids()) < 1e-3


def test_every_rod_can_be_put_in_when_its_step_comes(kit):
    order = steps()
    held = max(order.index("Servos"), order.index("Horns"))
    assert held < min(order.index("Short rods"), order.index("Outer parts"))
    assert blocked(kit, order) == set()
    short, closing = order.index("Short rods"), order.index("Outer parts")
    order[short], order[closing] = order[closing], order[short]
    assert blocked(kit, order) == {"rod 1 of part 2", "rod 1 of part 3"}  # part 1 lies over them
