"""Whether the optional packages of CAD are there. They take seconds to import, so nothing else looks for them early."""

from __future__ import annotations

from importlib.util import find_spec

_PACKAGES = ("build123d", "ezdxf", "shapely")


class MissingCadError(RuntimeError):
    """The packages that make parts are not installed: says which, and how to get them."""


def require_cad() -> None:
    """Check that parts can be made, without importing anything; :mod:`tasks.fabrication.kit` may be imported then.

    Raises:
        MissingCadError: a package is missing.
    """
    missing = [package for package in _PACKAGES if find_spec(package) is None]
    if missing:
        raise MissingCadError(
            f"making parts needs {', '.join(missing)}, not installed here: pip install 'puddle[cad]' "
            f"(from a checkout: pip install --constraint constraints.txt --editable '.[cad]')"
        )
