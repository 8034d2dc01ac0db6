from __future__ import annotations

import base64
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from pipeline.config.settings import RolloutSettings
from pipeline.report.replay import QUANTUM, encode, replay_of
from tasks.world import Physics, TrueSlush

WORDS = {"title": "a robot", "seen_in": "True Slush"}


def decode(encoded: dict) -> np.ndarray:
    """Undo encode() as robot.js does: int16 multiples of the quantum."""
    quanta = np.frombuffer(base64.b64decode(encoded["frames"]), "<i2").reshape(-1, 6, 3)
    return quanta * encoded["quantum"]


def test_frames_begin_where_the_displacement_is_measured_from(rollout, slush_replay):
    _, trace, displacement = rollout
    # 60 steps settle, 180 are measured: the states after steps 60, 62 ... 240 are 91 frames of 1/30 s, so 3 s.
    assert slush_replay.frames.shape == (91, 6, 3)
    assert slush_replay.duration == pytest.approx(3.0)
    assert np.array_equal(slush_replay.frames[0], trace[59, :, :3])
    assert np.array_equal(slush_replay.frames[-1], trace[-1, :, :3])
    assert slush_replay.frames[-1, 0, 0] - slush_replay.frames[0, 0, 0] == pytest.approx(displacement, abs=1e-6)


def test_time_passes_as_in_the_rollout(rollout):
    design, trace, _ = rollout
    slow = replay_of(design, trace, TrueSlush(2.0), n_settle=60, physics=Physics(time_step=0.05), **WORDS)
    # 180 steps of 0.05 s are measured; two of them make a frame of 0.1 s.
    assert (slow.fps, slow.duration) == (pytest.approx(10.0), pytest.approx(9.0))
    assert (encode(slow)["fps"], encode(slow)["quantum"]) == (slow.fps, QUANTUM)


def test_a_design_may_have_room_for_more_links(rollout):
    design, trace, _ = rollout
    own, wide = (
        encode(replay_of(of, trace, TrueSlush(2.0), n_settle=60, **WORDS)) for of in (design, design.with_room(8))
    )
    assert own == wide


@given(
    frames=hnp.arrays(np.float64, st.tuples(st.integers(2, 6), st.just(6), st.just(3)), elements=st.floats(-1e4, 1e4))
)
def test_encoding_any_motion_stays_within_half_a_quantum(slush_replay, frames):
    encoded = encode(replace(slush_replay, frames=frames))
    assert np.abs(decode(encoded) - frames).max() <= encoded["quantum"] * 0.5 + 1e-9


@pytest.mark.parametrize("n_settle", [0, 1, 7])
def test_the_shortest_rollout_that_settings_allow_can_be_shown(rollout, n_settle):
    """One frame is none: nothing moves in it."""
    design, trace, _ = rollout
    n_steps = n_settle + RolloutSettings(n_settle=n_settle, n_measure=3).n_measure
    assert len(replay_of(design, trace[:n_steps], TrueSlush(2.0), n_settle=n_settle, **WORDS).frames) == 2
    with pytest.raises(ValueError, match=r"n_measure\n.*greater than or equal to 3"):
        RolloutSettings(n_settle=n_settle, n_measure=2)


def test_disagreement_survives_its_encoding(slush_replay):
    """Values to half of a 254th of the most shown; what is larger is shown as the most, what is unknown as 255."""
    n_frames, n_links = slush_replay.frames.shape[:2]
    values = np.linspace(0.0, 2.0, n_frames * n_links).reshape(n_frames, n_links)
    values[0, 0] = np.nan
    encoded = encode(replace(slush_replay, disagreement=values))["disagreement"]
    levels = np.frombuffer(base64.b64decode(encoded["levels"]), np.uint8).reshape(n_frames, n_links)
    assert levels[0, 0] == 255 and (levels.ravel()[1:] <= 254).all()
    shown = levels.ravel()[1:] / 254 * encoded["most"]
    np.testing.assert_allclose(
        shown, np.minimum(values.ravel()[1:], encoded["most"]), atol=encoded["most"] * (0.5 / 254 + 1e-4)
    )
    assert encoded["most"] == pytest.approx(1.9, abs=0.01)  # the 95th percentile of 0 to 2
