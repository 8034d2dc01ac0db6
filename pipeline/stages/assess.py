"""assess: how well the networks predict where designs really get. Paper, "Prediction Accuracy" and Fig. 3.

Designs are drawn over the generations of every trial in True Slush and on Dry Land at one depth, and each is simulated
in True Slush and under every member. What the figures say of it is computed by the stage analyse.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from pipeline.config.settings import EnvironmentName, Settings
from pipeline.stages import divergence, segments
from pipeline.store.encoding import decode_table, encode_table
from pipeline.store.manifest import Manifest
from pipeline.store.store import Store
from pipeline.workflow.stage import Chain, Files, Input, Item, Job, Results, Stage, Summary, Upstream
from tasks.analysis import draw_over_generations, spread_evenly
from tasks.design import Designs
from tasks.design.genes import DTYPES, GENES
from tasks.seeding import generator

NAME, VERSION = "assess", 1

PREDICTIONS = "predictions.parquet"

SOURCES: tuple[EnvironmentName, ...] = ("true_slush", "dry_land")
"""Environments whose trials designs are drawn from: the paper's, which know nothing of the networks."""

UNITS = {
    "environment": "where the design evolved",
    "depth": "m",
    "trial": "",
    "generation": "",
    "identity": "running number within the trial",
    "true": "m, of the root in True Slush; NaN where diverged",
    "true_com": "m, of the centre of mass in True Slush",
    "predicted": "m, of the root under each member; NaN where diverged",
    "predicted_com": "m, of the centre of mass under each member",
}
"""Columns of the predictions beside the genes, and their units."""


def reads(settings: Settings) -> tuple[str, ...]:
    """Designs come out of evolution, predictions out of the networks."""
    return ("train", "evolve")


def plan(settings: Settings) -> Sequence[Chain]:
    """Give every trial its share of the designs; none where there are no networks to judge."""
    depth = settings.assessed_depth
    trials = [row for row in settings.grid.trials() if row[0] in SOURCES and row[1] == depth]
    if not trials or not settings.needs_ensemble:
        return []
    chains = []
    for (environment, _, trial), n in zip(trials, spread_evenly(settings.assess.n_designs, len(trials)), strict=True):
        spec = {
            "identity": [NAME, depth, environment, trial],
            "seed": settings.seed,
            "depth": depth,
            "n_designs": n,
            "rollout": settings.rollout.model_dump(mode="json"),
            "physics": settings.physics.model_dump(mode="json"),
            **segments.groups_of(settings, "true_slush"),
        }
        if n:
            chains.append(Chain(segments.trial_label(environment, depth, trial), (n,), spec))
    return chains


def item(settings: Settings, chain: Chain, index: int, previous: Manifest | None, upstream: Upstream) -> Item:
    """Specify a trial's share: it reads the trial's whole history and every member."""
    inputs = segments.world_inputs(settings, "residual_slush", 0, upstream)
    for number, segment in enumerate(upstream["evolve"].chain(chain.label)):
        inputs[f"segment-{number:06d}"] = Input(segment, (segments.HISTORY,))
    return Item(NAME, VERSION, chain.label, chain.spec, inputs, execution={"engine": settings.work.engine})


def compute(job: Job, inputs: Mapping[str, Files]) -> Files:
    """Draw a trial's share and simulate it."""
    spec = job.spec
    _, depth, environment, trial = spec["identity"]
    history = _history([inputs[name] for name in sorted(inputs) if name.startswith("segment-")])
    rng = generator(spec["seed"], *spec["identity"])
    drawn = draw_over_generations(history["generation"], spec["n_designs"], rng)
    designs = Designs.from_arrays(history)[drawn]
    true, predicted = (
        segments.roll_out(spec, job.execution, segments.world_of({**spec, "world": world}, inputs), designs)
        for world in ("true_slush", "residual_slush")
    )
    columns = {
        "environment": np.full(len(drawn), environment),
        "depth": np.full(len(drawn), depth),
        "trial": np.full(len(drawn), trial),
        "generation": history["generation"][drawn],
        "identity": history["identity"][drawn],
        "true": true.displacement,
        "true_com": true.com_displacement,
        "predicted": predicted.displacement.T,
        "predicted_com": predicted.com_displacement.T,
        **dict(designs.arrays()),
    }
    units = UNITS | {gene.name: gene.unit for gene in GENES}
    return {PREDICTIONS: encode_table(columns, schema="predictions", version=1, producer=job.key, units=units)}


def _history(parts: Sequence[Files]) -> dict[str, npt.NDArray[Any]]:
    """Join what is needed of a trial's histories: which designs there were, and when."""
    tables = [decode_table(part[segments.HISTORY], schema="history", version=1, source="history") for part in parts]
    names = ("generation", "identity", *DTYPES)
    return {name: np.concatenate([table[name] for table in tables]) for name in names}


def read_predictions(files: Sequence[Files]) -> dict[str, npt.NDArray[Any]]:
    """Join the shares of several trials, at least one."""
    tables = [decode_table(part[PREDICTIONS], schema="predictions", version=1, source=PREDICTIONS) for part in files]
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}


def summarise(settings: Settings, results: Results, store: Store) -> Summary:
    """Count designs, and those that diverged."""
    shares = [{PREDICTIONS: store.read(chain[0], PREDICTIONS)} for chain in results.done.values()]
    if not shares:
        return Summary(lines=["no designs: they take networks, and trials in True Slush or on Dry Land"])
    table = read_predictions(shares)
    n_diverged = int(divergence.somewhere(table).sum())
    n = len(table["true"])
    return Summary(
        lines=[
            f"{n} designs of {len(shares)} trials at {settings.assessed_depth:g} m, in True Slush and under "
            f"{table['predicted'].shape[1]} members; {n_diverged} diverged somewhere"
        ],
        metrics={"n_designs": n, "n_diverged": n_diverged},
    )


def diverged(settings: Settings, results: Results, store: Store) -> dict[str, str]:
    """Say what diverged of each trial's share, by label."""
    return {
        label: said
        for label, (share,) in results.done.items()
        if (said := divergence.in_assessment(read_predictions([{PREDICTIONS: store.read(share, PREDICTIONS)}])))
    }


STAGE = Stage(
    name=NAME,
    version=VERSION,
    unit="designs",
    reads=reads,
    plan=plan,
    item=item,
    compute=compute,
    summarise=summarise,
    diverged=diverged,
)
