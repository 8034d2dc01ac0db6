"""The one error of fabrication."""


class KitError(ValueError):
    """A part, a bar or a kit can't be made. The message names it or the setting, what was expected, and what it is."""
