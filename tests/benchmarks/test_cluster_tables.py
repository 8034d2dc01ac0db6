"""Tables of the cluster trial and of forecasts for many cores."""

from benchmarks.cluster_tables import driver, forecast, forecast_inputs, study


def test_a_study_on_two_clusters_is_compared_line_by_line():
    row = {
        "where": "this machine",
        "seconds": 240.4,
        "occupancy": 0.975,
        "core_share": {"workers": 0.96, "driver": 0.03, "ray": 0.01},
        "n_items": 1200,
        "items_per_second": 5.04,
        "driver_cpu_ms": 11.6,
        "n_puts": 96,
        "put_bytes": 2e6,
        "sent_bytes": 12e6,
        "returned_bytes": 1.2e9,
        "bytes_per_second": 5.06e6,
        "loopback_bytes": 3e9,
    }
    lines = study(
        {"parts": {"study": {"rows": [row, {**row, "where": "nodes"}], "n_equal": 1200, "n_digests": 1201}}}
    ).splitlines()
    assert lines[0] == "| | this machine | nodes |"
    assert "| workers busy with items | 98 % | 98 % |" in lines
    assert "| that the driver uses | 3.0 % | 3.0 % |" in lines
    assert "| puts into the object store | 96, 2 MB | 96, 2 MB |" in lines
    assert "| contents per second, both ways | 5.06 MB/s | 5.06 MB/s |" in lines
    assert lines[-1] == "| results equal to the byte | | 1,200 of 1,201 |"


def test_a_row_for_each_item_that_sleeps():
    row = {
        "item_seconds": 0.5,
        "item_bytes": 200_000,
        "believed_cores": 1000,
        "items_per_second": 98.6,
        "occupancy": 0.77,
    }
    row |= {"driver_ms": 9.96, "driver_cpu_ms": 8.0, "machine_busy": 0.9}
    *_, line = driver({"parts": {"driver": {"rows": [row]}}}).splitlines()
    assert line == "| 0.5 s | 0.2 MB | 1,000 | 99 | 77 % | 10.0 ms | 8.0 ms | 90 % |"


def stage(name, core_seconds, seconds, limit):
    row = {"stage": name, "n_items": 10, "core_seconds": core_seconds, "longest_chain_seconds": seconds, "traffic": 3e7}
    return {**row, "seconds": {"64": seconds}, "limit": {"64": limit}}


def test_forecasts_say_what_limits_each_stage():
    stages = [
        *(stage("collect", 64.0, 1.0, "cores"), stage("train", 720_000.0, 7200.0, "longest chain")),
        *(stage("evolve", 64_000.0, 1000.0, "cores"), stage("transfer", 640.0, 12.0, "driver")),
    ]
    on_cores = {"preset": "paper", "gpu_tflops": None, "stages": stages, "seconds": {"64": 8213.0}}
    on_gpus = {**on_cores, "gpu_tflops": 20.0, "seconds": {"64": 1073.0}}
    _, _, *inputs = forecast_inputs({"rows": [on_cores, on_gpus]}).splitlines()
    assert inputs[0] == "| `paper` | train | 10 | 20.0 h | 3.0 MB | 2.0 h |"
    assert [line.split(" | ")[1] for line in inputs] == ["train", "evolve", "transfer", "train"]
    _, _, cores, gpus = forecast({"rows": [on_cores, on_gpus]}).splitlines()
    assert cores == "| `paper` | 64 | 2.3 h | 149 % | 2.0 h, longest chain | 17 min, cores | 12 s, driver | 1 s |"
    assert gpus.startswith("| `paper`, a GPU of 20 TFLOP/s per network | 64 | 18 min | 94 % |")
