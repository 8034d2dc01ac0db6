"""What a form of network is: what networks read of a link, how their outputs act on it, and how they learn to.

Everything else knows shapes alone. ``read`` and ``act`` are formulas of arrays and of lanes, as the law of a
:class:`tasks.world.medium.Fluid` is: a batch engine compiles them into its steps. So networks of any form are fast.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from tasks.arrays import Float32, Float64, Floats
from tasks.discovery import register, with_failures
from tasks.world.medium import LinkStates, Medium, MediumWithMemory
from tasks.world.physics import Physics

if TYPE_CHECKING:
    from tasks.residual.throws import Transitions

_LEAST_ANSWER = 0.15  # share of strikes; drag alone takes back up to 8 % in the paper's slush, as a strike makes faster
N_VELOCITIES = 3  # vx, vy and ω: what outputs change; positions follow by integration


class Targets(NamedTuple):
    """What outputs learn; axis 0 is the row.

    The error of output i is its value, plus those of all further outputs times their shares, less the target.
    """

    values: Float32  # (n_rows, n_errors) targets of the first outputs
    weights: Float32  # (n_rows, n_errors) of the squared errors; (n_rows, 0) if all are 1 and there are no shares
    shares: Float32  # (n_rows, n_errors · n_further) of each further output in the errors, output by output


def _as_they_are(read: Float32, change: Float32, weights: Float32, deviation: Float32) -> Targets:  # noqa: ARG001
    return Targets(change, weights if (weights != 1).any() else weights[:, :0], change[:, :0])


@dataclass(frozen=True, kw_only=True)
class Form:
    """A form of network. To vary one, :func:`dataclasses.replace` what differs."""

    name: str  # as the setting network.form has it
    about: str = ""  # what it is, in a sentence, for a page

    inputs: tuple[str, ...]  # names of what networks see
    read: Callable[[Any], tuple[Any, ...]]
    """Formula: the inputs, and then what is unseen, by the links' LinkStates."""
    reads_kicks: bool = False  # whether ``read`` reads what joints, motors and contacts changed of a link's velocities
    unseen: tuple[str, ...] = ()  # what else ``read`` returns, for ``act`` alone

    outputs: tuple[str, ...]  # what the outputs are measured by; those after the first three have no error of their own
    act: Callable[[Any, Any], tuple[Any, Any, Any]]
    """Formula: the changes of vx, vy [m/s] and ω [rad/s] in a step, by the outputs and factors, and by what is read."""
    constants: tuple[str, ...] = ()
    """What is fitted to throws, before networks learn what that leaves over."""
    shares: Collection[str] = ()
    """Names of outputs that are shares of something, whatever the time step; the others are in proportion to it."""
    factors_in_proportion: tuple[bool, ...] = ()
    """Whether each of the factors of a step that follow from the constants is in proportion to the time step."""
    fit: Callable[[LinkStates, Float32, Float32, Physics], tuple[Float64, Float32]] = (
        lambda links, change, weights, physics: (np.empty(0), np.empty(0, np.float32))
    )
    """(n_constants,) constants and (n_factors,) factors, by (n_rows,) links, their (n_rows, 3) changes, and (n_rows, 3)
    weights of squared errors."""
    beside: tuple[str, ...] = ()
    """Components of a step's residual that networks learn as well, before the outputs, and that act on nothing."""

    measured: Callable[[Float32, Float32], Float32] = lambda read, change: change
    """(n_rows, n_beside + n_outputs) changes, each in the unit of its output, by what is read and
    (n_rows, n_beside + 3) true residuals. Training standardises them."""
    targets: Callable[[Float32, Float32, Float32, Float32], Targets] = _as_they_are
    """Targets, by what is read, these changes in units of their deviations, weights of the squared errors of the first
    n_beside + 3, and the deviations."""
    symmetries: Sequence[Collection[str]] = ()
    """Names among inputs, ``beside`` and ``outputs`` that change sign where a motion is exchanged for another that is
    as possible. Networks learn from all copies."""
    mirror: Collection[str] = ()
    """The same of mirror images, from which networks learn unless the throws show that the fluid flows."""

    objection: Callable[[Medium | MediumWithMemory, Physics], str] = lambda medium, physics: ""
    """Why networks can't learn a medium, such as "acts above y = 0: expected plain"; "" if they can."""
    warning: Callable[[Transitions], str] = lambda transitions: ""
    """What makes it doubtful that they learn from throws, in a line; "" if nothing does."""

    def __repr__(self) -> str:
        return f"Form({self.name!r})"

    @property
    def n_factors(self) -> int:
        """Number of the factors."""
        return len(self.factors_in_proportion)

    @property
    def n_errors(self) -> int:
        """Number of squared errors of a row: of the components beside, and of three velocities."""
        return len(self.beside) + N_VELOCITIES

    @property
    def learned(self) -> tuple[str, ...]:
        """What all outputs of a network in training are measured by; only the last ones, the outputs, act."""
        return (*self.beside, *self.outputs)


FORMS: dict[str, Form] = {}  # forms by name
FAMILIES: dict[str, Callable[[str], Form]] = {}  # forms that follow from a medium, such as law:true_slush, by its name


def register_form(form: Form) -> Form:
    """Add a form to the registry, and return it.

    Raises:
        ValueError: another form has the name, or its formulas do not fit it.
    """
    some = np.ones(1, np.float32)
    read, names = form.read(LinkStates(*[some] * len(fields(LinkStates)))), (*form.inputs, *form.unseen)
    if len(read) != len(names):
        listed = ", ".join(names)
        raise ValueError(f"form {form.name!r}: read returns {len(read)} inputs, expected {len(names)}: {listed}")
    if (n := len(form.act((some,) * (len(form.outputs) + form.n_factors), read))) != N_VELOCITIES:
        raise ValueError(f"form {form.name!r}: act returns {n} changes, expected {N_VELOCITIES}: of vx, vy and omega")
    register(FORMS, "form", form.name, form)
    return form


def form_named(name: str) -> Form:
    """Return a form; raise ValueError if there is none of the name."""
    family, _, medium = name.partition(":")
    if family in FAMILIES:
        return FAMILIES[family](medium)
    if name not in FORMS:
        said = f"network.form: expected any of {', '.join(sorted([*FORMS, *FAMILIES]))}, got {name!r}"
        raise ValueError(with_failures(said))
    return FORMS[name]


def form_here(name: str) -> Form | None:
    """Return a form; None if its code is not here."""
    try:
        return form_named(name)
    except ValueError:
        return None


def kicks_unseen(form: Form, transitions: Transitions) -> str:
    """Say that a fluid answers strikes that networks of a form do not see; "" if it does not, or they do."""
    struck = transitions.kick.any(axis=1) & transitions.residual[:, 3:].any(axis=1)
    if form.reads_kicks or not struck.any():
        return ""
    kick, change = transitions.kick[struck, :2].ravel(), transitions.residual[struck, 3:5].ravel()
    square = float(kick @ kick)
    back = -float(kick @ change) / square  # strikes depend on nothing, so this slope is that of all else being equal
    if back < max(_LEAST_ANSWER, 4 * float(change.std()) / square**0.5):
        return ""
    return f"the fluid takes back {back:.0%} of strikes, which these networks do not see: use the form wetted_mass"


def observe(form: Form, links: LinkStates) -> Float32:
    """Return (..., n_read) inputs and what is unseen, in float32, by the states of links, arrays of one shape (...).

    A state that is not finite, or too large for float32, gives inputs that are not finite and no error, because a
    diverged rollout is a status.
    """
    with np.errstate(all="ignore"):
        arrays = (np.asarray(getattr(links, field.name)).astype(np.float32) for field in fields(links))
        return np.stack(form.read(LinkStates(*arrays)), axis=-1)


def velocity_changes(form: Form, outputs: Floats, inputs: Floats) -> Floats:
    """Return (..., 3) changes of vx, vy and ω by (..., n_outputs + n_factors) outputs and (..., n_read) inputs."""
    return np.stack(form.act(*(tuple(np.moveaxis(rows, -1, 0)) for rows in (outputs, inputs))), axis=-1)


def symmetric_copies(
    form: Form, read: Float32, change: Float32, weights: Float32, *, mirrored: bool
) -> tuple[Float32, Float32, Float32]:
    """Return the rows, and their copies by each symmetry and by several at once, with or without mirror images."""
    for odd in (*form.symmetries, *([form.mirror] if mirrored else [])):
        read, change = (
            np.concatenate((rows, rows * np.array([1 - 2 * (name in odd) for name in names], np.float32)))
            for rows, names in ((read, (*form.inputs, *form.unseen)), (change, form.learned))
        )
        weights = np.tile(weights, (2, 1))
    return read, change, weights
