"""The kit: everything needed to build one design as a robot. Paper, "Manufacturing".

Needs the optional CAD packages: make setup EXTRAS=cad.
"""

from dataclasses import dataclass

from tasks.design import Designs
from tasks.fabrication.assembly import Assembly, assemble
from tasks.fabrication.bill import BillLine, bill_of
from tasks.fabrication.checks import KitFinding, findings_of
from tasks.fabrication.kit_settings import KitSettings
from tasks.fabrication.parts import BoughtPart, Gauge, Part, bought_of, gauges_of, parts_of


@dataclass(frozen=True, eq=False)
class Kit(Assembly):
    """A robot to build, with its parts, bill and findings."""

    parts: tuple[Part, ...]  # pieces to print
    bought: tuple[BoughtPart, ...]  # servos, horns, rods and pins, in place
    gauges: tuple[Gauge, ...]  # test prints for the fit of servo and horn
    findings: tuple[KitFinding, ...]  # faults first
    bill: tuple[BillLine, ...]

    @property
    def mass_g(self) -> float:
        """Mass of prints, servos and steel, without screws and cables."""
        return sum(line.mass_g for line in self.bill if line.mass_g is not None)

    @property
    def printed_mm3(self) -> float:
        """Volume of the prints, which displaces water once all hollows are flooded."""
        return sum(part.volume_mm3 for part in self.parts)


def build_kit(design: Designs, settings: KitSettings) -> Kit:
    """Make the parts of one design and check them. Raises as :func:`tasks.fabrication.assembly.assemble`."""
    assembly = assemble(design, settings)
    parts = parts_of(assembly)
    return Kit(
        **vars(assembly),
        parts=tuple(parts),
        bought=tuple(bought_of(assembly)),
        gauges=gauges_of(assembly.servo_joints, settings),
        findings=findings_of(assembly),
        bill=tuple(bill_of(assembly, parts)),
    )
