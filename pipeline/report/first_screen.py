"""The first screen of the page: a sentence of result, bars against the paper, and films with and without residuals."""

from collections.abc import Sequence

from pipeline.report import data
from pipeline.report.data import ALL_DIVERGED, StudyReport, TrialResult
from pipeline.report.downloads import links
from pipeline.report.moving import exemplars, films
from pipeline.report.wording import number, percent
from pipeline.text import escape
from tasks.world import ENVIRONMENTS, EnvironmentName


def first_screen(report: StudyReport) -> str:
    """Write the sentence, the bars and the film; what a study lacks is left out."""
    sentence = f'<p class="finding">{_finding(report.trials)}</p>'
    return f'<div class="first"><div class="said">{sentence}</div>{_bars(report.trials)}{_film(report)}</div>'


def _finding(trials: Sequence[TrialResult]) -> str:
    """Summarise in a sentence how designs transferred at the greatest depth, as far as that is known."""
    if not trials:
        return "No trial has finished yet. This page fills up as the study progresses."
    depth = data.deepest_scored(trials)
    if data.all_diverged(trials):
        return f"There is no champion: {ALL_DIVERGED}."
    if depth is None:
        return "Robots have evolved, but none has been tested in True Slush yet."
    best = data.trial_mean(data.arm(trials, "true_slush", depth), "zero_shot")
    parts = []
    means = _means(trials, depth)
    for environment, found in [
        row for row in means if ENVIRONMENTS[row[0]].networks != "one"
    ] or means:  # the bars show all
        share = data.ratio(found, best) if environment != "true_slush" else None
        of_best = "" if share is None else f" ({percent(share)})"
        evolved = escape(ENVIRONMENTS[environment].evolved)
        parts.append(f"<b>{number(found.mean)}\u00a0m</b>{of_best} if they evolved {evolved}")
    return f"In {depth:g} m of True Slush, zero-shot champions moved on average {', '.join(parts)}."


def _means(trials: Sequence[TrialResult], depth: float) -> list[tuple[EnvironmentName, data.TrialMean]]:
    """Return the zero-shot mean of every environment at a depth that has one."""
    return [
        (environment, found)
        for environment in data.environments(trials)
        if (found := data.trial_mean(data.arm(trials, environment, depth), "zero_shot"))
    ]


def _bars(trials: Sequence[TrialResult]) -> str:
    """Draw a bar for each environment at the greatest depth, with a mark for the paper's mean."""
    depth = data.deepest_scored(trials)
    if depth is None:
        return ""
    rows = [
        (environment, found.mean, data.paper_mean(environment, "zero_shot", depth))
        for environment, found in _means(trials, depth)
    ]
    values = [0.0, *(value for _, mean, stated in rows for value in (mean, stated) if value is not None)]
    low, span = min(values), max(max(values) - min(values), 1e-9)

    def at(value: float) -> float:
        return 100 * (value - low) / span

    drawn = ""
    for environment, mean, stated in rows:
        left, width = at(min(mean, 0.0)), abs(at(mean) - at(0.0))
        mark = "" if stated is None else f'<i class="mark" style="left: {at(stated):.1f}%"></i>'
        paper = "" if stated is None else f" <small>paper {number(stated)}</small>"
        drawn += (
            f"<dt>{escape(ENVIRONMENTS[environment].label)}</dt>"
            f'<dd><span class="track"><i class="{environment}" style="left: {left:.1f}%; width: {width:.1f}%"></i>'
            f"{mark}</span><span>{number(mean)} m{paper}</span></dd>"
        )
    marked = " The marks are the paper’s means." if any(stated is not None for *_, stated in rows) else ""
    return (
        f'<figure class="bars"><dl>{drawn}</dl><figcaption>Zero-shot displacement in {depth:g} m of True Slush, by '
        f"where the robots evolved; means over trials.{marked}</figcaption></figure>"
    )


def _film(report: StudyReport) -> str:
    """Show the best robot with residuals beside the best without, at the greatest depth with either."""
    shown = exemplars(report.replays)
    if not shown:
        return ""
    depth = shown[0].depth
    files = links("replay.mp4", "replay.gif") if depth == max(report.depths) else ""
    robots = "The best robot evolved" if len(shown) == 1 else "The best robots evolved"
    origins = " and ".join(escape(ENVIRONMENTS[replay.environment].evolved) for replay in shown)
    caption = f"{robots} {origins}, in {depth:g} m of True Slush. Click on a robot to open it in the viewer."
    return (
        f'<figure class="hero" id="film-of-both"><div>{films(report.replays, shown)}</div>'
        f"<figcaption>{caption}</figcaption>{files}</figure>"
    )
