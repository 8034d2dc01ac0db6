"""Colours and markers of arms: one arm looks the same in every figure, on every page and in every film of a study."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import cycle

from tasks.world import in_order


@dataclass(frozen=True)
class Look:
    """How an arm is drawn."""

    marker: str  # Matplotlib marker, so that colour is never the only difference
    color: str
    adapted: str  # once its controllers have adapted to True Slush
    dark: str  # on a dark page
    dark_adapted: str


LOOKS: Mapping[str, Look] = {
    "true_slush": Look("o", "#1c6fb8", "#a6cbe8", "#4d9de0", "#27527a"),
    "dry_land": Look("s", "#1d6b3c", "#9ed3a9", "#4fae73", "#26583a"),
    "residual_slush": Look("^", "#dd7700", "#fbcb8f", "#f39a37", "#7c4a12"),
    "single_member": Look("D", "#7d4aa5", "#cfb6e2", "#b58bdb", "#573577"),
    "designed_throws": Look("v", "#b8860b", "#ead9a0", "#d9b13b", "#5f4a12"),
    "designed_single_member": Look("d", "#5b6ea8", "#c3cbe6", "#93a5de", "#3a4672"),
    "randomised_slush": Look("P", "#b5304f", "#eeb4c0", "#e5708a", "#6d2a3a"),
    "anisotropic_slush": Look("p", "#2f7f4f", "#b3d9c1", "#5fb884", "#24563a"),
    "flowing_slush": Look("h", "#8a5a2b", "#dcc5ad", "#c08f5d", "#5f4023"),
}
"""Arms that look the same in all studies."""

OTHERS = (
    Look("X", "#0f8b8d", "#a3d9d9", "#3fc1c3", "#1d5a5b"),
    Look("*", "#b0408f", "#e6b8d8", "#dd7fc0", "#66305a"),
    Look("<", "#6f7d1c", "#d2d8a0", "#aebd4f", "#474f1a"),
    Look(">", "#a4472c", "#e3b9ab", "#dd8163", "#5e2f21"),
    Look("H", "#44546a", "#bcc6d3", "#93a6c0", "#37475c"),
)
"""For all others, in the order of the study's arms."""


def looks_of(arms: Iterable[str]) -> dict[str, Look]:
    """Return how the arms of a study are drawn, by name, in the order of listings."""
    others = cycle(OTHERS)
    return {name: LOOKS.get(name) or next(others) for name in in_order(arms)}


def page_color(color: str) -> str:
    """Return the CSS variable that a page has in place of a colour, because it is another on a dark page."""
    return f"--c{color.removeprefix('#')}"


def palette_css() -> str:
    """Return the variables of all colours, for a light and for a dark page."""
    light = dark = ""
    for look in (*LOOKS.values(), *OTHERS):
        for color, in_the_dark in ((look.color, look.dark), (look.adapted, look.dark_adapted)):
            light += f" {page_color(color)}: {color};"
            dark += f" {page_color(color)}: {in_the_dark};"
    return f":root {{{light} }}\n@media (prefers-color-scheme: dark) {{ :root {{{dark} }} }}\n"


def arms_css(looks: Mapping[str, Look]) -> str:
    """Return a variable for each arm of a study, by which templates and scripts know its colour."""
    variables = "".join(f" --arm-{name}: var({page_color(look.color)});" for name, look in looks.items())
    return f":root {{{variables} }}\n"
