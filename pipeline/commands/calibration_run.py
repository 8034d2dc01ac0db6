"""The calibration run of `puddle forecast`: a few items of every kind of work, computed and timed in this process.

The run is a small study with the settings of the real one: one depth, two trials, one chunk of throws, untrained
networks. Nothing is written to the disk. In each stage two chains of each kind are computed and stand for all chains of
their kind, so that the next stage has inputs. Where the size of items is a setting, larger and larger items are timed
until the size decides the time. Times are of the processor, so that other programs do not count.
"""

import statistics
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from pipeline.commands.cost_model import CostKind, Sample, bytes_of, input_bytes_of, kind_of
from pipeline.config.settings import Settings
from pipeline.errors import PuddleError
from pipeline.stages import STAGES
from pipeline.stages.assess import ASSESSED_ENVIRONMENTS
from pipeline.store.encoding import digest
from pipeline.store.manifest import FileEntry, Manifest
from pipeline.workflow.identity import ChainId
from pipeline.workflow.stage import AnyStage, Chain, Files, Results
from tasks.world import ENVIRONMENTS

# The setting that decides the size of a stage's items. Other stages are timed at one size.
_SIZES = {
    "collect": "throws.n_throws",
    "train": "training.n_iterations",
    "evolve": "evolution.n_generations",
    "transfer": "transfer.n_generations",
    "assess": "assess.n_designs",
    "analyse": "grid.n_trials",
}
_N_TRIALS = 2
_N_DISTINCT = 2  # chains of each kind that are computed: members of an ensemble have to differ
_N_FIRST_ITERATIONS = 4
_GROWTH = 4
_LONG_ENOUGH = 2.0  # longer items are not timed once one has taken this long [s]
_SIZE_DECIDES = 2.5  # nor once an item takes this many times as long as the shortest


@dataclass
class _Run:
    """Results in memory."""

    upstream: dict[str, Results] = field(default_factory=dict)
    files: dict[str, Files] = field(default_factory=dict)  # contents of items, by key

    def compute(
        self, stage: AnyStage, settings: Settings, chains: Sequence[Chain[Any]], index: int, previous: Manifest | None
    ) -> tuple[Manifest, Sample]:
        """Compute item ``index`` of some chains as one batch; return the first manifest and the share of an item."""
        items = [stage.item(settings, chain, index, previous, self.upstream) for chain in chains]
        inputs = [
            {
                name: {file: self.files[source.manifest.key][file] for file in source.files}
                for name, source in item.inputs.items()
            }
            for item in items
        ]
        jobs = [item.job for item in items]
        start = time.process_time()
        if len(jobs) > 1 and stage.compute_batch is not None:
            files = stage.compute_batch(jobs, inputs)[0]
        else:
            files = stage.compute(jobs[0], inputs[0])
        seconds = (time.process_time() - start) / len(jobs)
        entries = {name: FileEntry(digest(data), len(data)) for name, data in files.items()}
        manifest = Manifest(stage.name, items[0].key, items[0].identity, entries, {}, {})
        self.files[manifest.key] = files
        size = chains[0].units[index] * chains[0].weight
        return manifest, Sample(size, seconds, bytes_of(manifest), input_bytes_of(items[0]))


def calibrate(
    settings: Settings, wanted: Collection[CostKind], *, say: Callable[[str], None]
) -> dict[CostKind, list[Sample]]:
    """Return samples of every wanted kind of chains, of one size or of two and more.

    Args:
        settings: the study's settings.
        wanted: kinds of chains to time. Others are computed where these need them.
        say: shows what is being timed.

    Raises:
        PuddleError: torch finds no GPU, and the settings ask for one.
    """
    from tasks.residual.training import NoDevice

    base, run, samples = _small_study(settings), _Run(), dict[CostKind, list[Sample]]()
    last = max((i for i, stage in enumerate(STAGES) if any(kind.stage == stage.name for kind in wanted)), default=-1)
    for stage in STAGES[: last + 1]:
        say(f"timing {stage.name}")
        done: dict[ChainId, tuple[Manifest, ...]] = {}
        plan = stage.plan(base)
        try:
            for kind, chains in _by_kind(stage, plan).items():
                if stage is STAGES[-1] and kind not in wanted:
                    continue
                computed = [_compute_chain(run, stage, base, chain) for chain in chains[:_N_DISTINCT]]
                done |= {chain.identity: computed[i % len(computed)][0] for i, chain in enumerate(chains)}
                if kind in wanted:
                    manifests, first = computed[0]
                    samples[kind] = list(_timed(run, stage, settings, base, kind, manifests)) or [first]
        except NoDevice as missing:
            raise PuddleError(f"{missing}: state the rate of one with --gpu-tflops") from None
        in_order = {chain.identity: done[chain.identity] for chain in plan if chain.identity in done}
        run.upstream[stage.name] = Results(stage.name, in_order)
    return samples


def _small_study(settings: Settings) -> Settings:
    depth = statistics.median_low(settings.grid.depths)
    single = any(ENVIRONMENTS[environment].networks == "one" for environment, _, _ in settings.grid.trials())
    groups = ("throws", "designed_throws")
    changes = {
        "grid.depths": (depth,),
        "grid.single_member_depths": (depth,) if single else (),
        "grid.n_trials": min(_N_TRIALS, settings.grid.n_trials),
        "replicates": 1,
        "throws.source": "simulation",
        "tracks": None,
        **{f"{group}.n_throws": _full_size("collect", settings) for group in groups},
        "work.throws_per_item": _full_size("collect", settings),
        "training.n_iterations": min(_N_FIRST_ITERATIONS, settings.training.n_iterations),
        "evolution.n_generations": 1,
        "evolution.objective_depths": settings.objective_depths or None,
        "transfer.n_generations": 1,
        "work.generations_per_item": 1,
        "assess.n_designs": _full_size("assess", settings),
    }
    return _changed(settings, changes)


def _changed(settings: Settings, values: Mapping[str, Any]) -> Settings:
    for name, value in values.items():
        group, _, field_name = name.partition(".")
        changed = getattr(settings, group).model_copy(update={field_name: value}) if field_name else value
        settings = settings.model_copy(update={group: changed})
    return settings


def _full_size(stage: str, settings: Settings) -> int:
    """Return the size of a stage's items in the study, or the greatest that the small study allows."""
    work, n_trials = settings.work, min(_N_TRIALS, settings.grid.n_trials)
    n_assessed = sum(environment in ASSESSED_ENVIRONMENTS for environment in settings.grid.environments) * n_trials
    return {
        "collect": max(
            2, min([work.throws_per_item, *(settings.throws_of(group).n_throws for group in settings.throw_groups)])
        ),
        "train": settings.training.n_iterations,
        "evolve": min(work.generations_per_item, settings.evolution.n_generations),
        "transfer": min(work.generations_per_item, settings.transfer.n_generations),
        "assess": min(settings.assess.n_designs, max(1, n_assessed * settings.evolution.afpo.population_size)),
        "analyse": n_trials,
    }[stage]


def _by_kind(stage: AnyStage, plan: Sequence[Chain[Any]]) -> dict[CostKind, list[Chain[Any]]]:
    """Group chains by kind, those with the most items first: in transfer they adapt before they score."""
    kinds: dict[CostKind, list[Chain[Any]]] = {}
    for chain in sorted(plan, key=lambda chain: -chain.n_items):
        kinds.setdefault(kind_of(stage, chain), []).append(chain)
    return kinds


def _compute_chain(
    run: _Run, stage: AnyStage, settings: Settings, chain: Chain[Any]
) -> tuple[tuple[Manifest, ...], Sample]:
    done = [run.compute(stage, settings, [chain], 0, None)]
    for index in range(1, chain.n_items):
        done.append(run.compute(stage, settings, [chain], index, done[-1][0]))
    return tuple(manifest for manifest, _ in done), done[0][1]


def _timed(
    run: _Run, stage: AnyStage, settings: Settings, base: Settings, kind: CostKind, done: Sequence[Manifest]
) -> Iterator[Sample]:
    """Time items of growing size, after the first chain has compiled what it needs.

    Of a chain of several items the second is timed: the first generation of a trial differs from the others.
    """
    if stage.name not in _SIZES:
        return
    setting, full = _SIZES[stage.name], _full_size(stage.name, settings)
    size, shortest, sizes = _first_size(stage, base), 0.0, set[float]()
    if len(done) > 1:  # an adaptation's last item is of its own kind: it scores champions
        chain = _by_kind(stage, stage.plan(base))[kind][0]
        yield run.compute(stage, base, [chain], len(done) - 1, done[-2])[1]
    while True:
        sized = _changed(base, {setting: size})
        if stage.unit == "generations":  # two items of this size
            sized = _changed(sized, {setting: 2 * size, "work.generations_per_item": size})
        first, *others = _by_kind(stage, stage.plan(sized))[kind]
        alike = [one for one in others if (one.batch_key, one.units) == (first.batch_key, first.units)]
        index = min(1, first.n_items - 1)
        batch = [first, *alike[: first.batch_size - 1]]
        _, sample = run.compute(stage, sized, batch, index, done[0] if index else None)
        if sample.size in sizes:  # the setting does not change items of this kind
            return
        yield sample
        sizes.add(sample.size)
        shortest = shortest or sample.seconds
        if size >= full or sample.seconds > max(_LONG_ENOUGH, _SIZE_DECIDES * shortest):
            return
        if sample.seconds > _LONG_ENOUGH and len(sizes) == 1:
            return
        size = min(_GROWTH * size, full)


def _first_size(stage: AnyStage, base: Settings) -> int:
    """Return the size to begin with; assess has only its full size, because few designs leave SIMD lanes empty."""
    return {"collect": 2, "train": base.training.n_iterations, "assess": base.assess.n_designs}.get(stage.name, 1)
