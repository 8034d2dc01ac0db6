"""Tables of docs/results/cluster-trial.json and cluster-forecast.json, as docs/cluster.md shows them."""

from collections.abc import Callable, Mapping
from typing import Any

_STAGES_SHOWN = ("train", "evolve", "transfer")  # which take nearly all the time
_ROWS_OF_STUDY: Mapping[str, Callable[[Mapping[str, Any]], str]] = {
    "time of the command": lambda row: f"{row['seconds']:.0f} s",
    "workers busy with items": lambda row: _percent(row["occupancy"]),
    "share of the machine's cores that workers use": lambda row: _percent(row["core_share"]["workers"]),
    "that the driver uses": lambda row: _percent(row["core_share"]["driver"], 1),
    "that Ray's servers use": lambda row: _percent(row["core_share"]["ray"], 1),
    "work items": lambda row: f"{row['n_items']:,}",
    "items committed per second": lambda row: f"{row['items_per_second']:.1f}",
    "processor time of the driver per item": lambda row: f"{row['driver_cpu_ms']:.0f} ms",
    "puts into the object store": lambda row: f"{row['n_puts']:,}, {_megabytes(row['put_bytes'])}",
    "inputs sent with items": lambda row: _megabytes(row["sent_bytes"]),
    "results returned": lambda row: _megabytes(row["returned_bytes"]),
    "contents per second, both ways": lambda row: f"{row['bytes_per_second'] / 1e6:.2f} MB/s",
    "all traffic on the loopback": lambda row: _megabytes(row["loopback_bytes"]),
}


def study(results: Mapping[str, Any]) -> str:
    """Tabulate a study on this machine and on Ray's test cluster."""
    part = results["parts"]["study"]
    rows = part["rows"]
    lines = [f"| | {' | '.join(row['where'] for row in rows)} |", "|---|" + "--:|" * len(rows)]
    for what, cell in _ROWS_OF_STUDY.items():
        lines.append(f"| {what} | {' | '.join(cell(row) for row in rows)} |")
    equal = f"{part['n_equal']:,} of {part['n_digests']:,}"
    return "\n".join([*lines, f"| results equal to the byte | | {equal} |"])


def driver(results: Mapping[str, Any]) -> str:
    """Tabulate how many items a second the driver handles."""
    lines = [
        "| an item takes | and returns | cores, as told | items per second | workers busy | the driver's time per item "
        "| its processor time | the machine's cores busy |",
        "|" + "--:|" * 8,
    ]
    for row in results["parts"]["driver"]["rows"]:
        cells = (
            f"{row['item_seconds']:g} s",
            f"{row['item_bytes'] / 1e6:g} MB",
            f"{row['believed_cores']:,}",
            f"{row['items_per_second']:.0f}",
            _percent(row["occupancy"]),
            f"{row['driver_ms']:.1f} ms",
            f"{row['driver_cpu_ms']:.1f} ms",
            _percent(row["machine_busy"]),
        )
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def forecast_inputs(results: Mapping[str, Any]) -> str:
    """Tabulate what forecasts are made from."""
    lines = [
        "| preset | stage | items | core time of an item | traffic of an item | the longest chain |",
        "|---|---|" + "--:|" * 4,
    ]
    for row in results["rows"]:
        for stage in row["stages"]:
            if stage["stage"] not in _STAGES_SHOWN or (row["gpu_tflops"] and stage["stage"] != "train"):
                continue
            n_items = stage["n_items"]
            cells = (
                _preset(row),
                stage["stage"],
                f"{n_items:,}",
                _time(stage["core_seconds"] / n_items),
                f"{stage['traffic'] / n_items / 1e6:,.1f} MB",
                _time(stage["longest_chain_seconds"]),
            )
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def forecast(results: Mapping[str, Any]) -> str:
    """Tabulate how long studies take on many cores, and what limits them."""
    lines = [
        "| preset | cores | forecast | cores occupied | train | evolve | transfer | the rest |",
        "|---|" + "--:|" * 3 + "---|" * 3 + "--:|",
    ]
    for row in results["rows"]:
        of_stage = {stage["stage"]: stage for stage in row["stages"]}
        on_cores = (stage for stage in row["stages"] if not (row["gpu_tflops"] and stage["stage"] == "train"))
        core_seconds = sum(stage["core_seconds"] for stage in on_cores)
        for n, seconds in row["seconds"].items():
            shown = [of_stage[name] for name in _STAGES_SHOWN]
            rest = seconds - sum(stage["seconds"][n] for stage in shown)
            cells = (
                _preset(row),
                f"{int(n):,}",
                _time(seconds),
                _percent(core_seconds / (int(n) * seconds)),
                *(f"{_time(stage['seconds'][n])}, {stage['limit'][n]}" for stage in shown),
                _time(rest),
            )
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _preset(row: Mapping[str, Any]) -> str:
    return f"`{row['preset']}`" + (f", a GPU of {row['gpu_tflops']:g} TFLOP/s per network" if row["gpu_tflops"] else "")


def _time(seconds: float) -> str:
    if seconds < 100:
        return f"{seconds:.2g} s" if seconds < 10 else f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:,.1f} h"


def _percent(share: float, digits: int = 0) -> str:
    return f"{100 * share:.{digits}f} %"


def _megabytes(n_bytes: float) -> str:
    return f"{n_bytes / 1e6:,.0f} MB"
