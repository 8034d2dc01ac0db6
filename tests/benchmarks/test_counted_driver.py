"""What the cluster trial counts is what passes through the driver."""

from benchmarks.counted_driver import counting, n_bytes_in
from pipeline.cluster import on_ray


def items_of(names, *contents):
    """Return the files of two items, as the dispatcher's call on a worker does."""
    return [{"a": contents[0]["shared"][:10]}, {"a": b"12345"}], 1.5


def test_bytes_are_found_within_mappings_and_sequences():
    assert n_bytes_in([{"a": b"123", "b": (b"4", "text", 5)}, b"67"]) == 6


def test_puts_inputs_and_results_are_counted(local_ray):
    before = on_ray._Ray.share
    with counting() as counts:
        shared = local_ray.share({"shared": bytes(1000)})
        local_ray.submit(items_of, ["x"], shared, {"population": bytes(200_000)}, name="evolve two trials")
        while local_ray.n_running:
            local_ray.next_done(timeout=0.01)
    assert on_ray._Ray.share is before
    assert (counts.n_puts, counts.put_bytes, counts.n_large_arguments) == (1, 1000, 1)
    found = counts.stages["evolve"]
    assert (found.n_calls, found.n_items, found.worker_seconds) == (1, 2, 1.5)
    assert (found.sent, found.returned) == (200_000, 15)
    assert 0 < found.idle < found.ended - found.begun
