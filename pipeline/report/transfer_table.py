"""The table of transfer: every arm at every depth, and the paper's numbers where it states them."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from pipeline.config.settings import EnvironmentName
from pipeline.report.data import (
    ENVIRONMENTS,
    PAPER,
    PAPER_DEPTH,
    PAPER_TRUE_SLUSH,
    Estimate,
    Quantity,
    TrialResult,
    arm,
    depths,
    estimate,
    ratio,
)
from pipeline.report.wording import NONE, absent, number, percent


def transfer_table(trials: Sequence[TrialResult]) -> str:
    """Tabulate champions by depth and environment."""
    if not trials:
        return absent("The transfer table", "no trial has finished yet")
    bodies = "".join(_depth_rows(trials, depth) for depth in depths(trials))
    note = (
        "Means over n trials ± 1 SD [m]. The first line is the displacement of the root link; CoM is that of the whole "
        "robot’s centre of mass, which a root at the end of a swinging chain cannot fool. “of <i>E</i>” compares means "
        "with that of the designs evolved in True Slush at the same depth."
    )
    if PAPER_DEPTH in depths(trials):
        note += (
            f" “paper” is the mean over 10 trials that it states at {PAPER_DEPTH:g}\u00a0m; for Residual Slush it "
            f"states shares of {PAPER_TRUE_SLUSH:g}\u00a0m."
        )
    return (
        '<div class="scroll" tabindex="0" role="region" aria-label="Transfer by depth and environment">'
        '<table class="transfer"><thead><tr>'
        "<th>Evolved in</th><th>Predicted<br>where it evolved</th><th>Zero-shot<br>in True Slush</th>"
        "<th>of <i>E</i></th><th>Adapted<br>in True Slush</th><th>of <i>E</i></th></tr></thead>"
        f'{bodies}</table></div><p class="small">{note}</p>'
    )


def _depth_rows(trials: Sequence[TrialResult], depth: float) -> str:
    best = estimate(arm(trials, "true_slush", depth), "zero_shot")
    rows = []
    for environment, style in ENVIRONMENTS.items():
        chosen = arm(trials, environment, depth)
        if not chosen:
            continue
        cells = [
            f'<td><span class="swatch {environment}"></span>{escape(style.label)} <i>{escape(style.symbol)}</i>'
            f"<small>n = {len(chosen)}</small></td>",
            _cell(chosen, "predicted", None, _paper(environment, "predicted", depth)),
            _cell(chosen, "zero_shot", "zero_shot_com", _paper(environment, "zero_shot", depth)),
            _share(chosen, "zero_shot", best, _paper(environment, "zero_shot", depth)),
            _cell(chosen, "adapted", "adapted_com", _paper(environment, "adapted", depth)),
            _share(chosen, "adapted", best, _paper(environment, "adapted", depth)),
        ]
        rows.append(f"<tr>{''.join(cells)}</tr>")
    heading = f'<tr><th colspan="6" scope="rowgroup"><span>Depth {depth:g} m</span></th></tr>'
    return f"<tbody>{heading}{''.join(rows)}</tbody>"


def _paper(environment: EnvironmentName, quantity: Quantity, depth: float) -> float | None:
    return PAPER.get((environment, quantity)) if depth == PAPER_DEPTH else None


def _cell(trials: Sequence[TrialResult], quantity: Quantity, com_quantity: Quantity | None, paper: float | None) -> str:
    found = estimate(trials, quantity)
    com = estimate(trials, com_quantity) if com_quantity else None
    lines = _spread(found)
    if found is not None and found.n < len(trials):
        lines += f"<small>{found.n} of {len(trials)} trials</small>"
    if com is not None:
        lines += f"<small>CoM {_spread(com)}</small>"
    if paper is not None:
        lines += f'<small class="paper">paper {number(paper)}</small>'
    return f"<td>{lines}</td>"


def _share(trials: Sequence[TrialResult], quantity: Quantity, best: Estimate | None, paper: float | None) -> str:
    share = ratio(estimate(trials, quantity), best)
    lines = NONE if share is None else percent(share)
    if paper is not None:
        lines += f'<small class="paper">paper {percent(paper / PAPER_TRUE_SLUSH)}</small>'
    return f"<td>{lines}</td>"


def _spread(found: Estimate | None) -> str:
    if found is None:
        return NONE
    return number(found.mean) + (f" ± {number(found.sd)}" if found.sd is not None else "")
