"""The table of transfer in LaTeX, which a paper reads with the command input."""

import unicodedata
from collections.abc import Sequence

from pipeline.report.data import Measure, TrialResult, arm, depths, ratio, trial_mean
from tasks.world import ENVIRONMENTS

_NONE = "--"
_SPECIAL = {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
_SPECIAL |= {character: f"\\{character}" for character in "&%$#_{}"}
_SUBSCRIPTS = {"\N{LATIN SUBSCRIPT SMALL LETTER A}": "a"}
_ACCENTS = {
    "\N{COMBINING CIRCUMFLEX ACCENT}": r"\hat",
    "\N{COMBINING TILDE}": r"\tilde",
    "\N{COMBINING MACRON}": r"\bar",
    "\N{COMBINING RIGHT ARROW ABOVE}": r"\vec",
}
_HEAD = r"""% Transfer results of study {name}. Needs \usepackage{{booktabs}}.
% Displacement of the root link [m], mean over n trials +- sample standard deviation. "% of E": the mean divided by the
% zero-shot mean of the designs evolved in True Slush at the same depth / by their adapted mean.
% Predicted: where the design evolved; in an ensemble mu is the mean over its members, sigma their standard deviation.
% Fitness: what evolution maximised in an ensemble, which is mu - k sigma of the objective.
% Designs and adapted controllers were selected for: {selected_for}.
\begin{{tabular}}{{@{{}}l*{{8}}{{@{{\hspace{{8pt}}}}r}}@{{}}}}
\toprule
evolved in & $n$ & predicted $\mu$ & $\sigma$ & fitness & zero-shot & \% of $E$ & adapted & \% of $E$ \\
"""


def transfer_latex(name: str, trials: Sequence[TrialResult], *, selected_for: str) -> str:
    """Tabulate the champions' displacement by depth and environment, as a ``tabular``.

    Args:
        name: name of the study.
        trials: its trials.
        selected_for: the objective, in words.

    Returns:
        LaTeX code.
    """
    lines = [_HEAD.format(name=name, selected_for=selected_for)]
    for depth in depths(trials):
        lines.append(f"\\midrule\n\\multicolumn{{9}}{{@{{}}l}}{{\\textit{{{depth:g}\\,m deep}}}} \\\\\n")
        of_true_slush = arm(trials, "true_slush", depth)
        best = [trial_mean(of_true_slush, measure) for measure in _TRANSFERRED]
        for environment, style in ENVIRONMENTS.items():
            chosen = arm(trials, environment, depth)
            if not chosen:
                continue
            zero_shot, adapted = (
                _shares([ratio(trial_mean(chosen, measure), reference) for reference in best])
                for measure in _TRANSFERRED
            )
            cells = (
                f"{_text(style.label)} {_symbol(style.symbol)}",
                str(len(chosen)),
                _mean(chosen, "predicted"),
                *(_plain_mean(chosen, measure) for measure in _OF_MEMBERS),
                _mean(chosen, "zero_shot"),
                zero_shot,
                _mean(chosen, "adapted"),
                adapted,
            )
            lines.append(f"{' & '.join(cells)} \\\\\n")
    return "".join([*lines, "\\bottomrule\n\\end{tabular}\n"])


_OF_MEMBERS: tuple[Measure, Measure] = ("predicted_sd", "fitness")
_TRANSFERRED: tuple[Measure, Measure] = ("zero_shot", "adapted")


def _mean(trials: Sequence[TrialResult], measure: Measure) -> str:
    found = trial_mean(trials, measure)
    if found is None:
        return _NONE
    return f"${found.mean:z.1f}" + (rf"\,{{\pm}}\,{found.sd:.1f}$" if found.sd is not None else "$")


def _plain_mean(trials: Sequence[TrialResult], measure: Measure) -> str:
    """Write a mean that only ensembles have."""
    found = trial_mean(trials, measure)
    return _NONE if found is None or trial_mean(trials, "predicted_sd") is None else f"${found.mean:z.1f}$"


def _shares(shares: Sequence[float | None]) -> str:
    known = [f"${100 * share:z.0f}$" for share in shares if share is not None]
    return "/".join(known) or _NONE


def _text(words: str) -> str:
    return "".join(_SPECIAL.get(character, character) for character in words)


def _symbol(symbol: str) -> str:
    """Write a symbol of the paper, such as Ê₁ or E′, in mathematics."""
    written = ""
    for character in unicodedata.normalize("NFD", symbol):
        digit = unicodedata.digit(character, None)
        if character in _ACCENTS:
            written = f"{written[:-1]}{_ACCENTS[character]}{{{written[-1:]}}}"
        elif character == "′":
            written += "'"
        elif character in _SUBSCRIPTS:
            written += f"_{{{_SUBSCRIPTS[character]}}}"
        elif digit is not None and not character.isascii():
            written += f"_{{{digit}}}"
        else:
            written += _text(character)
    return f"${written}$"
