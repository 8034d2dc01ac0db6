"""Any design that evolution may draw gives valid, closed parts."""

from dataclasses import replace

import numpy as np
import trimesh

from tasks.bench.fabrication.kit import Kit, build_kit
from tasks.bench.fabrication.kit_settings import KitSettings
from tasks.bench.fabrication.parts import mesh_of
from tasks.bench.fabrication.servos import SERVOS
from tasks.design import N_LINKS, Designs, links_apart, random_designs

SETTINGS = KitSettings()


def variant(rng: np.random.Generator) -> Designs:
    """Draw a design of the physical variant: two motors, and no overlap at rest of links without a joint."""
    while True:
        drawn = random_designs(4096, rng)
        on = np.zeros((len(drawn), N_LINKS), dtype=bool)
        on[:, 1:] = rng.permuted(np.tile([True, True, False, False, False], (len(drawn), 1)), axis=1)
        apart = np.flatnonzero(links_apart(replace(drawn, motor_on=on)))  # one in about a thousand
        if apart.size:
            return replace(drawn, motor_on=on)[[int(apart[0])]]


def test_random_designs_of_the_variant_make_valid_closed_parts(torture):
    """``build_kit`` checks that solids are valid and have the analytic volume; this also checks their meshes."""
    for rng in torture.attempts(1, 200):
        kit = build_kit(variant(rng), SETTINGS)
        assert len(kit.mechanism.bodies) == 3
        assert not any("variant" in finding.message for finding in kit.findings)
        check_meshes(kit)


def test_a_cut_that_grazes_an_edge_leaves_no_crumb():
    """3 mm³ stayed between the two pieces of a part of this design, which the test above drew."""
    check_meshes(build_kit(variant(np.random.default_rng([2558797910, 1591383399, 0])), SETTINGS))


def test_random_designs_of_any_kind_do_not_crash(torture):
    for rng in torture.attempts(1, 200):
        servo, horn = rng.choice(sorted(SERVOS)), rng.choice(["cross", "disc"])
        settings = KitSettings(servo=str(servo), horn=str(horn), servos_per_joint=int(rng.integers(1, 3)))
        check_meshes(build_kit(random_designs(1, rng), settings))


def check_meshes(kit: Kit) -> None:
    for piece in kit.parts:
        mesh = mesh_of(piece.solid)
        assert trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False).is_volume, piece.name
