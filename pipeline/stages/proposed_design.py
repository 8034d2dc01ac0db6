"""The champion of each arm that is proposed for building: its design file, and its films in the tank.

Part of the stage report.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pipeline.config.settings import EnvironmentName, Settings
from pipeline.report.findings import TankRow
from pipeline.report.replay import Replay, replay_of
from pipeline.stages import segments
from pipeline.stages.analyse import read_rows, tank_label
from pipeline.stages.transfer import CHAMPION
from pipeline.store.design_file import design_from
from pipeline.store.encoding import decode_json
from pipeline.workflow.stage import Files
from tasks.simulation import OK, simulate
from tasks.world import ENVIRONMENTS, DryLand

Row = tuple[EnvironmentName, float, int]
"""Environment, depth [m] and number of a trial."""

PROPOSED = "proposed-"
"""How the names of the proposed champions' design files begin."""

MOST_SECONDS_IN_TANK = 60.0
"""Of the films of the tank: a minute of a robot that goes nowhere is enough."""


def proposed(settings: Settings, inputs: Mapping[str, Files]) -> list[Row]:
    """Find each arm's champion that is proposed for building; none without a tank."""
    found: list[Row] = []
    for environment, depth in dict.fromkeys(trial[:2] for trial in settings.grid.trials()):
        rows = read_rows(inputs.get(f"analyse/{tank_label(environment, depth)}"), "tank", TankRow)
        found += [(environment, depth, row.trial) for row in rows if row.proposed]
    return found


def proposal_files(rows: list[Row], inputs: Mapping[str, Files]) -> Files:
    """Give the design files of proposed champions, named by their arms; the store wants no second dot in a name."""
    return {f"{PROPOSED}{row[0]}-{row[1]:g}m".replace(".", "_") + ".json": _champion_file(row, inputs) for row in rows}


def _champion_file(row: Row, inputs: Mapping[str, Files]) -> bytes:
    return inputs[f"transfer/{segments.trial_label(*row)}"][CHAMPION]


def tank_replays(settings: Settings, row: Row, inputs: Mapping[str, Files], engine: Any) -> list[Replay]:
    """Film a proposed champion in the tank and on its dry floor. They show a tank, so they are of no environment."""
    assert settings.tank is not None
    environment, _, trial = row
    label = segments.trial_label(*row)
    design = design_from(decode_json(_champion_file(row, inputs), label), label)
    tank, n_settle, time_step = settings.tank, settings.rollout.n_settle, settings.physics.time_step
    replays = []
    for world, words in (
        (segments.true_slush(segments.groups_of(settings, "true_slush"), tank.simulated_depth), "the tank"),
        (DryLand(depth=0.0), "the drained tank"),
    ):
        rollouts = simulate(
            design,
            world,
            n_settle=n_settle,
            n_measure=min(tank.n_steps(time_step), round(MOST_SECONDS_IN_TANK / time_step)),
            engine=engine,
            trace=True,
            physics=settings.physics,
        )
        if rollouts.status[0] == OK:
            assert rollouts.trace is not None
            replays.append(
                replay_of(
                    design,
                    rollouts.trace[0],
                    title=f"To build: evolved {ENVIRONMENTS[environment].evolved}, trial {trial}, in {words}",
                    environment="",
                    seen_in=words,
                    depth=round(world.depth, 2),
                    surroundings="air" if world.medium is None else "true slush",
                    n_settle=n_settle,
                    time_step=time_step,
                )
            )
    return replays
