"""How the page writes numbers, tables, and what is missing. All of it returns HTML; text from a study is escaped."""

from collections.abc import Iterable, Sequence

from pipeline.text import escape
from tasks.analysis.uncertainty import Estimate

NONE = "–"  # stands where there is no number


def signed(form: str, value: float) -> str:
    """Format a number with a true minus sign and without negative zero."""
    text = form.format(value)
    return text.replace("-", "−" if any(digit in text for digit in "123456789") else "")


def number(value: float | None) -> str:
    """Write a number to one decimal; a dash where it is missing."""
    return NONE if value is None else signed("{:.1f}", value)


def percent(share: float) -> str:
    """Write a share in whole per cent."""
    return signed("{:.0f}\u00a0%", 100 * share)


def p_value(p: float | None) -> str:
    """Write a probability to two digits, and a very small one as a bound."""
    if p is None:
        return NONE
    return "< 0.0001" if p < 1e-4 else f"{p:.2g}"


def interval(found: Estimate, form: str = "{:.1f}") -> str:
    """Write an estimate with its 95 % interval below it, or with the reason why that is missing."""
    value = NONE if found.value is None else signed(form, found.value)
    if found.value is None or found.low is None or found.high is None:
        return f"{value}<small>{escape(found.reason or '')}</small>"
    return f"{value}<small>{signed(form, found.low)} to {signed(form, found.high)}</small>"


def absent(title: str, reason: str) -> str:
    """State in the place of a figure or table why it is missing."""
    return f'<p class="absent"><b>{escape(title)}</b>: not available, because {escape(reason)}.</p>'


def table(columns: Sequence[str], rows: Iterable[Sequence[str]], label: str, *, kind: str) -> str:
    """Return cells laid out as a table that scrolls sideways on a narrow page.

    Args:
        columns: headings, HTML.
        rows: cells of each row, HTML.
        label: name of the table for screen readers.
        kind: its CSS class.
    """
    head = "".join(f"<th>{column}</th>" for column in columns)
    # Each cell carries the name of its column, because wordy rows become cards on a narrow page.
    body = "".join(
        "<tr>"
        + "".join(f'<td data-column="{name}">{cell}</td>' for name, cell in zip(columns, row, strict=True))
        + "</tr>"
        for row in rows
    )
    return scrolling(f'<table class="{kind}"><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>', label)


def scrolling(content: str, label: str) -> str:
    """Put a table into a region that scrolls sideways and can be reached with the keyboard."""
    return f'<div class="scroll" tabindex="0" role="region" aria-label="{escape(label)}">{content}</div>'


def folded(summary: str, content: str, *, attributes: str = "") -> str:
    """Return content hidden behind a summary that opens it.

    Args:
        summary: HTML that is always visible.
        content: HTML that is hidden at first.
        attributes: HTML attributes of the element.
    """
    return f"<details{attributes}><summary>{summary}</summary>{content}</details>"
