"""Compilation of the kernels ahead of a study."""

import subprocess
import sys

import pytest

from tasks.world import Physics

_CALLED = """
import sys
from tasks.compiled import uncompiled_kernels
from tasks.design import body, genes, variation
from tasks.evolution.compilation import compile_kernels
from tasks.simulation.rigid_bodies import engine
from tasks.simulation.batch import seconds_to_compile
from tasks.simulation.trees import groups
from tasks.world import Physics

physics = Physics.model_validate_json(sys.argv[1])
compile_kernels(physics)
of_engine = (
    (engine._advance, engine._advance_with_networks, body._hang_links) if physics.link_collisions
    else (groups.advance_kernel, groups._advance_coupled, groups._pack_robots)
)
of_variation = (variation.random_kernel, variation.mutate_kernel, variation.recombine_kernel)
for kernel in (*of_engine, *of_variation, genes._find_fault):
    assert kernel.signatures, kernel
left = uncompiled_kernels()
of_throws = [name for name in left if "residual" in name or "free_links" in name]
assert seconds_to_compile(physics) == sum(left[name] for name in of_throws), left
"""


@pytest.mark.parametrize("link_collisions", [False, True])
def test_an_evolution_finds_every_kernel_compiled(link_collisions: bool) -> None:
    physics = Physics(link_collisions=link_collisions)
    subprocess.run([sys.executable, "-c", _CALLED, physics.model_dump_json()], check=True, timeout=300)


def test_the_module_compiles_for_the_physics_that_it_is_given() -> None:
    command = [sys.executable, "-m", "tasks.evolution.compilation"]
    subprocess.run([*command, Physics().model_dump_json()], check=True, timeout=300)
    refused = subprocess.run([*command, '{"gravity": "up"}'], capture_output=True, text=True, timeout=300, check=False)
    assert refused.returncode == 1
    assert "gravity" in refused.stderr
