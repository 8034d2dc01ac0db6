"""The moving parts of the page: the gallery, the viewer with its controls, and the script that plays both."""

import json
import shlex
from collections.abc import Iterable, Sequence
from importlib.resources import files
from itertools import groupby
from string import Template

from pipeline.report.replay import Replay, encode
from pipeline.report.wording import absent, number
from pipeline.text import escape
from tasks.world import ENVIRONMENTS

_WITH_RESIDUALS, _WITHOUT = ("residual_slush", "designed_throws"), "dry_land"  # arms of the gallery. Paper, Fig. 1

_SCRIPTS = ("robot.js", "viewer.js", "gallery.js")


def resource(name: str) -> str:
    """Read a file of this package."""
    return files("pipeline.report").joinpath(name).read_text(encoding="utf-8")


def document(*, title: str, policy: str, body: str, css: str = "") -> str:
    """Return a whole page, for a study or for a kit.

    Args:
        title: escaped for HTML.
        policy: Content-Security-Policy for everything but styles.
        body: HTML.
        css: styles in addition to page.css.
    """
    styles = f"{resource('page.css').rstrip()}\n{environment_css()}{css}"
    texts = {"title": title, "policy": policy, "css": styles, "body": body.rstrip()}
    return Template(resource("document.html")).substitute(texts)


def environment_css() -> str:
    """Return the colours of all environments, for a light and for a dark page."""
    light = dark = swatches = ""
    for name, kind in ENVIRONMENTS.items():
        variable = f"--{name.replace('_', '-')}"
        light += f" {variable}: {kind.color}; {variable}-adapted: {kind.adapted_color};"
        dark += f" {variable}: {kind.dark_color}; {variable}-adapted: {kind.dark_adapted_color};"
        swatches += f".{name} {{ background: var({variable}); }}\n"
    return f":root {{{light} }}\n@media (prefers-color-scheme: dark) {{ :root {{{dark} }} }}\n{swatches}"


def exemplars(replays: Sequence[Replay]) -> list[Replay]:
    """Return the two robots that stand for the study: at the greatest depth, evolved with residuals and without.

    A study without these arms is represented by its best robots in True Slush.
    """
    filmed = [replay for replay in replays if replay.film and replay.in_true_slush]
    arms = _arms_of_gallery(replays)
    chosen = [replay for replay in filmed if replay.environment in arms] or filmed
    deepest = max((replay.depth for replay in chosen), default=None)
    chosen = [replay for replay in chosen if replay.depth == deepest]
    return sorted(chosen, key=lambda replay: replay.environment != arms[0])[:2]


def _arms_of_gallery(replays: Sequence[Replay]) -> tuple[str, str]:
    """Return the arms with residuals, learned from the paper's throws if the study has such, and without."""
    evolved_in = {replay.environment for replay in replays}
    return next((name for name in _WITH_RESIDUALS if name in evolved_in), _WITH_RESIDUALS[0]), _WITHOUT


def films(replays: Sequence[Replay], shown: Sequence[Replay]) -> str:
    """Show some of the replays as films that play by themselves.

    Args:
        replays: all replays of the page.
        shown: those to show.
    """
    return "".join(_film(replay, index) for wanted in shown for index, replay in enumerate(replays) if replay is wanted)


def gallery(replays: Sequence[Replay], *, reason: str | None = None) -> str:
    """Show for each depth the best robot evolved with residuals above the best one evolved without, or the reason."""
    arms = _arms_of_gallery(replays)
    shown = [replay for replay in replays if replay.environment in arms and replay.in_true_slush and replay.film]
    if not shown:
        none_yet = "no champion from Residual Slush or Dry Land has been filmed in True Slush yet"
        return absent("The gallery", reason or none_yet)
    both = len({replay.environment for replay in shown}) > 1
    words = (
        "the best robot evolved with the learned residuals (above) and the best one evolved without (below), both in "
        "True Slush, with their displacement"
        if both
        else f"the best robot evolved {_kind(shown[0])}, in True Slush, with its displacement"
    )
    shown.sort(key=lambda replay: (replay.depth, arms.index(replay.environment)))
    cards = [
        f'<figure class="exemplars"><h3>{depth:g} m of slush</h3>{films(replays, list(group))}</figure>'
        for depth, group in groupby(shown, key=lambda replay: replay.depth)
    ]
    return (
        f"<p>For each depth, {words}. Click on a robot to open it in the viewer.</p>"
        f'<div id="gallery" class="gallery">{"".join(cards)}</div>'
    )


def _kind(replay: Replay) -> str:
    kinds = {**dict.fromkeys(_WITH_RESIDUALS, "with residuals"), _WITHOUT: "without residuals"}
    return kinds.get(replay.environment, "")


def _film(replay: Replay, index: int) -> str:
    kind = _kind(replay) or f"evolved {ENVIRONMENTS[replay.environment].evolved}"
    label = f"{kind}: {number(replay.displacement)} m"
    swatch = f'<span class="swatch {escape(replay.environment)}"></span>'
    return (
        f'<button type="button" class="film" data-replay="{index}" title="Open in the viewer">'
        f'<canvas role="img" aria-label="{escape(label)}"></canvas><span>{swatch}{escape(label)}</span></button>'
    )


def viewer(replays: Sequence[Replay], *, study: str = "", reason: str | None = None) -> str:
    """Return the canvas and the controls of the viewer, or the reason why no champion is filmed.

    Args:
        replays: the robots that it shows.
        study: name of the study, whose robots have addresses, files and commands; "" on the page of one design.
        reason: why there are no replays.
    """
    if not replays:
        return absent("The replay viewer", reason or "no champion has been filmed yet")
    overlays = dict.fromkeys(overlay.label for replay in replays for overlay in replay.overlays)
    colors = "".join(f'<option value="{escape(label)}">{escape(label)}</option>' for label in overlays)
    plain = "where it evolved" if any(replay.environment for replay in replays) else "the same for all links"
    notes = _twin_words(replays) + (_overlay_words(overlays) if overlays or study else "")
    pushes = any(replay.push is not None for replay in replays)
    speeds = "".join(
        f'<option value="{speed}"{" selected" if speed == "1" else ""}>{words} ×</option>'
        for speed, words in (("0.25", "¼"), ("0.5", "½"), ("1", "1"), ("2", "2"), ("4", "4"))
    )
    return f"""<div class="viewer" id="viewer">{_choices(replays) if len(replays) > 1 else ""}
<canvas id="stage" role="img" aria-label="A moving robot"></canvas>
<div class="bar below"><button id="play" type="button">Play</button>
<input id="scrub" type="range" min="0" max="1" step="0.01" value="0" aria-label="Time">
<output id="time" for="scrub"></output></div>
<div id="line" hidden><canvas id="timeline" role="img" aria-label="The value of the colour over time"></canvas>
<p id="legend" class="small"></p></div>
<div class="bar below"><label>Speed <select id="speed">{speeds}</select></label>
<label{"" if overlays else " hidden"}>Colour
<select id="overlay"><option value="" selected>{plain}</option>{colors}</select></label>
<label{"" if pushes else " hidden"}><input id="push" type="checkbox"> Push of the slush</label>
<label><input id="follow" type="checkbox" checked> Follow the robot</label></div>
{_robot_panel(study) if study else ""}</div>
<p class="small">The root link is darker and has a black dot; white dots are joints, and the quartered disc is the
centre of mass. The numbers at the top right are the displacements of the root and of the centre of mass since the start
of the measurement, after the robot has settled.{notes}</p>"""


def _choices(replays: Sequence[Replay]) -> str:
    """Lay out the two lists of robots, in groups; the robot for comparison may be the same one elsewhere."""
    # The viewer opens with the subject of the study: a robot evolved with residuals, at the greatest depth.
    chosen = max(
        replays, key=lambda replay: (replay.environment == "residual_slush", replay.in_true_slush, replay.depth)
    )
    return f"""
<div class="bar"><label class="grow">Robot <select id="choice">{_options(replays, chosen)}</select></label>
<label class="grow">Compare with <select id="beside"><option value="">nothing</option>
<option value="twin" selected>the same robot in its other environment</option>
{_options(replays, None)}</select></label></div>"""


def _robot_panel(study: str) -> str:
    """Lay out the files of the robot that is shown, its address, and the commands that simulate and build it."""
    study = shlex.quote(study)
    commands = (
        f"puddle simulate {{file}} --study {study} --store {{store}} --environment {{seen}} --depth {{depth}} "
        "--out robot.html",
        "puddle fabricate {file} --store {store} --out kit",
    )
    rows = "".join(
        f'<div class="command"><code data-command="{escape(command)}"></code>'
        '<button type="button" class="copy">Copy</button></div>'
        for command in commands
    )
    return f"""<div id="robot" class="robot" hidden><p><a id="address" href="#viewer">Link to this robot</a> ·
<a id="design" href="#viewer" download>Design (JSON)</a><span id="film"> · Film
<a href="#viewer" data-suffix=".mp4" download>MP4</a> <a href="#viewer" data-suffix=".gif" download>GIF</a></span></p>
{rows}</div>"""


def _twin_words(replays: Sequence[Replay]) -> str:
    if len(replays) < 2 or all(replay.in_true_slush for replay in replays):
        return ""
    words = " Next to a robot in True Slush the viewer shows the same robot in the environment where it evolved."
    if any(replay.hallucinated for replay in replays):
        words += (
            " For an ensemble, that is the environment of the member whose prediction is the median (the lower of "
            "two). Hallucinated slush has a dashed surface, and its push is the member’s prediction."
        )
    return words


def _overlay_words(overlays: Iterable[str]) -> str:
    if not list(overlays):
        return (
            " Colours for the disagreement of the networks are missing, because the study has not been analysed or has "
            "no networks."
        )
    return (
        " Colour can also show where the networks are unreliable: the disagreement of the members about each link, or "
        "the distance of its state from all throws (1 is typical for a new throw). The line below the clock is the "
        "mean over the links; click on it to jump to that time."
    )


def _options(replays: Sequence[Replay], chosen: Replay | None) -> str:
    groups: dict[str, str] = {}
    for index, replay in enumerate(replays):
        words = replay.title if replay.in_true_slush else f"{replay.title}: in {replay.seen_in}"
        option = f'<option value="{index}"{" selected" if replay is chosen else ""}>{escape(words)}</option>'
        group = replay.group or f"Depth {replay.depth:g} m"
        groups[group] = groups.get(group, "") + option
    return "".join(f'<optgroup label="{escape(group)}">{options}</optgroup>' for group, options in groups.items())


def script(replays: Sequence[Replay]) -> str:
    """Return the script element with the replays and the code that plays them."""
    if not replays:
        return ""
    # "<" is written as an escape, so that no title can close the element.
    data = json.dumps([encode(replay) for replay in replays], separators=(",", ":")).replace("<", "\\u003c")
    code = "\n".join(resource(name) for name in _SCRIPTS)
    return f'<script type="application/json" id="replays">{data}</script>\n<script>\n{code}</script>'
