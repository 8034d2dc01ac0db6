"""train: the ensemble of residual networks, one member at a time. Paper, "Neural Network Training"."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np
import numpy.typing as npt

from pipeline.config.settings import Settings
from pipeline.stages.collect import data_set, read_transitions
from pipeline.stages.segments import MEMBER_SCHEMA, MEMBER_VERSION, WEIGHTS, member_label
from pipeline.store.encoding import decode_table, encode_arrays, encode_table
from pipeline.store.manifest import Manifest
from pipeline.store.store import Store
from pipeline.workflow.stage import Chain, Files, Item, Job, Results, Spec, Stage, Summary, TrialSummary, Upstream
from tasks.residual import STATE, Architecture, ErrorRow, Training

NAME, VERSION = "train", 1

LEARNING, ERRORS = "learning.parquet", "errors.parquet"

UNIT_OF = dict(zip(STATE, ("m", "m", "rad", "m/s", "m/s", "rad/s"), strict=True))
"""Unit of each component of a residual, per step."""

ERROR_UNITS = {
    "component": "of the residual",
    "band": "of |v| [m/s]",
    "n_rows": "transitions held out",
    "rmse": "component's unit a step",
    "bias": "component's unit a step",
    "relative_error": "of the true residual's root mean square",
    "r2": "",
}


def reads(settings: Settings) -> tuple[str, ...]:
    """Every member reads the data set."""
    return ("collect",)


def plan(settings: Settings) -> Sequence[Chain]:
    """Train each member by itself; none at all where no trial needs them."""
    if not settings.needs_ensemble:
        return []
    return [
        Chain(
            label=member_label(member),
            units=(settings.training.n_iterations,),
            spec={
                "network": settings.network.model_dump(mode="json"),
                "training": _spec_of(settings.training),
                "seed": settings.seed,
                "member": member,
            },
        )
        for member in range(settings.ensemble.n_members)
    ]


def _spec_of(training: Training) -> Spec:
    """Say what a member follows from: a GPU's low bits are its own. A core goes without saying, as in older stores."""
    return training.model_dump(mode="json", exclude={"device"} if training.device == "cpu" else None)


def item(settings: Settings, chain: Chain, index: int, previous: Manifest | None, upstream: Upstream) -> Item:
    """Specify a member's training: it reads every chunk of throws."""
    execution = {"n_gpus": 1} if settings.training.device == "cuda" else {}
    return Item(NAME, VERSION, chain.label, chain.spec, data_set(upstream["collect"]), execution)


def compute(job: Job, inputs: Mapping[str, Files]) -> Files:
    """Train one member."""
    from tasks.residual.training import train_member

    trained = train_member(
        read_transitions([inputs[name] for name in sorted(inputs)]),
        Architecture.model_validate(job.spec["network"]),
        Training.model_validate(job.spec["training"]),
        seed=job.spec["seed"],
        member=job.spec["member"],
    )
    iteration, training_loss, validation_loss = trained.learning_curve.T
    learning = {
        "iteration": iteration.astype(np.int64),
        "training_loss": training_loss,
        "validation_loss": validation_loss,
    }
    errors = {f.name: np.array([getattr(row, f.name) for row in trained.validation]) for f in fields(ErrorRow)}
    return {
        WEIGHTS: encode_arrays(trained.arrays(), schema=MEMBER_SCHEMA, version=MEMBER_VERSION, producer=job.key),
        LEARNING: encode_table(learning, schema="learning", version=1, producer=job.key),
        ERRORS: encode_table(errors, schema="errors", version=1, producer=job.key, units=ERROR_UNITS),
    }


def read_errors(data: bytes, source: str) -> dict[str, npt.NDArray[Any]]:
    """Read a member's errors on the throws held out: columns of ErrorRow."""
    return decode_table(data, schema="errors", version=1, source=source)


def summarise(settings: Settings, results: Results, store: Store) -> Summary:
    """Say how wrong each member is at the speeds of robots and over all throws."""
    lines, trials = [], []
    for label, (member,) in results.done.items():
        errors = read_errors(store.read(member, ERRORS), label)
        learning = decode_table(store.read(member, LEARNING), schema="learning", version=1, source=member.key)
        metrics = {}
        for component in ("vx", "vy", "omega"):
            for band in ("all", "< 0.5"):
                row = np.flatnonzero((errors["component"] == component) & (errors["band"] == band))[0]
                name = f"{component}.{'low_speed' if band != 'all' else 'all'}"
                metrics[f"relative_error.{name}"] = float(errors["relative_error"][row])
                metrics[f"bias.{name}"] = float(errors["bias"][row])
        lines.append(
            f"{label}: relative error of vx {metrics['relative_error.vx.all']:.3f}, "
            f"below 0.5 m/s {metrics['relative_error.vx.low_speed']:.2f} "
            f"(bias {metrics['bias.vx.low_speed']:+.4f} m/s a step)"
        )
        curves = {name: learning[name] for name in ("training_loss", "validation_loss")}
        steps = learning["iteration"].tolist()
        trials.append(TrialSummary(name=label, params={}, metrics=metrics, curves=curves, steps=steps))
    return Summary(lines=lines or ["no trial needs residual networks"], trials=trials)


STAGE = Stage(
    name=NAME,
    version=VERSION,
    unit="iterations",
    reads=reads,
    plan=plan,
    item=item,
    compute=compute,
    summarise=summarise,
)
