"""What a comparison asks of photographs beside a row: the row's knowledge of the speed."""

from dataclasses import replace

import numpy as np
from support.rows import made_up

from mishutter import BurstMode, Limits, Scene, WienerDecoder
from mishutter.evaluation.speed_knowledge import KNOWN_SPEED
from mishutter.report.by_decoder import judged_by
from mishutter.search.rows import BEST_SNAPSHOT

SCENE = Scene(
    [-245.0, 0.0, 315.0],
    photon_rate=1e5,
    read_noise=3.1,
    limits=Limits(max_stroke=40.0, max_half_exposure=0.03),
    burst=BurstMode(frames_per_s=55.0, max_frames=2),
)


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
