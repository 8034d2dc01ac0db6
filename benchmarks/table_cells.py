"""Figures in the cells of tables in Markdown."""

from collections.abc import Mapping


def figure(value: float | list[float]) -> str:
    """Write a figure with two decimals, or a range of figures."""
    return " to ".join(signed(f"{number:.2f}") for number in (value if isinstance(value, list) else [value]))


def mean(of: Mapping[str, float] | None) -> str:
    """Write a mean and its standard deviation, where there are any."""
    return "" if of is None else signed(f"{of['mean']:z.1f}") + (f" ± {of['sd']:.1f}" if of["sd"] is not None else "")


def share(of: Mapping[str, float] | None, best: Mapping[str, float] | None) -> str:
    """Write one mean as a share of another, if both exist and the other is positive."""
    if of is None or best is None or best["mean"] <= 0:
        return ""
    return signed(f"{of['mean'] / best['mean']:z.0%}").replace("%", " %")


def signed(text: str) -> str:
    """Write minus signs instead of hyphens."""
    return text.replace("-", "−")
