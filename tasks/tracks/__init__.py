"""Tracked throws of real bars: from noisy positions to the residuals that networks learn."""

from tasks.tracks.bars import Bars
from tasks.tracks.conventions import Tracks
from tasks.tracks.residuals import residual_transitions
from tasks.tracks.table import TrackError, TrackTable
