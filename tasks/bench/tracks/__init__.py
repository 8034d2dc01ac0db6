"""Tracked throws of real bars: from noisy positions to the residuals that networks learn."""

from tasks.bench.tracks.bars import Bars
from tasks.bench.tracks.conventions import Tracks
from tasks.bench.tracks.residuals import residual_transitions
from tasks.bench.tracks.table import TrackError, TrackTable
