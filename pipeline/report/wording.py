"""How the page writes numbers, and what it says where there is none."""

from __future__ import annotations

from html import escape

from tasks.analysis import Estimate

NONE = "–"
"""Stands where there is no number."""


def number(value: float) -> str:
    """Write a number to one decimal, with a true minus and no negative zero."""
    return f"{round(value, 1) + 0.0:.1f}".replace("-", "−")


def percent(share: float) -> str:
    """Write a share as whole per cent."""
    return f"{round(100 * share)}\u00a0%".replace("-", "−")


def absent(title: str, reason: str) -> str:
    """Say in the place of a thing why it is not there."""
    return f'<p class="absent"><b>{escape(title)}</b> is not here: {escape(reason)}.</p>'


def p_value(p: float | None) -> str:
    """Write a probability to two digits, and what is very small as a bound."""
    if p is None:
        return NONE
    return "< 0.0001" if p < 1e-4 else f"{p:.2g}"


def interval(found: Estimate, form: str = "{:.1f}") -> str:
    """Write a figure with its 95 % interval under it, or say why there is none; escaped."""
    if found.value is None:
        return f"{NONE}<small>{escape(found.reason or '')}</small>"
    value = _signed(form, found.value)
    if found.low is None or found.high is None:
        return f"{value}<small>{escape(found.reason or '')}</small>"
    return f"{value}<small>{_signed(form, found.low)} to {_signed(form, found.high)}</small>"


def _signed(form: str, value: float) -> str:
    """Write a number with a true minus, and no negative zero."""
    text = form.format(value)
    return text.replace("-", "−") if any(digit in text for digit in "123456789") else text.replace("-", "")
