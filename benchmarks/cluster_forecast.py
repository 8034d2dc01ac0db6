"""Forecasts of the presets desk and paper on 64 and 1,000 cores: `python -m benchmarks.cluster_forecast`.

Writes docs/results/cluster-forecast.json, which docs/cluster.md shows. The figures are those of `puddle forecast` in an
empty store, with what they are made from. It takes five minutes on one core, which must be free.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Any

from benchmarks.published import RESULTS
from pipeline.cluster import pin_threads
from pipeline.commands.cost_model import DriverLimits, StudyForecast, forecast_study
from pipeline.config.loading import load, preset_path
from pipeline.config.settings import Settings
from pipeline.store.provenance import environment as provenance

CORES = (64, 1000)
GPU_TFLOPS, N_GPUS = 20.0, 64  # a GPU for each network
FORECASTS = (("desk", None), ("paper", None), ("paper", GPU_TFLOPS))
"""Presets, and the stated rate of a GPU for each network, where training is not the cores' [TFLOP/s]."""


def forecast(preset: str, gpu_tflops: float | None) -> StudyForecast:
    """Forecast a preset, from a calibration run."""
    overrides = [] if gpu_tflops is None else ["training.device=cuda"]
    settings = load(Settings, preset_path(preset), overrides=overrides)
    return forecast_study(settings, None, CORES, gpu_tflops=gpu_tflops, n_gpus=N_GPUS, say=print)


def row(preset: str, gpu_tflops: float | None) -> dict[str, Any]:
    """Return a forecast and what it is made from."""
    found = forecast(preset, gpu_tflops)
    return {
        "preset": preset,
        "gpu_tflops": gpu_tflops,
        "stages": [
            {
                "stage": one.stage,
                "n_items": one.n_items,
                "core_seconds": round(one.core_seconds, 1),
                "longest_chain_seconds": round(one.longest_chain_seconds, 1),
                "traffic": round(one.traffic),
                "seconds": {str(n): round(found.stage_seconds(one, n), 1) for n in CORES},
                "limit": {str(n): found.limit(one, n) for n in CORES},
            }
            for one in found.stages
        ],
        "seconds": {str(n): round(found.seconds(n), 1) for n in CORES},
    }


def main() -> None:
    """Forecast every study and write the results."""
    pin_threads()
    document = {
        "schema": "puddle.cluster_forecast",
        "version": 1,
        "made_with": dict(provenance()),
        "driver": asdict(DriverLimits()),
        "rows": [row(*study) for study in FORECASTS],
    }
    text = json.dumps(document, indent=1, ensure_ascii=False)
    (RESULTS / "cluster-forecast.json").write_text(f"{text}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
