from __future__ import annotations

from dataclasses import replace

import pytest

from pipeline.report.films import render_films
from pipeline.report.gif import render_gif
from pipeline.report.mp4 import render_mp4


def test_both_films_of_the_same_pictures(slush_replay, dry_replay):
    """Of 91, 60 and 11 pictures: after the last that the GIF has come none, two and one."""
    for replays in ([dry_replay, slush_replay], [dry_replay], [replace(dry_replay, frames=dry_replay.frames[:11])]):
        assert render_films(replays) == (render_gif(replays), render_mp4(replays))
    with pytest.raises(ValueError, match="needs a replay"):
        render_films([])
