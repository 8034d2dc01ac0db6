"""Identity of a chain that is not a trial: a member, a chunk of throws, an analysis, the page."""

from dataclasses import dataclass

from pipeline.workflow.identity import Arm


@dataclass(frozen=True)
class PartId:
    """A part of a stage's work, for the whole study or for one arm."""

    name: str
    arm: Arm | None = None

    @property
    def label(self) -> str:
        """Name for display."""
        return f"{self.name}/{self.arm.label}" if self.arm else self.name
