"""train: the residual networks, each on a core or all of a data set on a GPU. Paper, "Neural Network Training"."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

import numpy as np

from pipeline.config.settings import Settings
from pipeline.mlflow.run import CurvePoints
from pipeline.stages.collect import throws_among, throws_inputs
from pipeline.stages.cost import seconds_of_iteration
from pipeline.stages.data_sets import NetworkId, network_ids
from pipeline.stages.environments import MEMBER_SCHEMA, MEMBER_VERSION
from pipeline.stages.files import ERRORS, LEARNING, WEIGHTS
from pipeline.stages.reader import read_transitions
from pipeline.store.encoding import decode_arrays, encode_arrays
from pipeline.store.manifest import Manifest
from pipeline.store.store import Store
from pipeline.workflow.identity import ChainId
from pipeline.workflow.stage import Chain, Execution, Files, Inputs, Item, Stage, StoredFiles, Summary, Upstream
from tasks.residual import Architecture, ErrorRow, MeasuredTransitions, Training
from tasks.residual.ensemble import Ensemble
from tasks.residual.error_report import WHOLE_THROWS, whole_throws
from tasks.residual.forms import form_here
from tasks.residual.throws import Transitions
from tasks.seeding import replicate_seed
from tasks.world import Physics

if TYPE_CHECKING:
    from tasks.residual.training import TrainedMember  # imports torch

WHOLE_ERROR = "relative_error.whole_throws"  # the metric, of tracked throws alone
MOST_ERROR = 0.2
"""Error on throws held out, as a share of their way, above which no robot is built. In synthetic tanks networks err by
a few hundredths, and robots go as far as predicted; with memory by 0.3, and they go two thirds as far."""
_ERROR_UNITS = {
    "component": "of the residual",
    "band": "of |v| [m/s]",
    "n_rows": "transitions held out",
    "rmse": "component's unit a step",
    "bias": "component's unit a step",
    "relative_error": "of the true residual's root mean square",
    "r2": "",
}


@dataclass(frozen=True)
class MemberSpec:
    """One network: a member of the ensemble, or the network of one single-member trial."""

    member: int
    seed: int
    network: Architecture
    training: Training  # it names the device: on a GPU the last bits differ, so the networks differ too
    physics: Physics  # in which the constants of a law are fitted, and tracked throws rolled out


def _plan(settings: Settings) -> Sequence[Chain[MemberSpec]]:
    """Give each network a chain; on a GPU, those of a data set form a batch."""
    chains, ensembles = [], settings.ensembles
    networks = network_ids(settings)
    n_networks = Counter(network.data_set for network in networks)
    for network in networks:
        learner = ensembles[network.data_set.learner]
        seed = replicate_seed(settings.seed, network.data_set.replicate)
        spec = MemberSpec(network.index, seed, learner.network, learner.training, settings.physics)
        weight = seconds_of_iteration(learner.network, learner.training)
        on_gpu = spec.training.device == "cuda"
        batch_size = n_networks[network.data_set] if on_gpu else 1
        units = (spec.training.n_iterations,)
        chains.append(Chain(network, units, spec, weight, network.data_set, batch_size, one_gpu=on_gpu))
    return chains


def _item(
    settings: Settings, chain: Chain[MemberSpec], index: int, previous: Manifest | None, upstream: Upstream
) -> Item[MemberSpec]:
    execution = Execution(n_gpus=1 if chain.spec.training.device == "cuda" else 0)
    assert isinstance(chain.identity, NetworkId)
    data_set, number = chain.identity.data_set, chain.identity.index
    is_tracked = settings.ensembles[data_set.learner].throws.source == "tracks"
    throws = throws_inputs(upstream["collect"], data_set, number if is_tracked else None)
    return Item(TRAIN.name, TRAIN.version, chain.label, chain.spec, throws, execution)


def _compute(item: Item[MemberSpec], inputs: Inputs) -> Files:
    return _compute_batch([item], [inputs])[0]


def _compute_batch(items: Sequence[Item[MemberSpec]], inputs: Sequence[Inputs]) -> list[Files]:
    """Train networks of one data set, which differ in their numbers alone."""
    from tasks.residual.training import train_members

    spec, members = items[0].spec, [item.spec.member for item in items]
    of_each = [read_transitions(throws_among(own)) for own in inputs]
    choices = spec.network, spec.training
    networks = train_members(of_each, *choices, seed=spec.seed, members=members, physics=spec.physics)
    return [_files(trained, transitions, spec.physics) for trained, transitions in zip(networks, of_each, strict=True)]


def _files(trained: "TrainedMember", transitions: Transitions, physics: Physics) -> Files:
    """Encode a network, its learning curve and its errors."""
    if isinstance(transitions, MeasuredTransitions):
        medium = Ensemble.from_members([trained.arrays()])
        of_throws = whole_throws(medium, transitions[transitions.held_out], physics)
        trained = replace(trained, validation=(*trained.validation, of_throws))
    iteration, training_loss, validation_loss = trained.learning_curve.T
    learning = {
        "iteration": iteration.astype(np.int64),
        "training_loss": training_loss,
        "validation_loss": validation_loss,
    }
    errors = {f.name: np.array([getattr(row, f.name) for row in trained.validation]) for f in fields(ErrorRow)}
    return {
        WEIGHTS: encode_arrays(trained.arrays(), schema=MEMBER_SCHEMA, version=MEMBER_VERSION),
        LEARNING.name: LEARNING.encode(learning),
        ERRORS.name: ERRORS.encode(errors, _ERROR_UNITS),
    }


def _curves(network: Files) -> CurvePoints:
    learning = LEARNING.read([network])
    losses = {name: learning[name] for name in ("training_loss", "validation_loss")}
    return CurvePoints(learning["iteration"].tolist(), losses)


def _summarise_member(network: ChainId, items: Sequence[Files]) -> Summary:
    """Report a member's errors on the throws held out, at the speeds of robots and over all throws."""
    errors = ERRORS.read(items, network.label)
    metrics = {}
    for component in ("vx", "vy", "omega"):
        for band in ("all", "< 0.5"):
            row = np.flatnonzero((errors["component"] == component) & (errors["band"] == band))[0]
            name = f"{component}.{'low_speed' if band != 'all' else 'all'}"
            metrics[f"relative_error.{name}"] = float(errors["relative_error"][row])
            metrics[f"bias.{name}"] = float(errors["bias"][row])
    for row in np.flatnonzero(errors["band"] == WHOLE_THROWS):
        metrics[WHOLE_ERROR] = float(errors["relative_error"][row])
    (files,) = items
    weights = decode_arrays(files[WEIGHTS], schema=MEMBER_SCHEMA, version=MEMBER_VERSION, source=network.label)
    form = form_here(bytes(weights["form"]).decode())
    fitted = zip(form.constants, weights["constants"].tolist(), strict=True) if form and form.constants else ()
    return Summary(metrics=metrics | {f"constant.{name}": value for name, value in fitted})


def _error(metrics: Mapping[str, float]) -> str:
    error = f"{metrics['relative_error.vx.all']:.3f}"
    if WHOLE_ERROR in metrics:
        error += f", {metrics[WHOLE_ERROR]:.2f}"
    elif not math.isnan(slow := metrics["relative_error.vx.low_speed"]):  # else no row is that slow
        error += f", slow {slow:.2f} (bias {metrics['bias.vx.low_speed']:+.4f} m/s)"
    fitted = {name: value for name, value in metrics.items() if name.startswith("constant.")}
    return "; ".join([error, *(f"{name.partition('.')[2]} {value:g}" for name, value in fitted.items())])


def _summarise(settings: Settings, upstream: Upstream, store: Store) -> Summary:
    """Report the error of each member."""
    trained = upstream["train"].done.items()
    members = {chain: _summarise_member(chain, [StoredFiles(store, item)]).metrics for chain, (item,) in trained}
    if not members:
        return Summary([] if settings.needs_ensemble else ["no trial needs residual networks"])
    errors = [f"{chain.label}: {_error(metrics)}" for chain, metrics in members.items()]
    if of_tracked := [metrics[WHOLE_ERROR] for metrics in members.values() if WHOLE_ERROR in metrics]:
        heading = (
            "relative errors on throws held out of fit and training: of vx in a step, of poses where rollouts end:"
        )
        mean = float(np.mean(of_tracked))
        warning = (
            f"networks err by {mean:.2f} of the way, expected at most {MOST_ERROR:g}: robots may go much less far than "
            "predicted, and `puddle fabricate` refuses them. What `collect` warns of may say why"
        )
        return Summary([heading, *errors, *([] if mean <= MOST_ERROR else [warning])], {WHOLE_ERROR: mean})
    return Summary(["relative errors of vx, at all speeds and slow, below 0.5 m/s:", *errors])


TRAIN = Stage(
    name="train",
    version=2,
    unit="iterations",
    reads=lambda settings: ("collect",),
    plan=_plan,
    item=_item,
    compute=_compute,
    compute_batch=_compute_batch,
    summarise=_summarise,
    curves=_curves,
    summarise_trial=_summarise_member,
)
