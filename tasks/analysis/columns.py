"""Columns of a table: fields of a frozen dataclass with heading, unit, form and meaning, and those that many share."""

from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, field, fields, make_dataclass
from typing import Any, get_type_hints

from tasks.evolution import Objective
from tasks.residual.learner import NO_LEARNERS, Learner, arm_kind
from tasks.world import EnvironmentName

Form = str | Callable[[Any], str]  # a format, such as "{:.1f}", or a function that writes a value


class ScoreUnit(str):
    """Unit of scores, which :func:`scored_by` replaces."""


SCORE = ScoreUnit("m")


def column(
    label: str, unit: str = "", *, form: Form = "{:z.1f}", meaning: str = "", shown: bool = True, default: Any = MISSING
) -> Any:
    """Describe a column, the field of a row: its heading, unit, how a number is written, and what it means.

    ``meaning`` is a sentence, where the label does not say it all. A column that is not shown is in files alone. The
    unit of what depends on the study's objective is ``SCORE``.
    """
    return field(
        default=default, metadata={"label": label, "unit": unit, "form": form, "meaning": meaning, "shown": shown}
    )


def scored_by(objective: Objective, row: type) -> type:
    """Return a kind of row as a study of an objective describes it: its scores are in the objective's unit."""
    if objective.is_papers:
        return row
    types, columns = get_type_hints(row), []
    for attribute in fields(row):
        about = dict(attribute.metadata)
        if isinstance(about["unit"], ScoreUnit):
            meaning = about["meaning"].replace("Displacement of the root", objective.label)
            about |= {"unit": objective.unit, "form": about["form"].replace(".1f", ".2f"), "meaning": meaning}
        columns.append((attribute.name, types[attribute.name], field(metadata=about)))
    return make_dataclass(row.__name__, columns)


def environment_name(name: str, learners: Mapping[str, Learner] = NO_LEARNERS) -> str:
    """Write an environment with its symbol, in a study with these learners."""
    kind = arm_kind(name, learners)
    return f"{kind.label}, {kind.symbol}"


def percent(share: float) -> str:
    """Write a share in whole per cent."""
    return f"{100 * share:z.0f} %"


@dataclass(frozen=True)
class OfArm:
    """The first columns of a table about arms."""

    environment: EnvironmentName = column("evolved in", form=environment_name)
    depth: float = column("depth", "m", form="{:g}")


@dataclass(frozen=True)
class OfTrial(OfArm):
    """The first columns of a table about champions."""

    trial: int = column("trial", form="{}")

    @property
    def key(self) -> tuple[EnvironmentName, float, int]:
        """Environment, depth [m] and number: what tells trials of a study from one another."""
        return self.environment, self.depth, self.trial
