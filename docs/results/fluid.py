"""Validate the fluid where tests would take minutes: drag, and robots at half the spacing. See docs/fluid.md.

.venv/bin/python docs/results/fluid.py drag
.venv/bin/python docs/results/fluid.py robots      # those of `puddle study --preset fluid`, in ./store
.venv/bin/python docs/results/fluid.py alone       # random designs, each of their links in a flume of its own
.venv/bin/python docs/results/fluid.py film        # the best two of them, to docs/fluid.gif
"""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import puddle
from pipeline.report.films import render_gif
from pipeline.report.palette import LOOKS, OTHERS
from pipeline.report.replay import replay_of
from tasks.design import Designs
from tasks.fluid import Flume
from tasks.fluid.cover import cover_faces
from tasks.world.fluid import FluidFlume
from tasks.world.slush import submerged_part

SPEED, DENSITY = 2.0, 1.25


def drag(length_scale: float, spacing: float, length: float, depth: float, duration: float) -> tuple[float, float]:
    """Return the mean drag coefficient and the deviation of lift of a link held upright in a current, second half.

    The link is turned to and fro at first, so that eddies begin. Upstream of it the current is made even again.
    """
    a = np.array([length_scale])
    flume = Flume(a, np.ones(1), (a**2 + a**-2) / 12, length=length, depth=depth, spacing=spacing)
    water, force, still = flume.water, [], np.zeros(1)
    water.u[:] = SPEED
    upstream = slice(len(water.rise) * 3 // 4, None)
    for step in range(int(duration * 60)):
        t = step / 60 * SPEED / length_scale
        angle = np.array([0.3 * np.sin(2 * np.pi * t / 6) if t < 6 else 0.0])
        water.u[upstream] += (SPEED - water.u[upstream]) * 0.03
        water.v[upstream] *= 0.97
        dvx, dvy, _ = flume.step(np.array([length / 4]), np.array([-depth / 2]), angle, still, still, still)
        force.append((dvx[0] * 60, dvy[0] * 60))
    late = np.array(force[len(force) // 2 :]) / (DENSITY / 2 * SPEED**2 * length_scale)
    return late[:, 0].mean(), late[:, 1].std()


def robots() -> None:
    """Print displacements at 4 m of the study's champions and of random designs, at both spacings, and correlations."""
    study = puddle.open_study("fluid")
    places = [(row["environment"], row["trial"]) for row in study.champions().to_pylist()]
    champions = Designs.concatenate([study.champion(name, depth=4.0, trial=trial) for name, trial in places])
    for designs in (champions, puddle.random_designs(20, np.random.default_rng(1))):
        root, whole = [], []
        for spacing in (0.125, 0.0625):
            done = puddle.simulate(designs, puddle.Pool(4.0, FluidFlume(spacing=spacing)), n_settle=200, n_measure=600)
            print(spacing, done.displacement.round(2), done.com_displacement.round(2))
            root.append(done.displacement)
            whole.append(done.com_displacement)
        print("R of the root and of the whole robot", np.corrcoef(root)[0, 1], np.corrcoef(whole)[0, 1])


class Alone:
    """The fluid, with every link in a flume of its own; if ``together``, links that overlap still float once."""

    def __init__(self, *, together: bool) -> None:
        self.together = together

    def start(self, links: puddle.LinkStates, physics: puddle.Physics, depth: float) -> Any:
        """Return the flumes of a rollout."""
        fluid = FluidFlume()
        each, joint = (fluid.start(of, physics, depth) for of in (_apart(links), links))
        together, density = self.together, fluid.density

        class Flumes:
            def velocity_change(self, links: puddle.LinkStates, physics: puddle.Physics) -> puddle.VelocityChange:
                sunk = np.zeros_like(links.y)
                if together:
                    under, _ = submerged_part(links.length_scale, links.y, links.cos, links.sin)
                    for world, flume in joint.flumes.items():
                        angle = np.arctan2(links.sin[world], links.cos[world])
                        flume.links.pose[:] = np.stack((links.x[world], links.y[world], angle), axis=1)
                        cover_faces(flume.grid, flume.links, flume.cover)
                        sunk[world] = (1 - flume.cover.single) * under[world]
                    sunk *= density * physics.gravity * physics.time_step / links.mass
                change = each.velocity_change(_apart(replace(links, vy=links.vy - sunk)), physics)
                vx, vy, omega = (of.reshape(links.y.shape) for of in (change.vx, change.vy, change.omega))
                return puddle.VelocityChange(vx, vy - sunk, omega)

        return Flumes()


def _apart(links: puddle.LinkStates) -> puddle.LinkStates:
    """Make every link a design of its own."""
    return puddle.LinkStates(**{name: of.reshape(1, -1, 1) for name, of in vars(links).items() if name != "parent"})


def alone() -> None:
    """Print mean heights and displacements of random designs whose links are alone, and correlations with the fluid."""
    designs = puddle.random_designs(20, np.random.default_rng(1))
    media: dict[str, Any] = {
        "fluid": FluidFlume(),
        "alone": Alone(together=False),
        "alone, floating once": Alone(together=True),
    }
    displacements = []
    for name, medium in media.items():
        done = puddle.simulate(designs, puddle.Pool(4.0, medium), n_settle=200, n_measure=600, trace=True)
        assert done.trace is not None
        displacements.append(done.displacement)
        correlation = np.corrcoef(displacements[0], done.displacement)[0, 1]
        print(name, f"height {done.trace[:, 200:, :, 1].mean():.2f} m, R {correlation:.2f}", done.displacement.round(2))


def film() -> None:
    """Film the best robot that evolved in the fluid, and the best under networks that learned of it."""
    study, pool = puddle.open_study("fluid"), puddle.Pool(4.0, FluidFlume())
    best: dict[str, Any] = {}
    for row in study.champions().to_pylist():
        if row["environment"] not in best or row["zero_shot"] > best[row["environment"]]["zero_shot"]:
            best[row["environment"]] = row
    replays = []
    for name, title in (("fluid", "Evolved in the fluid"), ("wetted", "Evolved under networks that learned of it")):
        design = study.champion(name, depth=4.0, trial=best[name]["trial"])
        trace = puddle.simulate(design, pool, n_settle=200, n_measure=600, trace=True).trace[0]
        seen = replay_of(design, trace, pool, title=title, seen_in="a fluid", n_settle=200)
        replays.append(replace(seen, color=(LOOKS.get(name) or OTHERS[0]).color))
    Path("docs/fluid.gif").write_bytes(render_gif(replays))


if sys.argv[1:] == ["robots"]:
    robots()
elif sys.argv[1:] == ["alone"]:
    alone()
elif sys.argv[1:] == ["film"]:
    film()
else:
    print("square, 0.25 m  ", drag(1.0, 0.25, 24.0, 8.0, 40.0))
    print("square, 0.125 m ", drag(1.0, 0.125, 16.0, 6.0, 20.0))
    print("plate, 0.25 m   ", drag(2.0, 0.25, 24.0, 12.0, 25.0))
    print("plate, 0.125 m  ", drag(2.0, 0.125, 24.0, 12.0, 25.0))
