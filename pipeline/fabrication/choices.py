"""Settings of ``puddle fabricate``, separate from a study's."""

from tasks.fabrication.kit_settings import KitSettings
from tasks.fabrication.scaling import Scaling
from tasks.fabrication.timeline import Playback
from tasks.parameters import Parameters


class FabricationSettings(Parameters):
    """Settings of a kit."""

    kit: KitSettings = KitSettings()
    """Parts, servo and printer."""
    scaling: Scaling = Scaling()
    """Scaling from simulation to bench."""
    playback: Playback = Playback()
    """The run on the bench."""
