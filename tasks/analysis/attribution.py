"""Attribution of the transfer gap to controller and body. Paper, "Evolution" and Fig. 4.

Champions are tested in True Slush as they are (zero-shot) and with a controller that evolved there (adapted). Designs
that evolved in True Slush mark the best possible displacement. So the gap has two parts:

    best - zero_shot  =  (adapted - zero_shot)  +  (best - adapted)
      the gap             lost to the controller     lost to the body

Adapted designs were searched longer than zero-shot ones: their bodies for one evolution and their controllers for
another. So the paper's share, adapted / best, favours them. Against designs of True Slush that were adapted too
(best_adapted), both sides are equally searched; every share is given against both.

A part can be negative: adaptation from scratch may find a worse controller than the design's own, and the body's part
is then too large by the same amount. Shares exist only where there is a gap.

Of means and differences, intervals are Student's and of shares and ratios the bootstrap's. Where trials are of several
replicates, all of them include the variance between these (:mod:`tasks.analysis.replicates`), and those of shares and
ratios are by the delta method.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from numpy.random import Generator

from tasks.analysis.comparison import nested_difference, nested_ratio
from tasks.analysis.replicates import NestedSample, mean_of, nested, nested_sample, ratio_of_sums, sum_of_means
from tasks.analysis.scores import QUANTITY_WORDS, EvolvedIn, Scores
from tasks.analysis.uncertainty import Estimate, bootstrap, finite
from tasks.arrays import Float64, Floats, Int64
from tasks.world import ENVIRONMENTS

_NO_GAP = "there is no gap to take shares of"


@dataclass(frozen=True)
class Attribution:
    """The transfer gap of one arm at one depth: means over trials [m], and shares."""

    evolved_in: EvolvedIn
    depth: float  # [m]
    n: int  # trials with a finite zero-shot and adapted displacement, from which the split is computed
    n_best: int  # trials in True Slush
    predicted: Estimate
    zero_shot: Estimate
    adapted: Estimate
    best: Estimate  # zero-shot displacement of the designs evolved in True Slush
    best_adapted: Estimate  # of the same bodies with adapted controllers
    hallucinated: Estimate  # predicted - zero_shot: displacement that exists only where the champion evolved
    gap: Estimate  # best - zero_shot
    lost_to_controller: Estimate
    lost_to_body: Estimate
    lost_to_body_equally_searched: Estimate  # best_adapted - adapted
    controller_share: Estimate  # lost_to_controller / gap
    body_share: Estimate  # lost_to_body / gap
    recovered_zero_shot: Estimate  # zero_shot / best: the paper's 67 %
    recovered_adapted: Estimate  # adapted / best: the paper's 87 %
    recovered_zero_shot_of_adapted: Estimate  # zero_shot / best_adapted
    recovered_adapted_equally_searched: Estimate  # adapted / best_adapted
    recovered_of_dry_land: Estimate  # (zero_shot - Dry Land's) / (best - Dry Land's): share of its gap that is closed


def attribute(scores: Scores, *, rng: Generator) -> tuple[Attribution, ...]:
    """Split the transfer gap of every arm except True Slush, at each depth."""
    return tuple(
        _attribution(scores, arm, depth, rng)
        for arm in ENVIRONMENTS
        if arm != "true_slush"
        for depth in scores.depths()
        if len(scores.rows(arm, depth))
    )


def _attribution(scores: Scores, arm: EvolvedIn, depth: float, rng: Generator) -> Attribution:
    predicted, zero_shot, adapted = (scores.values(arm, quantity, depth) for quantity in QUANTITY_WORDS)
    replicate = scores.replicate[scores.rows(arm, depth)]
    best, best_adapted = (scores.sample("true_slush", quantity, depth) for quantity in ("zero_shot", "adapted"))
    both = np.isfinite(zero_shot) & np.isfinite(adapted)
    Z, A = (NestedSample(values[both], replicate[both]) for values in (zero_shot, adapted))
    gap, controller, body, controller_share, body_share = _split(Z, A, best, rng)
    of_zero_shot, of_adapted = (nested_sample(values, replicate) for values in (zero_shot, adapted))
    return Attribution(
        evolved_in=arm,
        depth=depth,
        n=int(both.sum()),
        n_best=len(best.values),
        predicted=mean_of(nested_sample(predicted, replicate)),
        zero_shot=mean_of(of_zero_shot),
        adapted=mean_of(of_adapted),
        best=mean_of(best),
        best_adapted=mean_of(best_adapted),
        hallucinated=mean_of(nested_sample(predicted - zero_shot, replicate)),
        gap=gap,
        lost_to_controller=controller,
        lost_to_body=body,
        lost_to_body_equally_searched=nested_difference(best_adapted, of_adapted),
        controller_share=controller_share,
        body_share=body_share,
        recovered_zero_shot=nested_ratio(of_zero_shot, best, rng=rng),
        recovered_adapted=nested_ratio(of_adapted, best, rng=rng),
        recovered_zero_shot_of_adapted=nested_ratio(of_zero_shot, best_adapted, rng=rng),
        recovered_adapted_equally_searched=nested_ratio(of_adapted, best_adapted, rng=rng),
        recovered_of_dry_land=_undone(arm, of_zero_shot, best, scores.sample("dry_land", "zero_shot", depth), rng),
    )


def _split(Z: NestedSample, A: NestedSample, B: NestedSample, rng: Generator) -> tuple[Estimate, ...]:
    """Estimate the gap, its two parts and their shares, from zero-shot, adapted (of the same trials) and best."""
    n, n_best = len(Z.values), len(B.values)
    if n == 0 or n_best == 0:
        reason = f"{n} trials scored zero-shot and adapted and {n_best} in True Slush, expected 1 or more"
        return (Estimate.missing(reason),) * 5
    if nested(Z, B):
        controller = replace(Z, values=A.values - Z.values)
        gap, body = (B, Z.scaled(-1)), (B, A.scaled(-1))
        shares = (
            ratio_of_sums(*zip(part, gap, strict=True), undefined=_NO_GAP) for part in ((B.scaled(0), controller), body)
        )
        return (sum_of_means(*gap), sum_of_means(controller), sum_of_means(*body), *shares)
    pairs = np.stack((Z.values, A.values), axis=-1)  # resampling draws a trial's two scores together
    return bootstrap(_gap_and_parts, pairs, B.values[:, None], rng=rng, undefined=_NO_GAP)


def _gap_and_parts(arm: Float64, E: Float64) -> Float64:
    Z, A, B = np.broadcast_arrays(arm[..., 0], arm[..., 1], E[..., 0])
    gap = np.where(B > Z, B - Z, np.nan)
    return np.stack((B - Z, A - Z, B - A, (A - Z) / gap, (B - A) / gap), axis=-1)


def _undone(
    arm: EvolvedIn, zero_shot: NestedSample, best: NestedSample, dry_land: NestedSample, rng: Generator
) -> Estimate:
    """Estimate the share of Dry Land's gap that an arm closes, from three independent groups."""
    if arm == "dry_land":
        return Estimate.missing("it is the reference")
    groups = {"zero-shot": zero_shot, "True Slush": best, "Dry Land zero-shot": dry_land}
    lacking = [name for name, sample in groups.items() if len(sample.values) == 0]
    if lacking:
        return Estimate.missing("no finite score of: " + ", ".join(lacking))
    if nested(*groups.values()):
        none, less = best.scaled(0), dry_land.scaled(-1)
        return ratio_of_sums((zero_shot, zero_shot.scaled(0)), (none, best), (less, less), undefined=_NO_GAP)
    columns = (sample.values[:, None] for sample in groups.values())
    return bootstrap(_share_of_gap, *columns, rng=rng, undefined=_NO_GAP)[0]


def _share_of_gap(arm: Float64, E: Float64, dry: Float64) -> Float64:
    return np.where(dry < E, (arm - dry) / np.where(dry < E, E - dry, 1), np.nan)


@dataclass(frozen=True, eq=False)
class TransferMatrix:
    """Displacement of champions by the depth where they evolved (rows) and the depth of the test (columns)."""

    trained: Float64  # (n_trained,) depths [m]
    tested: Float64  # (n_tested,) depths [m]
    mean: Float64  # (n_trained, n_tested) displacement [m]; NaN where n is 0
    sd: Float64  # (n_trained, n_tested) sample deviation [m]; NaN where n is below 2
    n: Int64  # (n_trained, n_tested) number of champions with a finite displacement
    relative: Float64
    """(n_trained, n_tested) mean / mean of the champions that evolved at the tested depth; NaN where these do not exist
    or do not advance."""


def transfer_matrix(trained: npt.ArrayLike, tested: npt.ArrayLike, displacement: Floats) -> TransferMatrix:
    """Return the matrix of a table of tests.

    Args:
        trained: (n_tests,) depth where the champion evolved [m].
        tested: (n_tests,) depth of the test [m].
        displacement: (n_tests,) [m]; NaN where diverged.
    """
    rows, row = np.unique(np.asarray(trained, dtype=np.float64), return_inverse=True)
    columns, column = np.unique(np.asarray(tested, dtype=np.float64), return_inverse=True)
    shape = (len(rows), len(columns))
    average, sd, relative = (np.full(shape, np.nan) for _ in range(3))
    n = np.zeros(shape, np.int64)
    for i, j in np.ndindex(shape):
        known = finite(np.asarray(displacement)[(row == i) & (column == j)])
        n[i, j] = len(known)
        average[i, j] = known.mean() if len(known) else np.nan
        sd[i, j] = known.std(ddof=1) if len(known) > 1 else np.nan
    for j, depth in enumerate(columns):
        native = average[rows == depth, j]
        if len(native) and native[0] > 0:
            relative[:, j] = average[:, j] / native[0]
    return TransferMatrix(rows, columns, average, sd, n, relative)
