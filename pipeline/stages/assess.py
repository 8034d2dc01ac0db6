"""assess: how well the networks predict where designs really get. Paper, "Prediction Accuracy" and Fig. 3.

Designs are drawn over the generations of every trial in the target and on Dry Land at one depth, and each is simulated
in the target and under every member. What the figures say of it is computed by the stage analyse.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.config.settings import Settings
from pipeline.stages import divergence, environments
from pipeline.stages.cost import seconds_of_rollout
from pipeline.stages.data_sets import AssessmentId, DataSetId, ensemble_ids
from pipeline.stages.environments import SimulationSpec
from pipeline.stages.files import HISTORY, PREDICTIONS
from pipeline.stages.reader import read_study
from pipeline.stages.segments import units_of_genes
from pipeline.store.manifest import Manifest
from pipeline.store.store import Store
from pipeline.workflow.identity import InputName, TrialId, trials_of
from pipeline.workflow.stage import Chain, Execution, Files, Input, Inputs, Item, Stage, Summary, Upstream
from tasks.analysis.sample import draw_over_generations, spread_evenly
from tasks.design import Designs
from tasks.residual import arm_kind
from tasks.seeding import generator
from tasks.world import EnvironmentName

_SEGMENT = "segment"  # role of the inputs that are a trial's histories


def _units(target: str, controller: str) -> dict[str, str]:
    """Return what the columns of the predictions are, or their units."""
    return {
        "environment": "where the design evolved",
        "depth": "m",
        "trial": "",
        "generation": "",
        "identity": "running number within the trial",
        "true": f"m, of the root in {target}; NaN where diverged",
        "true_com": f"m, of the centre of mass in {target}",
        "predicted": "m, of the root under each member; NaN where diverged",
        "predicted_com": "m, of the centre of mass under each member",
        **units_of_genes(controller),
    }


@dataclass(frozen=True)
class AssessSpec:
    """A trial's share of the assessed designs."""

    trial: TrialId
    n_designs: int
    seed: int
    simulation: SimulationSpec
    target: EnvironmentName
    learner: EnvironmentName  # whose networks predict


def _plan(settings: Settings) -> Sequence[Chain[AssessSpec]]:
    """Give every trial its share of the designs, once for each ensemble.

    Designs come from trials in the target and on Dry Land: as in the paper, those that do not depend on the networks.
    """
    trials = [
        trial
        for trial in trials_of(settings, "assess")
        if trial.environment in (settings.target, "dry_land") and trial.depth == settings.assessed_depth
    ]
    if not trials or not settings.needs_ensemble or settings.learner(settings.target):
        return []
    shares = zip(trials, spread_evenly(settings.assess.n_designs, len(trials)), strict=True)
    return [
        Chain(
            AssessmentId(trial, DataSetId(learner, trial.replicate)),
            (n,),
            AssessSpec(
                trial,
                n,
                settings.seed,
                environments.simulation_spec(settings, settings.target, learner),
                settings.target,
                learner,
            ),
            sum(seconds_of_rollout(settings, name, trial.depth) for name in (settings.target, learner)),
        )
        for trial, n in shares
        if n
        for learner in settings.ensembles
    ]


def _item(
    settings: Settings, chain: Chain[AssessSpec], index: int, previous: Manifest | None, upstream: Upstream
) -> Item[AssessSpec]:
    """Specify a trial's share, which reads the trial's whole history and every member."""
    assert isinstance(chain.identity, AssessmentId)
    inputs = environments.network_inputs(ensemble_ids(settings, chain.identity.data_set), upstream)
    evolved = chain.spec.trial.in_stage("evolve")
    for number, segment in enumerate(upstream["evolve"].chain(evolved)):
        inputs[InputName(_SEGMENT, evolved, number)] = Input(segment, (HISTORY.name,))
    return Item(ASSESS.name, ASSESS.version, chain.label, chain.spec, inputs, Execution(settings.work.engine))


def _compute(item: Item[AssessSpec], inputs: Inputs) -> Files:
    """Draw a trial's share and simulate it."""
    spec, trial = item.spec, item.spec.trial
    history = HISTORY.read([files for name, files in inputs.items() if name.role == _SEGMENT])
    rng = generator(spec.seed, *trial.seed_identity)
    drawn = draw_over_generations(history["generation"], spec.n_designs, rng)
    designs = Designs.from_arrays(history)[drawn]
    networks = environments.networks_among(inputs)
    true, predicted = (
        environments.roll_out(
            spec.simulation,
            item.execution,
            environments.build_environment(spec.simulation.media, name, trial.depth, networks),
            designs,
        )
        for name in (spec.target, spec.learner)
    )
    columns = {
        "environment": np.full(len(drawn), trial.environment),
        "depth": np.full(len(drawn), trial.depth),
        "trial": np.full(len(drawn), trial.index),
        "generation": history["generation"][drawn],
        "identity": history["identity"][drawn],
        "true": true.displacement,
        "true_com": true.com_displacement,
        "predicted": predicted.displacement.T,
        "predicted_com": predicted.com_displacement.T,
        **dict(designs.arrays()),
    }
    units = _units(arm_kind(spec.target).label, designs.controller)
    return {PREDICTIONS.name: PREDICTIONS.encode(columns, units)}


def _summarise(settings: Settings, upstream: Upstream, store: Store) -> Summary:
    """Count designs, and those that diverged."""
    shares = list(read_study(settings, upstream, store).predictions.values())
    if not shares:
        return Summary(lines=[f"no designs: they take networks, and trials in {settings.target_label} or on Dry Land"])
    n_diverged = sum(int(divergence.somewhere(share).sum()) for share in shares)
    n = sum(len(share["true"]) for share in shares)
    members = " or ".join(f"{k}" for k in sorted({share["predicted"].shape[1] for share in shares}))
    ensembles = f" of {len(settings.ensembles)} ensembles" if len(settings.ensembles) > 1 else ""
    return Summary(
        lines=[
            f"{n} designs of {len(shares)} trials at {settings.assessed_depth:g} m, in {settings.target_label} and "
            f"under {members} members{ensembles}; {n_diverged} diverged"
        ],
        metrics={"n_designs": n, "n_diverged": n_diverged},
    )


ASSESS = Stage(
    name="assess",
    version=1,
    unit="designs",
    reads=lambda settings: ("train", "evolve"),
    plan=_plan,
    item=_item,
    compute=_compute,
    summarise=_summarise,
    diverged=divergence.in_stage("assess"),
)
