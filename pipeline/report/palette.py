"""Colours and markers of arms: one arm looks the same in every figure, on every page and in every film of a study."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import cycle

from tasks.residual import Learner, arm_kind, in_order


@dataclass(frozen=True)
class Look:
    """How an arm is drawn."""

    marker: str  # Matplotlib marker, so that colour is never the only difference
    color: str
    adapted: str  # once its controllers have adapted to the target
    label: str = ""


LOOKS: Mapping[str, Look] = {
    "true_slush": Look("o", "#1c6fb8", "#a6cbe8"),
    "dry_land": Look("s", "#1d6b3c", "#9ed3a9"),
    "residual_slush": Look("^", "#dd7700", "#fbcb8f"),
    "single_member": Look("D", "#7d4aa5", "#cfb6e2"),
    "designed_throws": Look("v", "#0fa3a6", "#a8e0e0"),
    "designed_single_member": Look("d", "#5b6ea8", "#c3cbe6"),
    "randomised_slush": Look("P", "#b5304f", "#eeb4c0"),
    "anisotropic_slush": Look("p", "#2f7f4f", "#b3d9c1"),
    "flowing_slush": Look("h", "#8a5a2b", "#dcc5ad"),
    "fluid": Look("8", "#2b4fb0", "#b4c3ea"),
    "falling_plate": Look("<", "#6a3d1f", "#d8c0ae"),
    "mujoco_fluid": Look(">", "#51618a", "#c4cbdd"),
}
"""Arms that look the same in all studies."""

OTHERS = (
    Look("X", "#d6428f", "#f3bcd8"),
    Look("*", "#6f7d1c", "#d2d8a0"),
    Look("<", "#a4472c", "#e3b9ab"),
    Look(">", "#44546a", "#bcc6d3"),
    Look("H", "#b8860b", "#ead9a0"),
)
"""For all others, in the order of the study's arms."""


def looks_of(arms: Iterable[str], target: str, learners: Mapping[str, Learner]) -> dict[str, Look]:
    """Return how the arms of a study with these learners are drawn and called, by name, the target first."""
    others = cycle(OTHERS)
    named = {name: arm_kind(name, learners).label for name in in_order(arms, target)}
    return {name: replace(LOOKS.get(name) or next(others), label=label) for name, label in named.items()}


def arms_css(looks: Mapping[str, Look]) -> str:
    """Return a variable for each arm of a study, by which templates and scripts know its colour."""
    variables = "".join(f" --arm-{name}: {look.color};" for name, look in looks.items())
    return f":root {{{variables} }}\n"
