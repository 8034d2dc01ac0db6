"""The page of `puddle sensitivity`, in Markdown, written from its result alone."""

import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import TypeAdapter

from pipeline.report.wording import NONE, p_value, signed
from tasks.analysis.comparison import Group
from tasks.analysis.equivalence import MOST_TRIALS, Verdict
from tasks.analysis.paper import NEGLIGIBLE_WORDS
from tasks.analysis.scores import QUANTITY_WORDS, Quantity
from tasks.analysis.uncertainty import LEVEL
from tasks.analysis.variant_effects import Effect, effects

FIRST_LINE = "<!-- written by puddle sensitivity; the result is in the .json file beside it -->"
WIDTH = 128

_VERDICTS: Mapping[str, str] = {
    "agrees": "negligible",
    "differs": "matters",
    "some": "a difference",
    "cannot tell": "cannot tell",
    "not comparable": "not comparable",
}


@dataclass(frozen=True)
class SensitivityRow:
    """A variant, and what it is compared with."""

    name: str
    decided: str
    instead: str
    setting: str
    environment: str
    score: Quantity  # zero_shot or adapted
    study: str
    digest: str
    displacement: tuple[float | None, ...]  # of each trial's champion [m]
    base: tuple[float | None, ...]  # the same in the base


@dataclass(frozen=True)
class Sensitivity:
    """The result of `puddle sensitivity`."""

    command: str
    source: str  # where the base's settings come from, such as "preset row-small"
    scale: str  # of the evolution, in words
    depth: float  # [m]
    n_pilot: int  # trials of the base that the deviation was estimated from
    n_trials: int  # trials of each study
    n_to_show: int | None  # trials that would show what is just not negligible; None above 100,000
    power: float
    base_study: str
    base_digest: str
    provenance: Mapping[str, str]
    left_out: tuple[str, ...]  # variants that do not apply, with the reasons
    rows: tuple[SensitivityRow, ...]

    def effects(self) -> list[tuple[SensitivityRow, Effect]]:
        """Return the effect of each variant."""
        pairs = [
            (np.array(row.displacement, dtype=np.float64), np.array(row.base, dtype=np.float64)) for row in self.rows
        ]
        return list(zip(self.rows, effects(pairs), strict=True))


SENSITIVITY: TypeAdapter[Sensitivity] = TypeAdapter(Sensitivity)
"""The result as JSON."""


def sensitivity_lines(found: Sensitivity) -> Iterator[str]:
    """Describe a result in lines of 80 columns: the base, and a row for each variant."""
    yield f"{'[m]':<21} {'n':>3} {'variant':>12} {'base':>12} {'difference':>20} {'p':>7}"
    for row, effect in found.effects():
        p = p_value(effect.student_holm).replace(" ", "")
        means = f"{effect.variant.n:>3} {_spread(effect.variant):>12} {_spread(effect.base):>12}"
        yield f"{row.name:<21} {means} {_interval(effect):>20} {p:>7}"
        yield f"    {verdict_words(effect)}"
    yield ""
    yield from textwrap.wrap(_definitions(found), 80)


def sensitivity_page(found: Sensitivity) -> str:
    """Return the whole page."""
    return "\n".join(_page(found)) + "\n"


def verdict_words(effect: Effect) -> str:
    """Write a verdict, with the number of trials that would tell where these do not."""
    n = effect.judgement.n_needed
    needs = "" if n is None else f" (more than {MOST_TRIALS:,} trials)" if n > MOST_TRIALS else f" ({n:g} trials)"
    return f"{_VERDICTS[_verdict(effect)]}{needs}"


def _verdict(effect: Effect) -> Verdict | Literal["some"]:
    """Return the verdict, or "some" where there is a difference and these trials cannot tell whether it matters."""
    p, verdict = effect.student_holm, effect.judgement.verdict
    return "some" if verdict == "cannot tell" and p is not None and p < 1 - LEVEL else verdict


def _page(found: Sensitivity) -> Iterator[str]:
    yield FIRST_LINE
    yield ""
    yield "# What changes when the paper's open choices are decided differently"
    yield ""
    yield from _wrapped(
        f"The paper leaves choices open that a simulator has to make. Each is a setting, and each was varied "
        f"alone, beside {found.source}: {found.scale}, in {found.depth:g} m of slush. Displacement of the champions "
        f"in True Slush [m], mean ± sample standard deviation over n trials; base and variants have the same seed."
    )
    yield ""
    yield from _table(found)
    yield ""
    yield from _conclusions(found)
    yield ""
    yield "## How to read it"
    yield ""
    yield from _wrapped(_definitions(found))
    yield ""
    yield from _wrapped(_trials(found))
    if found.left_out:
        yield ""
        yield "Not tried, because it does not apply:"
        yield ""
        yield from (f"- {line}" for line in found.left_out)
    yield ""
    yield "## Studies and digests"
    yield ""
    versions = found.provenance
    yield from _wrapped(
        f"Computed at commit {versions['commit']} on {versions['cpu']}, Python {versions['python']}, numba "
        f"{versions['numba']}. Each variant is an ordinary study of the store. A digest is the SHA-256 of the digests "
        f"of a study's items, of evolution and transfer."
    )
    yield ""
    yield "| study | setting | digest |"
    yield "|---|---|---|"
    yield f"| {found.base_study} | | `{found.base_digest}` |"
    yield from (f"| {row.study} | `{row.setting}` | `{row.digest}` |" for row in found.rows)
    yield ""
    yield "To repeat it:"
    yield ""
    yield from ("```", found.command, "```")


def _table(found: Sensitivity) -> Iterator[str]:
    yield "| variant | decided | instead | score | n | base | variant | difference (95 %) | p (Holm) | verdict |"
    yield "|---|---|---|---|--:|--:|--:|--:|--:|---|"
    for row, effect in found.effects():
        home = "" if row.environment == "true_slush" else f", from {row.environment}"
        cells = (
            row.name,
            row.decided,
            row.instead,
            f"{QUANTITY_WORDS[row.score]}{home}",
            f"{effect.variant.n}" if effect.variant.n == effect.base.n else f"{effect.variant.n}, {effect.base.n}",
            _spread(effect.base),
            _spread(effect.variant),
            _interval(effect),
            p_value(effect.student_holm),
            verdict_words(effect),
        )
        yield f"| {' | '.join(cells)} |"


def _conclusions(found: Sensitivity) -> Iterator[str]:
    for verdict, opening in (
        ("differs", "Shown to matter"),
        ("some", "Shown to make a difference, which may be negligible"),
        ("agrees", "Shown to be negligible"),
        ("cannot tell", "Not shown to make a difference, nor that it is negligible"),
    ):
        names = [row.name for row, effect in found.effects() if _verdict(effect) == verdict]
        if names:
            yield from _wrapped(f"- {opening}: {', '.join(names)}.", "  ")


def _definitions(found: Sensitivity) -> str:
    bounds = {f"{QUANTITY_WORDS[row.score]} ± {effect.bound:.1f} m" for row, effect in found.effects()}
    return (
        f"Differences are variant minus base, with the 95 % interval of Student's t test; p is that test's after "
        f"Holm's correction over the {len(found.rows)} variants. A variant is negligible if the interval lies within "
        f"{NEGLIGIBLE_WORDS} of the base's mean ({', '.join(sorted(bounds))}), and matters if it lies outside. "
        f"Otherwise these trials cannot tell, except that there is a difference where p is below 0.05; in brackets, "
        f"how many trials of each study would."
    )


def _trials(found: Sensitivity) -> str:
    need = "more than 100,000" if found.n_to_show is None else f"{found.n_to_show:,}"
    given = "Each study has as many." if found.n_to_show == found.n_trials else f"Each study has {found.n_trials}."
    return (
        f"{found.n_pilot} trials of the base gave its deviation. From that, {need} trials of each study show a "
        f"difference that is just not negligible with a probability of {found.power:.0%}, at the level that Holm's "
        f"correction asks of the smallest p. {given} One choice was changed at a time, so effects that add up are not "
        f"excluded."
    )


def _wrapped(text: str, indent: str = "") -> Iterator[str]:
    # A hyphen may be part of a study's name.
    yield from textwrap.wrap(text, WIDTH, break_on_hyphens=False, subsequent_indent=indent)


def _spread(group: Group) -> str:
    if group.mean.value is None:
        return NONE
    mean = signed("{:.1f}", group.mean.value)
    return mean if group.sd is None else f"{mean} ± {group.sd:.1f}"


def _interval(effect: Effect) -> str:
    gap = effect.difference
    if gap.value is None:
        return NONE
    if gap.low is None or gap.high is None:
        return signed("{:.1f}", gap.value)
    return f"{signed('{:.1f}', gap.value)} ({signed('{:.1f}', gap.low)} to {signed('{:.1f}', gap.high)})"
