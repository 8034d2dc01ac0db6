"""How long a study takes, and how much disk: the model of `puddle forecast`.

An item of work takes the median time of those that the store has of its kind, by its units. Where the store has none,
the weight of its chain decides (pipeline/stages/cost.py). What runs on a GPU has no such time: none is counted before
the store has some of it.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from pipeline.config.settings import Settings
from pipeline.stages import STAGES, environments
from pipeline.stages.cost import population_size
from pipeline.stages.data_sets import AssessmentId
from pipeline.stages.segments import TrialSpec
from pipeline.store.manifest import Manifest
from pipeline.store.store import Store
from pipeline.workflow.graph import survey
from pipeline.workflow.stage import AnyStage, Chain, Upstream

UNMEASURED = "unmeasured on a GPU"
_SECONDS_PER_ITEM = {"collect": 0.3, "train": 1.0, "analyse": 1.0}  # to import torch and the like; else as below
_SECONDS_PER_OTHER_ITEM = 0.05
_BYTES = {  # of an item, and of each unit; networks and generations follow from their sizes
    "throws": (5e3, 7e3),
    "champions": (0.0, 3e3),
    "designs": (15e3, 500.0),
    "analyses": (500e3, 0.0),
    "pictures": (1e4, 1.5e3),
}
_BYTES_PER_DESIGN = 200.0


class _Kind(NamedTuple):
    """What chains have in common whose units cost the same."""

    stage: str
    specification: str
    environment: str
    one_gpu: bool


class _Cost(NamedTuple):
    """The cost of a weighted unit, as measured."""

    seconds: float
    n_bytes: float


@dataclass(frozen=True)
class StageForecast:
    """The work of a stage that is left."""

    stage: str
    unit: str
    n_units: float
    core_seconds: float  # of GPUs, where these compute
    longest_chain_seconds: float  # no number of cores gets below this
    n_bytes: float
    source: str  # "store", "table", "unmeasured on a GPU" (whose time is not counted), or several

    def seconds(self, n_cores: float) -> float:
        """Return the time that the stage takes on a number of cores [s]."""
        return max(self.core_seconds / max(n_cores, 1.0), self.longest_chain_seconds)


def forecast_stages(settings: Settings, store: Store | None = None) -> list[StageForecast]:
    """Forecast what is left of each stage of a study; the store, if there is one, tells what its work has cost."""
    upstream: Upstream = {}
    costs: dict[_Kind, _Cost] = {}
    if store is not None:
        upstream, costs = _survey(settings, store)
    return [_forecast(stage, settings, upstream, costs) for stage in STAGES]


def _kind(stage: AnyStage, chain: Chain[Any]) -> _Kind:
    return _Kind(stage.name, type(chain.spec).__name__, getattr(chain.spec, "environment", ""), chain.one_gpu)


def _forecast(stage: AnyStage, settings: Settings, upstream: Upstream, costs: Mapping[_Kind, _Cost]) -> StageForecast:
    n_done = upstream[stage.name].n_done if stage.name in upstream else {}
    n_units = total = longest = n_bytes = 0.0
    sources = set[str]()
    for chain in stage.plan(settings):
        units = chain.units[n_done.get(chain.identity, 0) :]
        if not units:
            continue
        measured = costs.get(_kind(stage, chain))
        unknown = measured is None and (chain.one_gpu or _has_served_networks(settings, chain))
        sources.add("store" if measured else UNMEASURED if unknown else "table")
        size = sum(units) * chain.weight
        fixed = len(units) * _SECONDS_PER_ITEM.get(stage.name, _SECONDS_PER_OTHER_ITEM)
        seconds = size * measured.seconds if measured else 0 if unknown else fixed + size
        n_bytes += size * measured.n_bytes if measured else _expected_bytes(stage, settings, chain, units)
        n_units, total = n_units + sum(units), total + seconds
        if chain.one_gpu:  # they follow one another
            longest += seconds
        else:
            longest = max(longest, seconds / _workers_per_generation(settings, chain))
    return StageForecast(stage.name, stage.unit, n_units, total, longest, n_bytes, " and ".join(sorted(sources)))


def _has_served_networks(settings: Settings, chain: Chain[Any]) -> bool:
    """Return whether the inference service evaluates networks for a chain."""
    trial = chain.spec if isinstance(chain.spec, TrialSpec) else getattr(chain.spec, "trial", None)
    under_networks = isinstance(chain.identity, AssessmentId) or getattr(trial, "environment", "") in settings.learners
    return under_networks and settings.work.networks == "gpu"


def _survey(settings: Settings, store: Store) -> tuple[Upstream, dict[_Kind, _Cost]]:
    """Find what the store has of a study, and the median cost of a unit of each kind."""
    done = survey(settings, STAGES, store)
    samples: dict[_Kind, list[_Cost]] = {}
    for stage in STAGES:
        for progress in done.chains[stage.name]:
            weight = progress.chain.weight
            for manifest, units in zip(progress.manifests, progress.chain.units, strict=False):
                if units * weight > 0 and _on_one_core(manifest):
                    n_bytes = sum(entry.n_bytes for entry in manifest.files.values())
                    cost = _Cost(manifest.record["seconds"] / (units * weight), n_bytes / (units * weight))
                    samples.setdefault(_kind(stage, progress.chain), []).append(cost)
    costs = {kind: _Cost(*map(statistics.median, zip(*found, strict=True))) for kind, found in samples.items()}
    return done.upstream, costs


def _on_one_core(manifest: Manifest) -> bool:
    return "seconds" in manifest.record and manifest.record.get("execution", {}).get("designs_per_batch") is None


def _workers_per_generation(settings: Settings, chain: Chain[Any]) -> int:
    """Return how many workers compute a generation of a trial at the same time; 1 for other chains."""
    if not isinstance(chain.spec, TrialSpec):
        return 1
    size = environments.execution_options(settings, chain.spec.environment).designs_per_batch
    return math.ceil(population_size(settings) / size) if size else 1


def _expected_bytes(stage: AnyStage, settings: Settings, chain: Chain[Any], units: tuple[float, ...]) -> float:
    if stage.name == "train":
        return len(units) * (4.0 * float(chain.spec.network.n_weights) + 20e3)
    per_item, per_unit = _BYTES.get(stage.unit, (1e4, _BYTES_PER_DESIGN * population_size(settings)))
    return per_item * len(units) + per_unit * sum(units)
