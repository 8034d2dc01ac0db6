"""collect: the data sets of throws, simulated in chunks, or tracked. Paper, "Dataset Collection"."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from pipeline.config.settings import Settings
from pipeline.stages import environments
from pipeline.stages.cost import seconds_of_throw
from pipeline.stages.data_sets import ChunkId, DataSetId, data_sets
from pipeline.stages.environments import Media
from pipeline.stages.files import TRANSITIONS
from pipeline.stages.reader import chunks_of, read_transitions
from pipeline.stages.tracked import TRACK_REPORT, encode_report, outside_files, read_tracks, report_lines, unnamed
from pipeline.store.encoding import decode_json, encode_json
from pipeline.store.manifest import Manifest
from pipeline.store.store import Store
from pipeline.workflow.identity import InputName
from pipeline.workflow.stage import (
    Chain,
    Files,
    Input,
    Inputs,
    Item,
    Results,
    Sources,
    Stage,
    StoredFiles,
    Summary,
    Upstream,
)
from tasks.bench.tracks import Tracks, residual_transitions
from tasks.bench.tracks.residuals import N_FOLDS
from tasks.residual import STATE, Throws, Transitions, form_named, initial_states, robot_ranges, simulate_throws
from tasks.residual.forms import kicks_unseen
from tasks.seeding import generator, replicate_seed
from tasks.world import EnvironmentName, Physics

THROWN = "throws"  # role of the inputs that are chunks of the data set
_RANGES = "ranges.json"  # of the states of robots, which designed throws cover
_STATE_UNITS = f"{', '.join(STATE)} [m, m, rad, m/s, m/s, rad/s]"
_UNITS = {
    "throw": "",
    "step": "",
    "length_scale": "m",
    "state": _STATE_UNITS,
    "next_in_target": _STATE_UNITS,
    "next_on_dry_land": _STATE_UNITS,
    "residual": f"{', '.join(STATE)}, in the target minus on dry land [m, m, rad, m/s, m/s, rad/s]",
    "kick": "vx, vy, omega [m/s, m/s, rad/s]",
    "residual_sd": f"deviations of {_STATE_UNITS}",
    "held_out": "",
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
    target: EnvironmentName  # whose medium links are thrown into


@dataclass(frozen=True)
class TracksSpec:
    """All tracked throws, and a medium fitted to all but a fold. The files' digests are among the item's inputs."""

    tracks: Tracks  # without the files' names
    physics: Physics
    fold: int
    method: int = 5  # raised when other transitions are made of the same tracks


def _plan(settings: Settings) -> Sequence[Chain[ChunkSpec | TracksSpec]]:
    """Divide the throws of every data set into chunks; there are none if no trial needs networks."""
    media = environments.media_of(settings, settings.target)
    chains = list[Chain[ChunkSpec | TracksSpec]]()
    ensembles, size = settings.ensembles, settings.work.throws_per_item
    for data_set in data_sets(settings):
        throws = ensembles[data_set.learner].throws
        weight = seconds_of_throw(settings, throws)
        if throws.source == "tracks" and settings.tracks is not None:
            for fold in range(min(N_FOLDS, throws.n_throws)):
                of_tracks = TracksSpec(unnamed(settings.tracks), settings.physics, fold)
                chains.append(Chain(ChunkId(data_set, fold), (throws.n_throws,), of_tracks, weight))
            continue
        seed = replicate_seed(settings.seed, data_set.replicate)
        for first in range(0, throws.n_throws, size):
            n = min(size, throws.n_throws - first)
            spec = ChunkSpec(first, n, seed, throws, settings.physics, media, settings.target)
            chains.append(Chain(ChunkId(data_set, first), (n,), spec, weight))
    return chains


def _item(
    settings: Settings, chain: Chain[ChunkSpec | TracksSpec], index: int, previous: Manifest | None, upstream: Upstream
) -> Item[ChunkSpec | TracksSpec]:
    tracks = settings.tracks if isinstance(chain.spec, TracksSpec) else None
    return Item(
        COLLECT.name, COLLECT.version, chain.label, chain.spec, {} if tracks is None else {**outside_files(tracks)}
    )


def _compute(item: Item[ChunkSpec | TracksSpec], inputs: Inputs) -> Files:
    spec = item.spec
    if isinstance(spec, TracksSpec):
        read = read_tracks(inputs)
        tracked, report = residual_transitions(read.table, read.bars, spec.tracks, spec.physics, fold=spec.fold)
        return {TRANSITIONS.name: _encoded(tracked), TRACK_REPORT: encode_report(report)}
    starts = initial_states(spec.throws, generator(spec.seed, "collect"), spec.physics)
    starts = starts[spec.first : spec.first + spec.n]
    medium = environments.build_environment(spec.media, spec.target, 0.0, {}).medium
    assert medium is not None  # what the base simulator lacks and the networks learn
    transitions = simulate_throws(starts, spec.throws.n_steps_of(spec.physics), medium, spec.physics)
    files = {TRANSITIONS.name: _encoded(transitions)}
    if spec.throws.design != "paper":
        files[_RANGES] = encode_json(asdict(robot_ranges(spec.physics)))
    return files


def _encoded(transitions: Transitions) -> bytes:
    columns: dict[str, Any] = transitions.columns()
    units = {name: _UNITS[name] for name in columns}
    return TRANSITIONS.encode(columns, units)


def throws_inputs(collected: Results, data_set: DataSetId, fold: int | None = None) -> Sources:
    """Return the chunks of a whole data set as inputs, or of tracked throws that of a fold, counted round and round.

    Raises:
        MissingInputs: a chunk is not there.
    """
    chunks = chunks_of(data_set, collected)
    if fold is not None:
        chunks = [chunk for chunk in chunks if chunk.first == fold % len(chunks)]
    return {InputName(THROWN, chunk): Input(collected.chain(chunk)[0], (TRANSITIONS.name,)) for chunk in chunks}


def throws_among(inputs: Inputs) -> list[Files]:
    """Select the chunks of the one data set among an item's inputs, in its order."""
    return [files for name, files in inputs.items() if name.role == THROWN]


def _summarise(settings: Settings, upstream: Upstream, store: Store) -> Summary:
    """Count the transitions of each data set by immersion and speed: robots move slowly, the paper's throws do not."""
    lines, metrics = list[str](), dict[str, float]()
    for data_set in data_sets(settings):
        done = upstream["collect"].done
        chunks = [
            StoredFiles(store, done[chunk][0]) for chunk in chunks_of(data_set, upstream["collect"]) if chunk in done
        ]
        if not chunks:
            continue
        transitions = read_transitions(chunks)
        name = "" if len(data_sets(settings)) == 1 else f"{data_set.label}: "
        form = form_named(settings.ensembles[data_set.learner].network.form)
        lines += [
            f"{name}{warning}" for warning in (form.warning(transitions), kicks_unseen(form, transitions)) if warning
        ]
        if TRACK_REPORT in chunks[0]:
            folds = [decode_json(chunk[TRACK_REPORT], TRACK_REPORT) for chunk in chunks]
            n_further = int((transitions.throw < 0).sum())
            lines += report_lines(folds, settings, len(transitions) - n_further, n_further)
            metrics |= {"n_throws": float(folds[0]["n_throws"]), "n_transitions": float(len(transitions))}
            continue
        speed = np.hypot(transitions.state[:, 3], transitions.state[:, 4])
        wet = np.abs(transitions.residual).max(axis=1) > 0
        slow_and_wet = float(np.mean(wet & (speed < 0.5)))
        n_throws = len(np.unique(transitions.throw))
        lines.append(
            f"{name}{n_throws:,} throws, {len(transitions):,} transitions; "
            f"{wet.mean():.0%} are wet, {slow_and_wet:.0%} at less than 0.5 m/s"
        )
        figures = {"wet_share": float(wet.mean()), "slow_and_wet_share": slow_and_wet}
        counts = {"n_throws": float(n_throws), "n_transitions": float(len(transitions))}
        metrics |= {f"{data_set.label.replace('/', '.')}.{key}": x for key, x in {**counts, **figures}.items()}
    return Summary(lines=lines or ["no throws"], metrics=metrics)


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
