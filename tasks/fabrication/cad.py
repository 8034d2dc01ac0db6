"""A check for the optional CAD packages, which take seconds to import."""

from importlib.util import find_spec

_PACKAGES = ("build123d", "ezdxf", "shapely")


class MissingCadError(RuntimeError):
    """A CAD package is not installed. The message says how to install it."""


def require_cad() -> None:
    """Raise MissingCadError unless the packages of :mod:`tasks.fabrication.kit` are installed. Imports none of them."""
    missing = [package for package in _PACKAGES if find_spec(package) is None]
    if missing:
        raise MissingCadError(
            f"{', '.join(missing)} not installed, but needed to make parts. Run: pip install 'puddle[cad]' "
            f"(in a checkout: pip install --constraint constraints.txt --editable '.[cad]')"
        )
