"""What may be chosen of a kit: a settings file of its own, apart from a study's."""

from __future__ import annotations

from tasks.fabrication.kit_settings import KitSettings
from tasks.fabrication.scaling import Scaling
from tasks.fabrication.timeline import Playback
from tasks.parameters import Parameters


class FabricationSettings(Parameters):
    """A kit's settings."""

    kit: KitSettings = KitSettings()
    """Parts, servo, printer."""
    scaling: Scaling = Scaling()
    """From simulated seconds to the bench's."""
    playback: Playback = Playback()
    """The run on the bench."""
