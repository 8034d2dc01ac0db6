"""The same bytes from processors of several kinds: those with AVX2 and FMA, with and without AVX-512."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from llvmlite.binding import get_host_cpu_features

ROOT = Path(__file__).parents[2]

SETTINGS = """
name: tiny
throws: {n_throws: 6, n_steps: 60}
network: {hidden_layers: 2, width: 16}
training: {n_iterations: 50, batch_size: 64}
ensemble: {n_members: 2}
grid: {depths: [1.0], single_member_depths: [], n_trials: 1}
rollout: {n_settle: 20, n_measure: 100}
evolution: {n_generations: 4, afpo: {population_size: 8}}
transfer: {n_generations: 2}
assess: {n_designs: 10}
"""

WITH_AVX2 = ("sse", "sse2", "sse3", "ssse3", "sse4.1", "sse4.2", "popcnt", "cx16")
WITH_AVX2 += ("avx", "avx2", "fma", "bmi", "bmi2", "lzcnt", "f16c", "movbe")
AVX2_ALONE = {
    "NUMBA_CPU_NAME": "haswell",
    "NUMBA_CPU_FEATURES": ",".join(f"+{feature}" for feature in WITH_AVX2),
    "ATEN_CPU_CAPABILITY": "avx2",  # torch
    "MKL_ENABLE_INSTRUCTIONS": "AVX2",
    "OPENBLAS_CORETYPE": "Haswell",
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX512F,-AVX512VL,-AVX512BW,-AVX512DQ",
}
"""Variables that hide AVX-512 from the compiler and the libraries."""


def digests(folder: Path, **variables: str) -> str:
    """Run a study without its report, and return the digests of all that it made."""
    folder.mkdir()
    (folder / "tiny.yaml").write_text(SETTINGS)
    environment = {**os.environ, "PYTHONPATH": str(ROOT), **variables}
    options = ["--settings", str(folder / "tiny.yaml"), "--store", str(folder / "store")]
    puddle = [sys.executable, "-m", "pipeline"]
    for stage in ("collect", "train", "evolve", "transfer", "assess", "analyse"):
        subprocess.run([*puddle, stage, "--workers", "0", *options], env=environment, check=True, capture_output=True)
    said = [*puddle, "status", "--digests", *options]
    return subprocess.run(said, env=environment, check=True, capture_output=True, text=True).stdout


def test_the_same_bytes_with_avx2_as_with_avx512(torture, tmp_path: Path):
    if not torture.large:
        pytest.skip("with --torture: it compiles every kernel for another processor")
    if not get_host_cpu_features().get("avx512f"):
        pytest.skip("this processor has no AVX-512")
    torture.times(1, 1)
    features = np._core._multiarray_umath.__cpu_dispatch__
    without = " ".join(name for name in features if "AVX512" in name or name == "X86_V4")
    native = digests(tmp_path / "native")
    assert "evolve/" in native and "analyse/" in native
    assert digests(tmp_path / "avx2", **AVX2_ALONE, NPY_DISABLE_CPU_FEATURES=without) == native
