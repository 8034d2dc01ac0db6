"""The tables of transfer: every arm at every depth beside the paper's numbers, and the variance between replicates."""

from collections.abc import Sequence

from pipeline.report.data import Measure, TrialMean, TrialResult, arm, arm_words, depths, paper_mean, ratio, trial_mean
from pipeline.report.downloads import links
from pipeline.report.findings import Findings
from pipeline.report.wording import NONE, absent, number, percent, scrolling, table
from pipeline.text import escape
from tasks.analysis import paper
from tasks.analysis.scores import QUANTITY_WORDS
from tasks.analysis.variance_split import VarianceRow
from tasks.evolution import OBJECTIVES, PAPERS_OBJECTIVE, Objective
from tasks.world import ENVIRONMENTS, EnvironmentName


def transfer_table(trials: Sequence[TrialResult], findings: Findings) -> str:
    """Tabulate the champions' displacement by depth and environment."""
    if not trials:
        return absent("The transfer table", "no trial has finished yet")
    objective = OBJECTIVES[findings.objective]
    maximised = "μ − kσ"
    if objective.name != PAPERS_OBJECTIVE:
        maximised += f" of the {escape(findings.selected_for)} [{escape(objective.unit)}], the fitness"
    bodies = "".join(_depth_rows(trials, depth, objective) for depth in depths(trials))
    note = (
        "Displacement [m]: mean over n trials ± 1 SD. The first line of a cell is the displacement of the root link. "
        "CoM is the displacement of the robot’s centre of mass, to which a swing of the root adds little. In an "
        "ensemble, the prediction is the mean μ over the members; σ is their standard deviation, and evolution "
        f"maximises {maximised}. “of <i>E</i>” is the mean divided by that of the designs evolved in True Slush at the "
        "same depth, as they are, which is the paper’s reference. Below it (“adapted”), the mean is divided by theirs "
        "after adaptation: adapted designs had a second search, so only the adapted ones of both compare equals."
    )
    best = paper_mean("true_slush", "zero_shot", paper.DEPTH)
    if paper.DEPTH in depths(trials) and best is not None:
        note += (
            f" “Paper” is the paper’s mean over {paper.N_TRIALS} trials at {paper.DEPTH:g}\u00a0m; for Residual Slush "
            f"it gives shares of {best:g}\u00a0m."
        )
    content = (
        '<table class="transfer"><thead><tr>'
        "<th>Evolved in</th><th>Predicted<br>where it evolved</th><th>Zero-shot<br>in True Slush</th>"
        "<th>of <i>E</i></th><th>Adapted<br>in True Slush</th><th>of <i>E</i></th></tr></thead>"
        f"{bodies}</table>"
    )
    whole = scrolling(content, "Transfer by depth and environment")
    return f'{whole}{links("transfer.csv")}<p class="small">{note}</p>'


def _depth_rows(trials: Sequence[TrialResult], depth: float, objective: Objective) -> str:
    of_true_slush = arm(trials, "true_slush", depth)
    best = trial_mean(of_true_slush, "zero_shot"), trial_mean(of_true_slush, "adapted")
    rows = []
    for environment, style in ENVIRONMENTS.items():
        chosen = arm(trials, environment, depth)
        if not chosen:
            continue
        cells = [
            f'<td><span class="swatch {environment}"></span>{escape(style.label)} <i>{escape(style.symbol)}</i>'
            f"<small>n = {len(chosen)}</small></td>",
            _cell(chosen, environment, "predicted", None, depth, objective),
            _cell(chosen, environment, "zero_shot", "zero_shot_com", depth, objective),
            _share(chosen, environment, "zero_shot", best, depth),
            _cell(chosen, environment, "adapted", "adapted_com", depth, objective),
            _share(chosen, environment, "adapted", best, depth),
        ]
        rows.append(f"<tr>{''.join(cells)}</tr>")
    heading = f'<tr><th colspan="6" scope="rowgroup"><span>Depth {depth:g} m</span></th></tr>'
    return f"<tbody>{heading}{''.join(rows)}</tbody>"


def _cell(
    trials: Sequence[TrialResult],
    environment: EnvironmentName,
    measure: Measure,
    com: Measure | None,
    depth: float,
    objective: Objective,
) -> str:
    found = trial_mean(trials, measure)
    lines = _spread(found)
    if found is not None and len(found.values) < len(trials):
        lines += f"<small>{len(found.values)} of {len(trials)} trials</small>"
    if com is not None and (found_com := trial_mean(trials, com)):
        lines += f"<small>CoM {_spread(found_com)}</small>"
    if measure == "predicted":
        lines += members_line(trials, objective)
    if (stated := paper_mean(environment, measure, depth)) is not None:
        lines += f'<small class="paper">paper {number(stated)}</small>'
    return f"<td>{lines}</td>"


def members_line(trials: Sequence[TrialResult], objective: Objective) -> str:
    """Return the means of σ over members and of the fitness as a line of a cell; empty for arms without an ensemble."""
    sd, own = trial_mean(trials, "predicted_sd"), trial_mean(trials, "fitness")
    if sd is None or own is None:
        return ""
    fitness = "μ − kσ" if objective.name == PAPERS_OBJECTIVE else f"fitness [{objective.unit}]"
    return f"<small>σ {number(sd.mean)}, {fitness} {number(own.mean)}</small>"


def _share(
    trials: Sequence[TrialResult],
    environment: EnvironmentName,
    measure: Measure,
    best: tuple[TrialMean | None, TrialMean | None],
    depth: float,
) -> str:
    share, of_adapted = (ratio(trial_mean(trials, measure), reference) for reference in best)
    lines = NONE if share is None else percent(share)
    if of_adapted is not None:
        lines += f"<small>adapted\u00a0{percent(of_adapted)}</small>"
    stated, whole = (
        paper_mean(name, what, depth) for name, what in ((environment, measure), ("true_slush", "zero_shot"))
    )
    if stated is not None and whole is not None:
        lines += f'<small class="paper">paper {percent(stated / whole)}</small>'
    return f"<td>{lines}</td>"


def _spread(found: TrialMean | None) -> str:
    if found is None:
        return NONE
    return number(found.mean) + (f" ± {number(found.sd)}" if found.sd is not None else "")


def variance_table(findings: Findings) -> str:
    """Tabulate the deviations between and within replicates; nothing where no arm has several."""
    by_arm: dict[tuple[EnvironmentName, float], dict[str, VarianceRow]] = {}
    for row in findings.replicated:
        by_arm.setdefault((row.evolved_in, row.depth), {})[row.quantity] = row
    if not by_arm:
        return ""
    columns = ("Evolved in", "Predicted [m]", "Zero-shot [m]", "Adapted [m]")
    rows = []
    for arm_of, of_quantity in sorted(by_arm.items(), key=lambda entry: -entry[0][1]):
        largest = max(of_quantity.values(), key=lambda row: row.n)
        head = f"{escape(arm_words(*arm_of))}<small>n = {largest.n} in {largest.n_replicates} replicates</small>"
        cells = (_deviations(of_quantity.get(name)) for name in QUANTITY_WORDS)
        rows.append([head, *cells])
    title = "Variance between and within replicates"
    note = (
        "Standard deviation between and within replicates, and the share of the variance that lies between them, with "
        "its 95 % interval (F test). Replicates differ in their throws and in the training of their networks; both "
        "change together, so this study can’t tell one from the other. Trials of one replicate differ in their "
        "evolution, and single members in the training of their networks too. Robots of True Slush and Dry Land "
        "depend on no replicate. With few replicates the share is hardly known."
    )
    content = table(columns, rows, title, kind="named") + links("variance.csv")
    return f'<div id="variance"><h3>{title}</h3>{content}<p class="small">{note}</p></div>'


def _deviations(row: VarianceRow | None) -> str:
    if row is None:
        return NONE
    share = row.share_between
    if row.sd_between is None or row.sd_within is None:
        return f"{NONE}<small>{escape(share.reason or '')}</small>"
    deviations = f"{number(row.sd_between)} between, {number(row.sd_within)} within"
    if share.value is None or share.low is None or share.high is None:
        return f"{deviations}<small>{escape(share.reason or '')}</small>"
    return f"{deviations}<small>{percent(share.value)} between ({percent(share.low)} to {percent(share.high)})</small>"
