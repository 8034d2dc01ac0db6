"""Where work runs: in this process, on this machine's cores, or on a Ray cluster.

The driver submits pure functions and collects their outcomes in any order. Only the driver writes to the store, so
workers need no shared disk. :func:`serial_cluster` (for debugging and tests) and :func:`ray_cluster` give the same
results.
"""

from pipeline.cluster.inference import connect
from pipeline.cluster.interface import Cluster, Done, Outcome, TaskFailed, Ticket
from pipeline.cluster.on_ray import Spread, ray_cluster
from pipeline.cluster.serial import serial_cluster

__all__ = ["Cluster", "Done", "Outcome", "Spread", "TaskFailed", "Ticket", "connect", "ray_cluster", "serial_cluster"]
