"""The cost model of `puddle forecast`: seconds and bytes of the work that is left.

The cost of a work item is affine in its size: a fixed part, and a part per weighted unit. Both are fitted to samples,
for each kind of chain. Samples come from the manifests of the store, of this study and of others with the same
settings as far as these decide the cost of a unit. Where the store has none, a calibration run provides them.

A stage takes the longest of four times: its core-seconds divided by the number of cores; its longest chain, because a
trial's segments follow one another; the driver's time for its items, which pass through that one process one after the
other; and its traffic at the rate of the driver's network.

On an AMD EPYC with compiled kernels, the ratio of forecast to real processor time in smoke and in a small laptop (2
depths, 2 trials, 100 generations) was: collect 1.12 and 1.03, train 1.22 and 0.92, evolve 1.15 and 1.09, transfer 0.94
and 1.08, assess 1.28 and 1.24 (at one depth, with 400 designs), analyse 0.91 and 0.74, report 1.01 and 1.00. Bytes were
within a factor of 2, except in analyse of smoke (0.48).
"""

from __future__ import annotations

import math
import os
import statistics
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from pipeline.commands.expected_time import batches_per_generation
from pipeline.config.settings import Settings
from pipeline.errors import PuddleError
from pipeline.stages import STAGES
from pipeline.store.manifest import Manifest, encode_manifest
from pipeline.store.store import Store
from pipeline.workflow.graph import StageRun, results_of
from pipeline.workflow.record import settings_of
from pipeline.workflow.stage import AnyStage, Chain, Item, Results, Upstream


@dataclass(frozen=True)
class DriverLimits:
    """What the one process that submits and commits all items can do."""

    seconds_per_item: float = 0.009  # to submit, collect, commit and mirror one; see docs/cluster.md
    seconds_per_byte: float = 18e-9  # of an item's results, on top of that
    bytes_per_second: float = 125e6  # to and from workers on other machines; 1 Gbit/s

    @classmethod
    def stated(cls, ms_per_item: float | None, network_gbit: float | None) -> DriverLimits:
        """Return the limits that a user states on the command line, or the usual ones; each must be above 0."""
        usual = cls()
        if ms_per_item is not None:
            usual = replace(usual, seconds_per_item=1e-3 * _positive("--driver-ms", ms_per_item))
        if network_gbit is not None:
            usual = replace(usual, bytes_per_second=1e9 / 8 * _positive("--network-gbit", network_gbit))
        return usual


def _positive(option: str, value: float) -> float:
    if not (math.isfinite(value) and value > 0):
        raise PuddleError(f"{option}: expected a number above 0, got {value:g}")
    return value


@dataclass(frozen=True)
class CostKind:
    """What chains have in common whose weighted units cost the same."""

    stage: str
    specification: str  # type of the chain's specification
    of: str  # where most of its rollouts are, or the name of the analysis; may be empty


def kind_of(stage: AnyStage, chain: Chain[Any]) -> CostKind:
    """Return a chain's kind."""
    of = getattr(chain.spec, "environment", "") or getattr(chain.spec, "analysis", "")
    return CostKind(stage.name, type(chain.spec).__name__, of)


@dataclass(frozen=True)
class Sample:
    """The cost of one item."""

    size: float  # weighted units
    seconds: float
    n_bytes: float  # on the disk
    input_bytes: float


def input_bytes_of(item: Item[Any]) -> int:
    """Return the length of an item's inputs [bytes].

    An input counts in full for every item, although Ray sends one that items share only once to each machine.
    """
    return sum(source.manifest.files[name].n_bytes for source in item.inputs.values() for name in source.files)


def bytes_of(manifest: Manifest) -> int:
    """Return the disk space that an item takes [bytes]."""
    n_bytes = len(encode_manifest(manifest)) + sum(entry.n_bytes for entry in manifest.files.values())
    return 2 * n_bytes if manifest.stage == "report" else n_bytes  # people open a copy of the report


@dataclass(frozen=True)
class Cost:
    """The cost of an item as a function of its size."""

    fixed_seconds: float
    seconds_per_unit: float
    fixed_bytes: float
    bytes_per_unit: float
    input_bytes: float

    @classmethod
    def fit(cls, samples: Sequence[Sample], *, bytes_grow: bool = True) -> Cost:
        """Fit the medians of the smallest and of the greatest size, which ignore items that waited for a compiler.

        Args:
            samples: items of one kind.
            bytes_grow: whether results grow with an item's size; a network does not with the iterations.
        """
        sizes = [sample.size for sample in samples]
        least, most = min(sizes), max(sizes)
        small, large = ([one for one in samples if one.size == size] for size in (least, most))
        seconds = [statistics.median(one.seconds for one in group) for group in (small, large)]
        n_bytes = [statistics.median(one.n_bytes for one in group) for group in (small, large)]
        disk = _line(least, most, *n_bytes) if bytes_grow else (n_bytes[1], 0.0)
        return cls(*_line(least, most, *seconds), *disk, statistics.median(one.input_bytes for one in large))

    def seconds(self, sizes: Iterable[float]) -> float:
        """Return the time that items of these sizes take [s]."""
        return sum(self.fixed_seconds + self.seconds_per_unit * size for size in sizes)

    def n_bytes(self, sizes: Iterable[float]) -> float:
        """Return the disk space that items of these sizes take [bytes]."""
        return sum(self.fixed_bytes + self.bytes_per_unit * size for size in sizes)

    def traffic(self, sizes: Sequence[float]) -> float:
        """Return what the workers of items of these sizes receive and return [bytes]."""
        return self.input_bytes * len(sizes) + self.n_bytes(sizes)


def _line(x0: float, x1: float, y0: float, y1: float) -> tuple[float, float]:
    """Return intercept and slope, neither below 0, of the line through two points; through one, no intercept."""
    if x1 <= x0:
        return 0.0, y1 / x1
    slope = max(0.0, min((y1 - y0) / (x1 - x0), y1 / x1))
    return y1 - slope * x1, slope


@dataclass(frozen=True)
class StageForecast:
    """The work of a stage that is left."""

    stage: str
    unit: str
    n_units: float
    n_items: int
    core_seconds: float  # of GPUs, where these do the work
    longest_chain_seconds: float  # no number of cores gets below this
    n_bytes: float  # on the disk
    traffic: float  # between the driver and the workers, at most [bytes]
    source: str  # where the samples come from
    n_gpus: int = 0  # that do the work; 0 where cores do

    def times(self, n_cores: int, driver: DriverLimits) -> dict[str, float]:
        """Return the time that each limit allows the stage on a number of cores [s]; the longest decides."""
        return {
            "GPUs" if self.n_gpus else "cores": self.core_seconds / (self.n_gpus or n_cores),
            "longest chain": self.longest_chain_seconds,
            "driver": self.n_items * driver.seconds_per_item + self.n_bytes * driver.seconds_per_byte,
            "network": self.traffic / driver.bytes_per_second,
        }


@dataclass(frozen=True)
class StudyForecast:
    """The work of a study that is left."""

    study: str
    stages: tuple[StageForecast, ...]
    n_cores: tuple[int, ...]  # numbers of cores to forecast for; the first is this machine's
    store_bytes: int | None  # size of the store, if there is one
    driver: DriverLimits

    def times(self, stage: StageForecast, n_cores: int) -> dict[str, float]:
        """Return the time that each limit allows a stage [s]. This machine's own cores need no network."""
        on_this_machine = n_cores <= self.n_cores[0]
        driver = replace(self.driver, bytes_per_second=math.inf) if on_this_machine else self.driver
        return stage.times(n_cores, driver)

    def stage_seconds(self, stage: StageForecast, n_cores: int) -> float:
        """Return the time that a stage takes on a number of cores [s]."""
        return max(self.times(stage, n_cores).values())

    def limit(self, stage: StageForecast, n_cores: int) -> str:
        """Return what decides a stage's time: "cores", "GPUs", "longest chain", "driver" or "network"."""
        times = self.times(stage, n_cores)
        return max(times, key=times.__getitem__)

    def seconds(self, n_cores: int) -> float:
        """Return the time that the stages take on a number of cores, one after the other [s]."""
        return sum(self.stage_seconds(stage, n_cores) for stage in self.stages)


@dataclass(frozen=True)
class _Remaining:
    """A chain with items left to compute."""

    stage: AnyStage
    chain: Chain[Any]
    units: tuple[float, ...]  # size of each item that is left

    @property
    def kind(self) -> CostKind:
        return kind_of(self.stage, self.chain)

    @property
    def sizes(self) -> list[float]:
        return [units * self.chain.weight for units in self.units]


def remaining_chains(settings: Settings, upstream: Upstream) -> list[_Remaining]:
    """List the chains of a study that are not finished, with what is left of each."""
    found = []
    for stage in STAGES:
        n_done: Mapping[Any, int] = upstream[stage.name].n_done if stage.name in upstream else {}
        found += [_Remaining(stage, one, one.units[n_done.get(one.identity, 0) :]) for one in stage.plan(settings)]
    return [one for one in found if one.units]


def _survey(
    settings: Settings, store: Store, say: Callable[[str], None]
) -> tuple[Upstream, dict[CostKind, list[Sample]]]:
    """Find what the store holds of a study, and what its items cost."""
    upstream: dict[str, Results] = {}
    samples: dict[CostKind, list[Sample]] = {}
    for stage in STAGES:
        chains = StageRun(stage, settings, upstream, store, say).chains()
        weights = {chain.identity: chain.weight for chain in stage.plan(settings)}
        for progress in chains:
            chain, before = progress.chain, [None, *progress.manifests]
            for index, (manifest, units) in enumerate(zip(progress.manifests, chain.units, strict=False)):
                if _is_comparable(manifest, settings):
                    inputs = input_bytes_of(stage.item(settings, chain, index, before[index], upstream))
                    size, seconds = units * weights[chain.identity], manifest.record["seconds"]
                    sample = Sample(size, seconds, bytes_of(manifest), inputs)
                    samples.setdefault(kind_of(stage, chain), []).append(sample)
        upstream[stage.name] = results_of(stage, chains)
    return upstream, samples


def _is_comparable(manifest: Manifest, settings: Settings) -> bool:
    """Return whether the engine was the same and all the work was done by one core."""
    execution = manifest.record.get("execution", {})
    same_engine = execution.get("engine", settings.work.engine) == settings.work.engine
    return same_engine and "seconds" in manifest.record and execution.get("designs_per_batch") is None


def _decides_cost(settings: Settings) -> dict[str, Any]:
    """Return the settings that decide the cost of a unit, without those that count units."""
    chosen = settings.model_dump(mode="json", exclude={"name", "seed", "grid", "transfer", "assess"})
    chosen["work"] = settings.work.engine
    del chosen["replicates"]
    throws = [(group, "n_throws") for group in ("throws", "designed_throws")]
    for group, count in (*throws, ("training", "n_iterations"), ("evolution", "n_generations")):
        del chosen[group][count]
    return chosen


def _samples_of_others(settings: Settings, store: Store, say: Callable[[str], None]) -> dict[CostKind, list[Sample]]:
    """Collect samples from the store's other studies whose units cost the same."""
    samples: dict[CostKind, list[Sample]] = {}
    for name in store.studies():
        try:
            record = store.read_study(name)
            other = settings_of(record) if record is not None else settings
        except PuddleError:  # damaged, or a newer puddle's
            continue
        if other != settings and _decides_cost(other) == _decides_cost(settings):
            for kind, found in _survey(other, store, say)[1].items():
                samples.setdefault(kind, []).extend(found)
    return samples


def forecast_stages(
    settings: Settings,
    remaining: Sequence[_Remaining],
    costs: Mapping[CostKind, Cost],
    sources: Mapping[CostKind, str],
    *,
    n_gpus: int,
) -> list[StageForecast]:
    """Return the cost of the remaining work of every stage, in order.

    Args:
        settings: the study's settings.
        remaining: its unfinished chains.
        costs: the cost of each of their kinds.
        sources: where the samples of a kind come from, if not from the store.
        n_gpus: GPUs that train networks, one network each, where the settings say so.
    """
    forecasts = []
    for stage in STAGES:
        own = [one for one in remaining if one.stage is stage]
        seconds = [costs[one.kind].seconds(one.sizes) for one in own]
        n_batches = (batches_per_generation(settings, one.chain) for one in own)
        longest = max((s / n for s, n in zip(seconds, n_batches, strict=True)), default=0.0)
        found = {sources.get(one.kind, "store") for one in own}
        forecasts.append(
            StageForecast(
                stage=stage.name,
                unit=stage.unit,
                n_units=sum(sum(one.units) for one in own),
                n_items=sum(len(one.units) for one in own),
                core_seconds=sum(seconds),
                longest_chain_seconds=longest,
                n_bytes=sum(costs[one.kind].n_bytes(one.sizes) for one in own),
                traffic=sum(costs[one.kind].traffic(one.sizes) for one in own),
                source=" and ".join(sorted(found)),
                n_gpus=n_gpus if stage.name == "train" and settings.training.device == "cuda" else 0,
            )
        )
    return forecasts


_BYTES = {
    "throws": (5e3, 20e3),
    "iterations": (1.5e6, 0.0),
    "pilots": (800e3, 0.0),
    "generations": (10e3, 0.0),
    "designs": (15e3, 500.0),
    "analyses": (2e6, 0.0),
    "pictures": (1e4, 8e3),
}
"""The storage model: bytes of an item, and of each unit of its work; about twice those of the preset row, whose
networks are smaller than the paper's. Tables of generations are estimated by their designs."""

_BYTES_PER_DESIGN = 200.0
_QUICK_BATCH = 1024  # of networks that are trained only because later stages need some


def bytes_left_of_study(settings: Settings, upstream: Upstream) -> float:
    """Return an upper estimate of the rest of a study on the disk [bytes], for want of time for a calibration run."""
    total = 0.0
    for one in remaining_chains(settings, upstream):
        per_item, per_unit = _BYTES.get(one.stage.unit, (1e6, 0.0))
        if one.stage.unit == "generations":
            per_unit = _BYTES_PER_DESIGN * settings.evolution.afpo.population_size
        total += per_item * len(one.units) + per_unit * sum(one.units)
    return total


def on_stated_gpu(settings: Settings, tflops: float) -> Sample:
    """Return the cost of training a network on a GPU that reaches a stated rate [TFLOP/s].

    Each weight takes a multiplication and an addition for each sample of a minibatch: once forward, and twice backward.
    """
    n_iterations = settings.training.n_iterations
    flop = 6.0 * settings.network.n_weights * settings.training.batch_size * n_iterations
    n_bytes = _BYTES["iterations"][0]
    throws = settings.throws.n_throws * _BYTES["throws"][1]
    return Sample(n_iterations, flop / (tflops * 1e12), n_bytes, throws)


def forecast_study(
    settings: Settings,
    store: Store | None,
    cores: Sequence[int],
    *,
    gpu_tflops: float | None = None,
    n_gpus: int = 1,
    driver: DriverLimits = DriverLimits(),
    say: Callable[[str], None],
) -> StudyForecast:
    """Forecast the rest of a study, for this machine's cores and for others.

    Args:
        settings: the study's settings.
        store: the store that holds its results, if there is one.
        cores: further numbers of cores to forecast for.
        gpu_tflops: rate of a GPU that trains, instead of one of this machine [TFLOP/s].
        n_gpus: GPUs that train networks, one network each, with training.device=cuda.
        driver: what the driver can do.
        say: shows what is being timed.

    Returns:
        The cost of what is left of each stage.

    Raises:
        PuddleError: a rate is given, but is not above 0, or the settings train without a GPU.
    """
    from pipeline.commands.calibration_run import calibrate

    if gpu_tflops is not None:
        _positive("--gpu-tflops", gpu_tflops)
        if settings.training.device != "cuda":
            raise PuddleError(
                f"--gpu-tflops: training.device is '{settings.training.device}', expected --set training.device=cuda"
            )
    upstream: Upstream = {}
    samples: dict[CostKind, list[Sample]] = {}
    if store is not None:
        with store.lock_to_read():
            upstream, samples = _survey(settings, store, say)
            samples = {**_samples_of_others(settings, store, say), **samples}
    remaining = remaining_chains(settings, upstream)
    sources = dict.fromkeys({one.kind for one in remaining} - samples.keys(), "calibration")
    if gpu_tflops is not None:
        trained = {one.kind for one in remaining if one.stage.name == "train"}
        samples |= {kind: [on_stated_gpu(settings, gpu_tflops)] for kind in trained}
        sources |= dict.fromkeys(trained, "stated rate")
    if measured := {kind for kind, source in sources.items() if source == "calibration"}:
        samples |= calibrate(settings if gpu_tflops is None else _without_gpu(settings), measured, say=say)
    costs = {kind: Cost.fit(found, bytes_grow=kind.stage != "train") for kind, found in samples.items()}
    own = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    stages = tuple(forecast_stages(settings, remaining, costs, sources, n_gpus=n_gpus))
    store_bytes = None if store is None else store.size_bytes()
    return StudyForecast(settings.name, stages, tuple(dict.fromkeys([own, *cores])), store_bytes, driver)


def _without_gpu(settings: Settings) -> Settings:
    """Return settings whose networks a core trains at once, to compute what comes after them."""
    quick = {"device": "cpu", "batch_size": min(_QUICK_BATCH, settings.training.batch_size)}
    return settings.model_copy(update={"training": settings.training.model_copy(update=quick)})
