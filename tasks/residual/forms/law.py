"""Forms that know the law of a fluid and fit its constants to throws: system identification.

``law:anisotropic_slush`` has the law of that medium, whatever the target is; ``law`` alone has the paper's slush. Its
constants are the numbers among the medium's fields. They minimise the squared error of Δv and Δω, in units of their
deviations. Each member of an ensemble fits them to a resample of whole throws (the bootstrap, Efron 1979), so the
members disagree where the throws leave the constants open.

``law_and_network`` adds the networks of the form ``wetted``, which learn what the law leaves over.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from tasks.arrays import Float32, Float64
from tasks.compiled import formula, with_law
from tasks.residual.forms import added_mass, wetted
from tasks.residual.forms.form import FAMILIES, Form
from tasks.simd.lanes import from_row
from tasks.simulation.fluids import Links
from tasks.world import ENVIRONMENTS, LinkStates, Physics
from tasks.world.medium import Fluid
from tasks.world.slush import PAPERS_TARGET

_MOST_EVALUATIONS = 200
_CLEARLY = 0.99  # share of a minimum that another one is below
_SHORT = (1e-5, 2e-5)  # time steps [s] in which a factor such as 1 - exp(-k dt) is in proportion, too
_LEAST = 1e-6  # of a constant that is fitted by its logarithm
_DIGITS = 6  # significant digits of a constant, so that it is the same wherever linear algebra rounds differently
_N_OUTPUTS, _N_INPUTS = len(wetted.WETTED.outputs), len(wetted.WETTED.inputs)
_N_BY_MASS, _N_READ = len(added_mass.WETTED_MASS.outputs), _N_INPUTS + len(added_mass.WETTED_MASS.unseen)
_STATE = ("length_scale", "mass", "inertia", "y", "cos", "sin", "vx", "vy", "omega")
_KICKS = ("kick_vx", "kick_vy", "kick_omega")

LAW: Callable[..., tuple[Any, Any, Any]] = Fluid.law  # of a form, which has its own


class UnfittedLaw(ArithmeticError):  # noqa: N818 (what happened, as in a rollout's status)
    """Throws do not determine the constants of a law."""


@formula
def _read(links: Any) -> tuple[Any, ...]:
    place = links.length_scale, links.mass, links.inertia, links.y, links.cos, links.sin
    return (*place, links.vx, links.vy, links.omega)


@formula
def _read_wetted(links: Any) -> tuple[Any, ...]:
    return (*wetted.read(links), *_read(links))


@formula
def _links(s: Any) -> Links:
    return Links(s[0], s[1], s[2], s[3], s[4], s[5], s[6], s[7], s[8], None, None, None, None)


def _act(factors: Any, s: Any) -> Any:
    return LAW(factors, _links(s))


def _act_with_network(outputs: Any, read: Any) -> tuple[Any, Any, Any]:
    x, y, angle = wetted.act(outputs, read)
    factors, s = from_row(outputs, _N_OUTPUTS), from_row(read, _N_INPUTS)
    by_law = LAW(factors, _links(s))
    return by_law[0] + x, by_law[1] + y, by_law[2] + angle


# The same of laws that read kicks.


@formula
def _read_kicked(links: Any) -> tuple[Any, ...]:
    return (*_read(links), links.kick_vx, links.kick_vy, links.kick_omega)


@formula
def _read_wetted_kicked(links: Any) -> tuple[Any, ...]:
    return (*added_mass.read(links), *_read_kicked(links))


@formula
def _kicked_links(s: Any) -> Links:
    return Links(s[0], s[1], s[2], s[3], s[4], s[5], s[6], s[7], s[8], None, s[9], s[10], s[11])


def _act_kicked(factors: Any, s: Any) -> Any:
    return LAW(factors, _kicked_links(s))


def _act_kicked_with_network(outputs: Any, read: Any) -> tuple[Any, Any, Any]:
    x, y, angle = added_mass.act(outputs, read)
    factors, s = from_row(outputs, _N_BY_MASS), from_row(read, _N_READ)
    by_law = LAW(factors, _kicked_links(s))
    return by_law[0] + x, by_law[1] + y, by_law[2] + angle


def constants_of(fluid: Any) -> dict[str, tuple[float, float]]:
    """Return the bounds of a class of media's constants by name; there are none where its law is not all there is."""
    if getattr(fluid, "velocity_change", None) is not Fluid.velocity_change:  # or it changes velocities in another way
        return {}
    numbers = {name: of for name, of in fluid.model_json_schema()["properties"].items() if of.get("type") == "number"}
    return {
        name: (of.get("minimum", of.get("exclusiveMinimum", -np.inf)), of.get("maximum", np.inf))
        for name, of in numbers.items()
    }


def _fit(
    fluid: type[Fluid], links: LinkStates, change: Float32, weights: Float32, physics: Physics
) -> tuple[Float64, Float32]:
    """Return the constants of a fluid that explain changes best, and the factors of its law; see :class:`Form`."""
    from scipy.optimize import least_squares  # takes long to import

    bounds = constants_of(fluid)
    low, high = np.transpose([*bounds.values()])
    positive = low >= 0  # whose logarithms are fitted, from those of 1 and 2 on; the others from 0 and ln 2
    low, high = (np.where(positive, np.log(np.clip(limit, _LEAST, None)), limit) for limit in (low, high))
    drawn = weights.any(axis=1)
    states = {field: getattr(links, field)[drawn].astype(np.float64) for field in (*_STATE, *_KICKS)}
    precise, change = LinkStates(**states), change[drawn]
    scale = np.sqrt(weights[drawn]) / np.maximum(change.std(axis=0), np.finfo(np.float32).tiny)

    def of(constants: Float64) -> Fluid:
        return fluid.model_construct(**dict(zip(bounds, constants.tolist(), strict=True)))

    def off(unknown: Float64) -> Float64:
        by_law = of(np.where(positive, np.exp(unknown), unknown)).velocity_change(precise, physics)
        missed: Float64 = (np.stack((by_law.vx, by_law.vy, by_law.omega), axis=-1) - change) * scale
        return missed.ravel()

    fitted, other = (
        least_squares(off, np.clip(start, low, high), bounds=(low, high), max_nfev=_MOST_EVALUATIONS)
        for start in (0.0, np.log(2.0))
    )
    if other.cost < _CLEARLY * fitted.cost:
        fitted = other
    if idle := [name for name, slope in zip(bounds, fitted.jac.T, strict=True) if not slope.any()]:
        raise UnfittedLaw(f"{', '.join(idle)}: expected throws that the constant makes a difference to, got none")
    if not fitted.success:
        raise UnfittedLaw(f"{', '.join(bounds)}: the fit to throws did not converge in {fitted.nfev} steps")
    constants = np.where(positive, np.exp(fitted.x), fitted.x)
    constants = np.array([float(f"{constant:.{_DIGITS}g}") for constant in constants])
    return constants, np.array(of(constants).factors(physics), np.float32)


@functools.cache
def _form(bases: tuple[Form, Form], acts: tuple[Callable[..., Any], Callable[..., Any]], medium: str) -> Form:
    """Complete a form with the law of a medium: the second of two if it reads kicks."""
    medium = medium or PAPERS_TARGET
    known = {name: kind.settings for name, kind in ENVIRONMENTS.items() if kind.has_one_medium}
    fluids = [name for name, fluid in known.items() if constants_of(fluid)]
    if medium not in fluids:
        said = f"expected the law of a fluid with constants, any of {', '.join(fluids)}, got {medium!r}"
        raise ValueError(f"network.form: {said}")
    fluid: Any = known[medium]
    some = fluid.model_construct(**dict.fromkeys(constants_of(fluid), 1.0))
    base, act = bases[fluid.reads_kicks], acts[fluid.reads_kicks]
    half, whole = (np.array(some.factors(Physics(time_step=dt))) for dt in _SHORT)
    return replace(
        base,
        name=f"{base.name}:{medium}",
        act=formula(with_law(act, formula(fluid.law))),
        constants=tuple(constants_of(fluid)),
        factors_in_proportion=tuple(np.isclose(2 * half, whole, rtol=1e-3, atol=0).tolist()),
        fit=functools.partial(_fit, fluid),
    )


_ALONE = Form(
    name="law",
    about="The law of a fluid takes the place of networks; its constants are fitted to the throws.",
    inputs=(),
    read=_read,
    unseen=_STATE,
    outputs=(),
    act=_act,
    measured=lambda read, change: change[:, :0],
)
_WITH_NETWORK = replace(
    wetted.WETTED,
    name="law_and_network",
    about="The constants of a fluid's law are fitted to the throws. Wetted networks learn what the law leaves over.",
    read=_read_wetted,
    unseen=_STATE,
)
_ALONE_KICKED = replace(_ALONE, read=_read_kicked, reads_kicks=True, unseen=(*_STATE, *_KICKS))
_WITH_KICKED = replace(
    added_mass.WETTED_MASS,
    name=_WITH_NETWORK.name,
    about=_WITH_NETWORK.about,
    read=_read_wetted_kicked,
    unseen=(*added_mass.WETTED_MASS.unseen, *_STATE, *_KICKS),
)
FAMILIES[_ALONE.name] = functools.partial(_form, (_ALONE, _ALONE_KICKED), (_act, _act_kicked))
FAMILIES[_WITH_NETWORK.name] = functools.partial(
    _form, (_WITH_NETWORK, _WITH_KICKED), (_act_with_network, _act_kicked_with_network)
)
