"""Provenance: the environment in which a result was computed; in every manifest, but in no key and no digest."""

import functools
import importlib.metadata
import platform
import subprocess
from pathlib import Path

_PACKAGES = ("puddle", "Box2D", "mlflow", "numba", "numpy", "pyarrow", "ray", "safetensors", "scipy", "torch")


@functools.cache
def environment() -> dict[str, str]:
    """Return the versions of Python and the packages, the commit of the code, the system and the CPU's model."""
    return {
        **{package: _version(package) for package in _PACKAGES},
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "cpu": _cpu_model(),
        "commit": _commit(Path(__file__).resolve().parents[2]),
    }


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def _commit(checkout: Path) -> str:
    """Return the commit that is checked out, with ``-dirty`` if files differ from it."""
    if not (checkout / ".git").exists():  # an installed package may lie inside some other checkout
        return "not a checkout"
    command = ["git", "describe", "--always", "--abbrev=40", "--dirty", "--exclude=*"]
    try:
        return subprocess.check_output(command, cwd=checkout, text=True, timeout=10, stderr=subprocess.DEVNULL).strip()
    except (OSError, subprocess.SubprocessError):
        return "unknown"


def _cpu_model() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return models[0] if models else platform.processor() or platform.machine()
