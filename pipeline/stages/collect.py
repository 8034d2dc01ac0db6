"""collect: the data set of throws, in chunks. Paper, "Dataset Collection"."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields

import numpy as np

from pipeline.config.settings import Settings
from pipeline.stages import segments
from pipeline.store.encoding import decode_table, encode_table
from pipeline.store.manifest import Manifest
from pipeline.store.store import Store
from pipeline.workflow.stage import Chain, Files, Input, Item, Job, Results, Stage, Summary, Upstream
from tasks.residual import OBSERVATION, STATE, Throws, Transitions, initial_states, simulate_throws
from tasks.seeding import generator
from tasks.world import Physics

NAME, VERSION = "collect", 1

TRANSITIONS = "transitions.parquet"
SCHEMA, SCHEMA_VERSION = "transitions", 1

STATE_UNITS = f"{', '.join(STATE)} [m, m, rad, m/s, m/s, rad/s]"
UNITS = {
    "throw": "",
    "step": "",
    "length_scale": "m",
    "state": STATE_UNITS,
    "next_in_slush": STATE_UNITS,
    "next_on_dry_land": STATE_UNITS,
    "observation": f"{', '.join(OBSERVATION)} [m, m, 1, m/s, m/s, rad/s]",
    "residual": f"{', '.join(STATE)}, in slush minus on dry land [m, m, rad, m/s, m/s, rad/s]",
}


def plan(settings: Settings) -> Sequence[Chain]:
    """Cut the throws into chunks; none where no trial needs networks. All starts are drawn at once."""
    if not settings.needs_ensemble:
        return []
    size, n_throws = settings.work.throws_per_item, settings.throws.n_throws
    chains = []
    for first in range(0, n_throws, size):
        n = min(size, n_throws - first)
        spec = {
            "throws": settings.throws.model_dump(mode="json"),
            "physics": settings.physics.model_dump(mode="json"),
            **segments.groups_of(settings, "true_slush"),
            "seed": settings.seed,
            "first": first,
            "n": n,
        }
        chains.append(Chain(label=f"throws-{first}", units=(n,), spec=spec))
    return chains


def item(settings: Settings, chain: Chain, index: int, previous: Manifest | None, upstream: Upstream) -> Item:
    """Specify a chunk."""
    return Item(stage=NAME, version=VERSION, label=chain.label, spec=chain.spec, inputs={})


def compute(job: Job, inputs: Mapping[str, Files]) -> Files:
    """Throw a chunk."""
    spec = job.spec
    throws = Throws.model_validate(spec["throws"])
    starts = initial_states(throws, generator(spec["seed"], NAME))[spec["first"] : spec["first"] + spec["n"]]
    physics = Physics.model_validate(spec["physics"])
    transitions = simulate_throws(starts, throws.n_steps, segments.true_medium(spec), physics)
    columns = {field.name: getattr(transitions, field.name) for field in fields(Transitions)}
    return {TRANSITIONS: encode_table(columns, schema=SCHEMA, version=SCHEMA_VERSION, producer=job.key, units=UNITS)}


def data_set(collected: Results) -> dict[str, Input]:
    """Give the chunks of the whole data set, as inputs.

    Raises:
        MissingInputs: a chunk is not there; says why.
    """
    labels = (*collected.done, *collected.unfinished, *collected.failed)
    chunks = [collected.chain(label)[0] for label in labels]
    return {f"throws-{index:06d}": Input(chunk, (TRANSITIONS,)) for index, chunk in enumerate(chunks)}


def read_transitions(files: Sequence[Files]) -> Transitions:
    """Join the chunks of a data set."""
    chunks = [
        Transitions(**decode_table(chunk[TRANSITIONS], schema=SCHEMA, version=SCHEMA_VERSION, source=TRANSITIONS))
        for chunk in files
    ]
    return Transitions.concatenate(chunks)


def summarise(settings: Settings, results: Results, store: Store) -> Summary:
    """Count transitions by immersion and speed: robots live at low speeds, throws mostly do not."""
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


STAGE = Stage(
    name=NAME,
    version=VERSION,
    unit="throws",
    reads=lambda settings: (),
    plan=plan,
    item=item,
    compute=compute,
    summarise=summarise,
)
