"""collect: the data set of throws, in chunks. Paper, "Dataset Collection"."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from pipeline.config.settings import Settings
from pipeline.stages import environments
from pipeline.stages.environments import Media
from pipeline.stages.part import PartId
from pipeline.store.encoding import decode_table, encode_table
from pipeline.store.manifest import Manifest
from pipeline.store.store import Store
from pipeline.workflow.identity import InputName
from pipeline.workflow.stage import Chain, Files, Input, Inputs, Item, Job, Results, Stage, Summary, Upstream
from tasks.residual import OBSERVATION, STATE, Throws, Transitions, initial_states, simulate_throws
from tasks.seeding import generator
from tasks.world import Physics

THROWN = "throws"  # role of the inputs that are chunks of the data set
TRANSITIONS = "transitions.parquet"
_STATE_UNITS = f"{', '.join(STATE)} [m, m, rad, m/s, m/s, rad/s]"
_UNITS = {
    "throw": "",
    "step": "",
    "length_scale": "m",
    "state": _STATE_UNITS,
    "next_in_slush": _STATE_UNITS,
    "next_on_dry_land": _STATE_UNITS,
    "observation": f"{', '.join(OBSERVATION)} [m, m, 1, m/s, m/s, rad/s]",
    "residual": f"{', '.join(STATE)}, in slush minus on dry land [m, m, rad, m/s, m/s, rad/s]",
}


@dataclass(frozen=True)
class ChunkSpec:
    """Throws ``first`` to ``first + n`` of the data set, whose starts are all drawn at once."""

    first: int
    n: int
    seed: int
    throws: Throws
    physics: Physics
    media: Media


def _plan(settings: Settings) -> Sequence[Chain[ChunkSpec]]:
    """Divide the throws into chunks, if any trial needs networks."""
    if not settings.needs_ensemble:
        return []
    size, n_throws = settings.work.throws_per_item, settings.throws.n_throws
    media = environments.media_of(settings, "true_slush")
    return [
        Chain(
            PartId(f"throws-{first}"),
            (n,),
            ChunkSpec(first, n, settings.seed, settings.throws, settings.physics, media),
        )
        for first in range(0, n_throws, size)
        for n in [min(size, n_throws - first)]
    ]


def _item(
    settings: Settings, chain: Chain[ChunkSpec], index: int, previous: Manifest | None, upstream: Upstream
) -> Item[ChunkSpec]:
    return Item(COLLECT.name, COLLECT.version, chain.label, chain.spec, inputs={})


def _compute(job: Job[ChunkSpec], inputs: Inputs) -> Files:
    spec = job.spec
    starts = initial_states(spec.throws, generator(spec.seed, "collect"))[spec.first : spec.first + spec.n]
    medium = environments.true_medium(spec.media)
    transitions = simulate_throws(starts, spec.throws.n_steps, medium, spec.physics)
    columns = {field.name: getattr(transitions, field.name) for field in fields(Transitions)}
    return {TRANSITIONS: encode_table(columns, schema="transitions", version=1, producer=job.key, units=_UNITS)}


def data_set(collected: Results) -> dict[InputName, Input]:
    """Return the chunks of the whole data set as inputs.

    Raises:
        MissingInputs: a chunk is not there.
    """
    chunks = (*collected.done, *collected.unfinished, *collected.failed)
    return {InputName(THROWN, chunk): Input(collected.chain(chunk)[0], (TRANSITIONS,)) for chunk in chunks}


def throws_among(inputs: Inputs) -> list[Files]:
    """Select the inputs that are chunks of the data set, in its order."""
    return [files for name, files in inputs.items() if name.role == THROWN]


def read_transitions(chunks: Sequence[Files]) -> Transitions:
    """Decode and join the chunks of a data set."""
    return Transitions.concatenate(
        [
            Transitions(**decode_table(chunk[TRANSITIONS], schema="transitions", version=1, source=TRANSITIONS))
            for chunk in chunks
        ]
    )


def _summarise(settings: Settings, results: Results, store: Store) -> Summary:
    """Count transitions by immersion and speed: robots move at low speeds, throws mostly do not."""
    chunks = [{TRANSITIONS: store.read(chain[0], TRANSITIONS)} for chain in results.done.values()]
    if not chunks:
        return Summary(lines=["no throws"])
    transitions = read_transitions(chunks)
    speed = np.hypot(transitions.state[:, 3], transitions.state[:, 4])
    wet = np.abs(transitions.residual).max(axis=1) > 0
    slow_and_wet = float(np.mean(wet & (speed < 0.5)))
    return Summary(
        lines=[
            f"{len(np.unique(transitions.throw))} throws, {len(transitions)} transitions; "
            f"{wet.mean():.0%} touch slush, {slow_and_wet:.0%} touch it at less than 0.5 m/s"
        ],
        metrics={"n_transitions": len(transitions), "wet_share": float(wet.mean()), "slow_and_wet_share": slow_and_wet},
    )


COLLECT = Stage(
    name="collect",
    version=1,
    unit="throws",
    reads=lambda settings: (),
    plan=_plan,
    item=_item,
    compute=_compute,
    summarise=_summarise,
)
