"""The page in a real browser."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from browser import Browser

from pipeline.report.page import render_page
from pipeline.report.replay import Replay


@pytest.fixture(scope="module")
def page(study, drawn, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("page") / "index.html"
    path.write_text(render_page(replace(study, replays=[annotated(replay) for replay in study.replays]), drawn))
    return path


def annotated(replay: Replay) -> Replay:
    """Disagreement that grows over time, and differs between links."""
    n_frames, n_links = replay.frames.shape[:2]
    values = np.linspace(0.0, 1.0, n_frames)[:, None] * np.linspace(1.0, 3.0, n_links)
    return replace(replay, disagreement=values)


@pytest.fixture(params=[1200, 390], ids=["desk", "phone"])
def opened(request, browser, page) -> Browser:
    browser.open(page, width=request.param)
    return browser


def seen(browser: Browser) -> None:
    """Scroll through the whole page, so that whatever starts when it is seen has started."""
    browser.evaluate(
        "(async () => { for (let y = 0; y < document.body.scrollHeight; y += 400) {"
        " scrollTo(0, y); await new Promise(requestAnimationFrame); } scrollTo(0, 0); })()"
    )


def test_every_figure_is_there_and_fits(opened, drawn):
    seen(opened)
    for name in drawn:
        size = opened.evaluate(
            f"(() => {{ const svg = document.querySelector('#{name} svg');"
            " return svg ? [svg.clientWidth, svg.clientHeight] : null; })()"
        )
        assert size and min(size) > 60, name
    for name in ("film-of-both", "viewer", "table-transfer", "table-paper", "table-exploiters"):
        assert opened.evaluate(f"document.getElementById('{name}').getBoundingClientRect().height") > 30, name
    opened.evaluate("document.querySelectorAll('details').forEach((one) => { one.open = true; })")
    assert opened.evaluate("document.documentElement.scrollWidth - innerWidth") <= 0
    assert opened.evaluate("document.querySelectorAll('.absent').length") == 0


def test_no_request_leaves_the_file_and_the_console_is_clean(opened, page):
    seen(opened)
    requested = {event["request"]["url"] for event in opened.named("Network.requestWillBeSent")}
    assert {url for url in requested if not url.startswith("data:")} == {page.as_uri()}
    assert opened.named("Runtime.exceptionThrown") == []
    assert opened.named("Runtime.consoleAPICalled") == []
    assert opened.named("Log.entryAdded") == []


def click(browser: Browser, identity: str) -> None:
    browser.evaluate(f"document.getElementById('{identity}').click()")


def choose(browser: Browser, identity: str, value: str) -> None:
    browser.evaluate(
        f"(() => {{ const e = document.getElementById('{identity}'); e.value = '{value}';"
        " e.dispatchEvent(new Event('change')); e.dispatchEvent(new Event('input')); })()"
    )


def test_the_viewer_plays_to_the_end_and_starts_again(opened):
    first = opened.drawn("stage")
    choose(opened, "scrub", "1.5")
    assert opened.evaluate("document.getElementById('time').textContent") == "1.5 / 3.0 s"
    assert (opened.drawn("stage") != first).any()
    choose(opened, "scrub", "0")
    np.testing.assert_array_equal(opened.drawn("stage"), first)
    choose(opened, "speed", "4")
    click(opened, "play")
    assert opened.evaluate("document.getElementById('play').textContent") == "Pause"
    opened.until("document.getElementById('play').textContent === 'Play'")
    assert opened.evaluate("document.getElementById('time').textContent") == "3.0 / 3.0 s"
    assert (opened.drawn("stage") != first).any()
    click(opened, "play")
    opened.until("parseFloat(document.getElementById('scrub').value) < 2.5")


def test_the_viewer_is_drawn_when_it_appears(opened):
    """MLflow shows a page in a frame that has no size at first, and tells the page nothing when it gets one."""
    before = opened.drawn("stage")
    opened.evaluate("stage.parentElement.style.display = 'none'; stage.width = 0")
    opened.evaluate("new Promise(requestAnimationFrame)")
    opened.evaluate("stage.parentElement.style.display = ''")
    opened.until("stage.width > 0")
    np.testing.assert_array_equal(opened.drawn("stage"), before)


def test_the_prediction_is_shown_beside_true_slush(opened):
    """By default, for a robot that was filmed in two environments; other robots are shown alone."""
    choose(opened, "choice", "1")  # filmed in True Slush only
    alone = opened.drawn("stage")
    choose(opened, "choice", "3")
    choose(opened, "beside", "")
    predicted = opened.drawn("stage")
    choose(opened, "beside", "twin")
    both = opened.drawn("stage")
    wide = opened.evaluate("innerWidth") > 600
    first, second = np.array_split(both, 2, axis=1 if wide else 0)
    assert (first.shape == second.shape) and (first != second).any()
    assert all(len(np.unique(half.reshape(-1, 3), axis=0)) > 20 for half in (first, second))  # a robot in each
    assert (both.shape[0] > alone.shape[0]) != wide
    click(opened, "disagreement")
    legend = opened.evaluate("document.getElementById('legend').textContent")
    assert "Solid: in Residual Slush (member 1); dashed: in True Slush." in legend
    assert predicted.shape == alone.shape


def test_disagreement_colours_links_and_the_line_below_follows(opened):
    choose(opened, "scrub", "3")
    plain = opened.drawn("stage")
    assert opened.evaluate("document.getElementById('line').hidden")
    click(opened, "disagreement")
    assert not opened.evaluate("document.getElementById('line').hidden")
    assert (opened.drawn("stage") != plain).any()
    assert "m/s²" in opened.evaluate("document.getElementById('legend').textContent")
    opened.evaluate(
        "(() => { const line = document.getElementById('timeline'), box = line.getBoundingClientRect();"
        " line.dispatchEvent(new PointerEvent('pointerdown',"
        " {buttons: 1, clientX: box.x + box.width / 2, clientY: box.y + 5})); })()"
    )
    assert opened.evaluate("parseFloat(document.getElementById('scrub').value)") == pytest.approx(1.5, abs=0.05)


def test_the_gallery_moves_where_it_is_seen_and_opens_the_viewer(opened):
    scroll = "document.querySelector('.film').scrollIntoView({block: 'center', behavior: 'instant'})"
    seen, deadline = set(), time.monotonic() + 20  # of a machine that has much else to do
    while len(seen) < 3 and time.monotonic() < deadline:
        opened.evaluate(scroll)  # what stands above may grow once it is drawn, and push the film out of sight
        seen.add(opened.evaluate("document.querySelector('.film canvas').toDataURL()"))
        time.sleep(0.2)
    assert len(seen) == 3
    opened.evaluate("document.querySelector('.film').click()")
    assert opened.evaluate("document.getElementById('choice').value === document.querySelector('.film').dataset.replay")
    assert opened.evaluate("document.getElementById('play').textContent") == "Pause"


def test_a_film_opens_the_viewer_of_a_single_robot(browser, study, drawn, tmp_path):
    page = tmp_path / "index.html"
    page.write_text(render_page(replace(study, replays=study.replays[2:3]), drawn))
    browser.open(page, width=1200)
    browser.evaluate("document.querySelector('.film').click()")
    assert browser.evaluate("document.getElementById('play').textContent") == "Pause"
    assert browser.evaluate("document.getElementById('disagreement').disabled")
    assert browser.named("Runtime.exceptionThrown") == []


def test_the_address_of_a_robot_opens_it_with_its_files_and_commands(opened):
    opened.evaluate("location.hash = '#robot-residual_slush-9m-trial-0:predicted'")
    opened.until("document.getElementById('choice').value === '3'")
    opened.evaluate("location.hash = '#robot-residual_slush-9m-trial-0'")
    opened.until("document.getElementById('choice').value === '2'")
    name = "robot-residual_slush-9m-trial-0.json"
    assert opened.evaluate("document.getElementById('design').getAttribute('href')") == name
    command = opened.evaluate("document.querySelector('[data-command]').textContent")
    assert f"/{name} --study small --store store --environment true_slush --depth 9" in command
