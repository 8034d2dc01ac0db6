"""Choices that the paper leaves open, each with another reading: the variants of `puddle sensitivity`."""

from collections.abc import Sequence
from dataclasses import dataclass

from pipeline.config.loading import parse
from pipeline.config.settings import Settings
from tasks.analysis.scores import ScoredArm


@dataclass(frozen=True)
class OpenChoice:
    """An open choice that is made differently, by one setting."""

    name: str  # of the variant, which ends its study's name
    decided: str
    instead: str
    setting: str  # the assignment a.b=c that makes the choice otherwise
    concerns: ScoredArm = ("true_slush", "zero_shot")  # the champions and the score that show its effect

    def applied(self, settings: Settings, *assignments: str) -> Settings:
        """Return settings with this choice made differently, and further assignments.

        Raises:
            PuddleError: the choice contradicts another setting.
        """
        return changed(settings, self.setting, *assignments)


def changed(settings: Settings, *assignments: str) -> Settings:
    """Return settings with assignments a.b=c applied."""
    name = f"the settings of {settings.name}"
    return parse(Settings, settings.model_dump_json(), name=name, overrides=assignments)


OPEN_CHOICES: Sequence[OpenChoice] = (
    OpenChoice(
        "joint-limits",
        "the range of motion is that of the motor's target",
        "joints stop at its ends",
        "physics.joint_limits=range_of_motion",
    ),
    OpenChoice(
        "peak-to-peak",
        "the range of motion is an amplitude",
        "it is peak to peak",
        "physics.range_of_motion=peak_to_peak",
    ),
    OpenChoice(
        "motors-after-settling",
        "motors run from the spawn on",
        "they start after settling",
        "physics.motors_while_settling=false",
    ),
    OpenChoice(
        "root-at-surface",
        "the lowest corner begins at the surface",
        "the root's centre does",
        "physics.spawn=root_centre",
    ),
    OpenChoice("slower-motors", "motor gain of 10 /s", "3 /s", "physics.motor_gain=3"),
    OpenChoice("denser-links", "links of 1 kg/m²", "1.1 kg/m²", "physics.link_density=1.1"),
    OpenChoice("drag-by-component", "drag opposes the velocity", "each component by itself", "slush.drag=by_component"),
    OpenChoice("euler", "drag is integrated exactly", "by explicit Euler", "slush.drag_integration=euler"),
    OpenChoice(
        "redraw",
        "a changed gene takes a Gaussian step",
        "it is drawn anew",
        "evolution.afpo.mutation.changed_genes=redraw",
    ),
    OpenChoice("longer-steps", "steps of 0.1 of the range", "0.5", "evolution.afpo.mutation.step=0.5"),
    OpenChoice("more-genes", "3 genes change on average", "6 genes", "evolution.afpo.mutation.genes_changed=6"),
    OpenChoice(
        "tournaments",
        "parents are chosen uniformly",
        "in binary tournaments",
        "evolution.afpo.parent_selection=tournament",
    ),
    OpenChoice(
        "rate-per-individual",
        "in adaptation each gene mutates as often as in evolution",
        "as many genes of an individual change",
        "transfer.mutation_rate=per_individual",
        ("true_slush", "adapted"),
    ),
    OpenChoice(
        "sample-deviation",
        "σ over members is the population's deviation",
        "the sample's",
        "ensemble.deviation=sample",
        ("residual_slush", "zero_shot"),
    ),
)
