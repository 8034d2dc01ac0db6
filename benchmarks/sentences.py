"""Sentences of pages that say what results files say, in figures or in words.

A page holds plain text. A :class:`Sentence` repeats words of it, with {names} where figures stand, which `python -m
benchmarks.published` writes anew. What no figure says, such as "at every depth", is checked.
"""

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
Recorded = Mapping[str, Any]

_FIGURE = r"[−\d][\d.,]*(?: ± [\d.]+)?"


def _no_figures(*_results: Recorded) -> Mapping[str, str]:
    return {}


def _is_true(*_results: Recorded) -> bool:
    return True


@dataclass(frozen=True)
class Sentence:
    """Words of a page that follow from results."""

    words: str  # {name} for a figure; a space stands for any white space
    of: Sequence[str]  # the results files
    figures: Callable[..., Mapping[str, str]] = _no_figures  # of the contents of the results files
    holds: Callable[..., bool] = _is_true  # whether these bear the words out

    @cached_property
    def pattern(self) -> re.Pattern[str]:
        """Matches the words on a page, with a group for each figure."""
        parts = re.split(r"\{(\w+)\}", " ".join(self.words.split()))
        words = [re.escape(part).replace(r"\ ", r"\s+") for part in parts[::2]]
        figures = [*(f"(?P<{name}>{_FIGURE})" for name in parts[1::2]), ""]
        return re.compile("".join(word + figure for word, figure in zip(words, figures, strict=True)))

    @cached_property
    def results(self) -> list[Recorded]:
        """The contents of its results files."""
        return [json.loads((ROOT / name).read_text(encoding="utf-8")) for name in self.of]


def with_figures(text: str, sentences: Sequence[Sentence]) -> str:
    """Write the figures of a page's sentences from the results files."""
    for sentence in sentences:
        if found := sentence.pattern.search(text):
            figures = sentence.figures(*sentence.results)
            for name in sorted(found.groupdict(), key=found.start, reverse=True):
                text = text[: found.start(name)] + figures[name] + text[found.end(name) :]
    return text


def complaints(text: str, sentences: Sequence[Sentence]) -> list[str]:
    """Say which of its sentences a page lacks, and which the results do not bear out."""
    return [
        f'"{sentence.words}" {why}. Write on the page what {" and ".join(sentence.of)} shows, and let the sentence in '
        "benchmarks/page_sentences.py agree."
        for sentence in sentences
        if (why := _complaint(text, sentence))
    ]


def _complaint(text: str, sentence: Sentence) -> str:
    n = len(sentence.pattern.findall(text))
    if n != 1:
        return f"occurs {n} times, expected 1"
    return "" if sentence.holds(*sentence.results) else "no longer follows from the results"


def without_sentences(text: str, sentences: Sequence[Sentence]) -> str:
    """Leave out the sentences that results files stand behind."""
    for sentence in sentences:
        text = sentence.pattern.sub("", text)
    return text
