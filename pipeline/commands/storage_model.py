"""An upper estimate of a study's size on the disk, for `puddle doctor`, which has no time for a calibration run."""

from pipeline.commands.cost_model import remaining_chains
from pipeline.config.settings import Settings
from pipeline.workflow.stage import Upstream

_BYTES = {
    "throws": (5e3, 20e3),
    "iterations": (1.5e6, 0.0),
    "generations": (10e3, 0.0),
    "designs": (15e3, 500.0),
    "analyses": (2e6, 0.0),
    "pictures": (1e4, 8e3),
}
"""Bytes of an item, and of each unit of its work: about twice those of the preset row, whose networks are smaller than
the paper's. Tables of generations are estimated by their designs."""

_BYTES_PER_DESIGN = 200.0


def bytes_left_of_study(settings: Settings, upstream: Upstream) -> float:
    """Return about how many bytes the rest of a study will take, rather more than fewer."""
    total = 0.0
    for one in remaining_chains(settings, upstream):
        per_item, per_unit = _BYTES.get(one.stage.unit, (1e6, 0.0))
        if one.stage.unit == "generations":
            per_unit = _BYTES_PER_DESIGN * settings.evolution.afpo.population_size
        total += per_item * len(one.units) + per_unit * sum(one.units)
    return total
