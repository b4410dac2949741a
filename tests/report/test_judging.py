"""What a comparison asks of stills and photographs beside a row: the row's window and knowledge."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from support.bursts import SEQUENCE
from support.rows import made_up

from mishutter import BurstMode, Limits, Scene, WienerDecoder
from mishutter.evaluation.bursts import StillBursts
from mishutter.evaluation.speed_knowledge import KNOWN_SPEED
from mishutter.report.by_decoder import judged_by
from mishutter.report.verdict import details_of
from mishutter.search.rivals import BEST_MOVING_BURST, BEST_STILL_BURST
from mishutter.search.rows import BEST_SNAPSHOT

SCENE = Scene(
    [-245.0, 0.0, 315.0],
    photon_rate=1e5,
    read_noise=3.1,
    limits=Limits(max_stroke=40.0, max_half_exposure=0.03),
    burst=BurstMode(frames_per_s=55.0, max_frames=2),
)


def _said_of(row):
    """The details of an answer that takes a row, in one line."""
    return " ".join(" ".join(details_of(SCENE, row)).split())


def test_equal_stills_last_as_long_as_the_burst():
    """The stills that equal a burst that moves are counted in its own time, not in the scene's."""
    window, whole = StillBursts(SCENE, window=SEQUENCE.duration), StillBursts(SCENE)
    level = window.best(400.0).psnr - 0.07
    counts = [bursts.number_that_equals(level, most=200) for bursts in (window, whole)]
    assert counts[0] != counts[1]
    still, moving = made_up({BEST_STILL_BURST: level - 3, BEST_MOVING_BURST: level})
    stills = replace(SEQUENCE, frames=SEQUENCE.frames[:1] * 2)
    frames = replace(SEQUENCE, psnr=level, worst_psnr=level - 9)
    rows = [replace(still, sequence=stills), replace(moving, sequence=frames)]
    assert f"are equal to {counts[0]} stills in the same time." in _said_of(rows[1])


def test_photographs_are_restored_with_the_knowledge_of_the_row(monkeypatch):
    """A decoder that judges a row that is told the speed is told it too; the other is not."""
    told = {}

    class Result:
        mean_psnr = 30.0

    def restored(picture, scene, motion, shutter, decoders, *, decoder_speed, **_):
        told.setdefault(float(motion.half_exposure), set()).add(decoder_speed)
        return dict.fromkeys(decoders, Result)

    # Captures and restorations have tests of their own, and take seconds.
    monkeypatch.setattr("mishutter.report.by_decoder.restore_by_each", restored)
    snapshot, other = made_up({BEST_SNAPSHOT: 23.0, "Hann": 24.4})
    rows = [snapshot, replace(other, decoder=KNOWN_SPEED)]
    judged_by(WienerDecoder(), [np.ones((8, 300))] * 2, SCENE, rows, snapshot)
    assert told[float(snapshot.motion.half_exposure)] == {"unknown"}
    assert told[float(other.motion.half_exposure)] == {"known"}


@pytest.mark.parametrize("at_worst", [False, True])
def test_equal_stills_are_judged_as_the_burst_is(at_worst):
    """At the worst speed where that judges the burst."""
    window = StillBursts(SCENE, window=SEQUENCE.duration, at_worst=at_worst)
    other = StillBursts(SCENE, window=SEQUENCE.duration, at_worst=not at_worst)
    level = window.best(400.0).psnr - 0.07
    count = window.number_that_equals(level, most=200)
    assert count != other.number_that_equals(level, most=200)
    still, moving = made_up({BEST_STILL_BURST: level - 3, BEST_MOVING_BURST: level})
    stills = replace(SEQUENCE, frames=SEQUENCE.frames[:1] * 2)
    metrics = replace(moving.metrics, worst_speed_psnr=jnp.asarray(level))
    moving = replace(moving, metrics=metrics, at_worst=at_worst)
    levels = {"worst_psnr" if at_worst else "psnr": level}
    frames = replace(SEQUENCE, **{"psnr": level + 9, "worst_psnr": level - 9} | levels)
    rows = [replace(still, sequence=stills), replace(moving, sequence=frames)]
    assert f"are equal to {count} stills in the same time." in _said_of(rows[1])
