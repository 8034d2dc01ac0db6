"""The report of a study: figures, films and one page. Plain data in, text and bytes out; no store here.

To add a figure: draw it in the module of its subject, list it in figures.py, and give it a place in page.html.
"""

from pipeline.report.data import ArtifactDigest, ResidualError, StudyReport, TrialResult
from pipeline.report.drawing import Drawing, Missing
from pipeline.report.figures import draw_all
from pipeline.report.films import render_films, render_gif, render_mp4
from pipeline.report.page import render_page, render_robot
from pipeline.report.replay import Replay, replay_of

__all__ = [
    "ArtifactDigest",
    "Drawing",
    "Missing",
    "Replay",
    "ResidualError",
    "StudyReport",
    "TrialResult",
    "draw_all",
    "render_films",
    "render_gif",
    "render_mp4",
    "render_page",
    "render_robot",
    "replay_of",
]
