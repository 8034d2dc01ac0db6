"""What moves on the page: the gallery of exemplars, the viewer with its controls, and the script that plays both."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from html import escape
from importlib.resources import files
from itertools import groupby
from string import Template

from pipeline.config.settings import EnvironmentName
from pipeline.report.replay import Replay, encode
from pipeline.report.wording import absent, number

EXEMPLARS: tuple[EnvironmentName, EnvironmentName] = ("residual_slush", "dry_land")
"""Of each depth: with residuals and without. Paper, Fig. 1."""

SCRIPTS = ("robot.js", "viewer.js", "gallery.js")


def resource(name: str) -> str:
    """Read a file of the page's own."""
    return files("pipeline.report").joinpath(name).read_text(encoding="utf-8")


def document(*, title: str, policy: str, body: str, css: str = "") -> str:
    """Give a whole page: a study's, a kit's.

    Args:
        title: HTML already.
        policy: what may be loaded beside styles, as a Content-Security-Policy.
        body: HTML.
        css: besides page.css.
    """
    pieces = {"title": title, "policy": policy, "css": resource("page.css").rstrip() + css, "body": body.rstrip()}
    return Template(resource("document.html")).substitute(pieces)


# -- the gallery ------------------------------------------------------------------------------------------------------


def gallery(replays: Sequence[Replay], *, lost: str | None = None) -> str:
    """Show at each depth the exemplar that evolved with residuals above the one that evolved without.

    Args:
        replays: of the study.
        lost: why no champion can be filmed, where that is known.
    """
    shown = sorted(
        (replay.depth, EXEMPLARS.index(environment), index)
        for index, replay in enumerate(replays)
        for environment in EXEMPLARS
        if replay.environment == environment and replay.in_true_slush
    )
    if not shown:
        none_yet = "no champion evolved with residuals or on Dry Land has been filmed in slush yet"
        return absent("The gallery", lost or none_yet)
    cards = []
    for depth, group in groupby(shown, key=lambda entry: entry[0]):
        films = "".join(_film(replays[index], index) for _, _, index in group)
        cards.append(f'<figure class="exemplars"><h3>{depth:g} m of slush</h3>{films}</figure>')
    return f'<div id="gallery" class="gallery">{"".join(cards)}</div>'


def _film(replay: Replay, index: int) -> str:
    kept = "with residuals" if replay.environment == "residual_slush" else "without residuals"
    moved = number(float(replay.frames[-1, 0, 0] - replay.frames[0, 0, 0]))
    label = f"{kept}: {moved} m"
    swatch = f'<span class="swatch {escape(replay.environment)}"></span>'
    return (
        f'<button type="button" class="film" data-replay="{index}" title="Open in the viewer">'
        f'<canvas role="img" aria-label="{escape(label)}"></canvas><span>{swatch}{escape(label)}</span></button>'
    )


# -- the viewer -------------------------------------------------------------------------------------------------------


def viewer(replays: Sequence[Replay], *, lost: str | None = None) -> str:
    """Lay out the viewer's canvas and controls; ``lost`` as of :func:`gallery`."""
    if not replays:
        return absent("The replay viewer", lost or "no champion’s motion has been kept yet")
    numbered = sorted(enumerate(replays), key=lambda item: item[1].depth)
    # The first thing to see is what the study is about: a robot evolved with residuals, where they matter most, and
    # beside what it does what it promised.
    chosen, _ = max(numbered, key=lambda item: _interest(item[1]))
    overlays = dict.fromkeys(overlay.label for replay in replays for overlay in replay.overlays)
    colors = "".join(f'<option value="{escape(label)}">{escape(label)}</option>' for label in overlays)
    pushes = any(replay.push is not None for replay in replays)
    return f"""<div class="viewer" id="viewer">
<div class="bar"><label class="grow">Robot <select id="choice">{_groups(numbered, chosen)}</select></label>
<label class="grow">Beside it <select id="beside"><option value="">nothing</option>
<option value="twin" selected>the same robot, in its other world</option>
{_groups(numbered, None)}</select></label></div>
<canvas id="stage" role="img" aria-label="A robot moving in its world"></canvas>
<div class="bar below"><button id="play" type="button">Play</button>
<input id="scrub" type="range" min="0" max="1" step="0.01" value="0" aria-label="Time">
<output id="time" for="scrub"></output></div>
<div id="line" hidden><canvas id="timeline" role="img" aria-label="The colour’s value over time"></canvas>
<p id="legend" class="small"></p></div>
<div class="bar below"><label>Speed <select id="speed"><option value="0.25">¼ ×</option><option value="0.5">½ ×</option>
<option value="1" selected>1 ×</option><option value="2">2 ×</option><option value="4">4 ×</option></select></label>
<label>Colour <select id="overlay"><option value="" selected>where it evolved</option>{colors}</select></label>
<label><input id="push" type="checkbox"{"" if pushes else " disabled"}> Push of the slush</label>
<label><input id="follow" type="checkbox" checked> Follow the robot</label></div>
</div>
<p class="small">The root link, whose way is measured, is darker and bears a black dot; joints are white dots. The
number is how far the root has come since the clock started, once the robot had
settled.{_twin_words(replays)}{_overlay_words(overlays)}</p>"""


def _interest(replay: Replay) -> tuple[bool, bool, float]:
    return replay.environment == "residual_slush", replay.in_true_slush, replay.depth


def _twin_words(replays: Sequence[Replay]) -> str:
    if all(replay.in_true_slush for replay in replays):
        return ""
    words = " Beside what a robot does in True Slush stands what it promised where it evolved."
    if any(replay.imagined for replay in replays):
        words += (
            " Of an ensemble that is the world of the member that promises the median (the lower of two); slush that "
            "is only imagined has a dashed surface, and its push is what the member imagines."
        )
    return words


def _overlay_words(overlays: Iterable[str]) -> str:
    if not list(overlays):
        return " Where its networks disagree is not shown: the study has not been analysed, or has no networks."
    return (
        " Colour can show instead where the networks can’t be trusted: what their members disagree about at each link, "
        "and how far its state is from every throw (1 is usual for a fresh throw). The line below the clock follows "
        "the mean over the links; press on it to go there."
    )


def _groups(numbered: Sequence[tuple[int, Replay]], chosen: int | None) -> str:
    return "".join(
        f'<optgroup label="Depth {depth:g} m">{_choices(group, chosen)}</optgroup>'
        for depth, group in groupby(numbered, key=lambda item: item[1].depth)
    )


def _choices(numbered: Iterable[tuple[int, Replay]], chosen: int | None) -> str:
    return "".join(
        f'<option value="{index}"{" selected" if index == chosen else ""}>{escape(_choice(replay))}</option>'
        for index, replay in numbered
    )


def _choice(replay: Replay) -> str:
    return replay.title if replay.in_true_slush else f"{replay.title}: in {replay.world}"


def script(replays: Sequence[Replay]) -> str:
    """Put the replays and what plays them at the page's end."""
    if not replays:
        return ""
    # "<" is written as an escape, so that no title can close the element.
    data = json.dumps([encode(replay) for replay in replays], separators=(",", ":")).replace("<", "\\u003c")
    code = "\n".join(resource(name) for name in SCRIPTS)
    return f'<script type="application/json" id="replays">{data}</script>\n<script>\n{code}</script>'
