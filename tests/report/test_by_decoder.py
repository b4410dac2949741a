"""Cameras judged by a decoder on photographs: paired differences, at an exposure tuned for it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from support.designs import SCENE
from support.rows import MOVING, STILL, changed, made_up, verdict

from mishutter import (
    Limits,
    ParabolicMotion,
    Scene,
    StillCamera,
    WienerDecoder,
    compare,
    example_picture,
)
from mishutter.decoding.photographs import restore_by_each
from mishutter.report import by_decoder
from mishutter.report.by_decoder import Judgement, OnPictures, judged_by, pictures_to_judge
from mishutter.report.restored import longest_kernel
from mishutter.search.rivals import BEST_STILL_BURST
from mishutter.search.rows import BEST_SNAPSHOT

LIGHT = example_picture().luminance
PICTURES = [LIGHT[100:116, :300], LIGHT[300:316, :300], LIGHT[200:216, 300:600]]
SNAPSHOT = OnPictures(np.array([24.0, 27.5, 21.0]), STILL, 0.72)
CAMERA = OnPictures(np.array([25.5, 28.6, 22.3]), MOVING, 0.85).over(SNAPSHOT)
JUDGEMENT = Judgement("MyDecoder", 3, {BEST_SNAPSHOT: SNAPSHOT.over(SNAPSHOT), "mine": CAMERA})


def test_differences_are_paired():
    """1.5, 1.1 and 1.3 dB: 1.3 in the mean, 0.2 from one photograph to another, less by sqrt 3."""
    assert CAMERA.gain == pytest.approx(1.3, rel=1e-12)
    assert CAMERA.standard_error == pytest.approx(0.2 / np.sqrt(3), rel=1e-12)
    assert SNAPSHOT.over(SNAPSHOT).standard_error == 0


def test_the_table_and_the_document_have_them():
    """A column of gains and one of exposures; a burst has neither, nor have other tables."""
    table = verdict({BEST_SNAPSHOT: 23.0, "mine": 24.4, BEST_STILL_BURST: 24.5}, "mine")
    judged = replace(table, judgement=JUDGEMENT)
    first, *others = judged.tables
    shown = {
        row[0].partition(",")[0]: dict(zip(first.columns, row, strict=True)) for row in first.rows
    }
    assert shown["mine"]["on pictures"] == "+1.30 ±0.12"
    assert shown["mine"]["there ms"] == "20.00"
    assert shown[BEST_SNAPSHOT]["on pictures"] == "+0.00 ±0.00"
    assert shown[BEST_STILL_BURST]["on pictures"] == "–"
    assert any("on 3 pictures by MyDecoder" in note for note in first.notes)
    assert all("on pictures" not in other.columns for other in others)
    assert "on pictures" not in table.tables[0].columns
    document = judged.to_dict()["on_pictures"]
    assert document["cameras"]["mine"]["gain_db"] == CAMERA.gain
    assert document["cameras"]["mine"]["exposure_share"] == 0.85
    assert "on_pictures" not in table.to_dict()


@pytest.mark.parametrize(
    ("name", "less", "line"),
    [
        ("mine", 0.0, "mine is 1.30 ± 0.12 dB above"),
        (BEST_SNAPSHOT, 0.0, "best snapshot is 0.00 ± 0.00 dB above"),
        (None, 0.0, "the best camera, mine, is 1.30 ± 0.12 dB above"),
        ("mine", 1.55, "mine is 0.25 ± 0.12 dB below"),
    ],
)
def test_a_line_of_the_verdict(name, less, line):
    """It names the decoder, the number of pictures, and the camera to build or the best."""
    mine = CAMERA._replace(levels=CAMERA.levels - less).over(SNAPSHOT)
    judgement = JUDGEMENT._replace(cameras=JUDGEMENT.cameras | {"mine": mine})
    whole = f"By MyDecoder on 3 pictures {line} the best snapshot."
    assert judgement.sentence(name) == whole


@pytest.mark.parametrize(
    ("picture", "message"),
    [
        (np.full((20, 300), 130, np.uint8), "must hold light, white = 1.* got uint8"),
        (np.full((20, 300), -0.3), "must be at least 0; got -0.3"),
        (np.full(300, 0.3), r"must have rows and columns; got \(300,\)"),
    ],
)
def test_what_is_no_photograph_is_told_before_the_search(picture, message):
    """By the name that its user knows, also out of a generator."""
    each = (light for light in (PICTURES[0], picture))
    with pytest.raises(ValueError, match=rf"^`compare\(pictures=...\)` {message}"):
        pictures_to_judge(WienerDecoder(), each)


def exposed(row, share):
    """The motion of a row with a share of its exposure."""
    motion = row.motion
    half = share * motion.half_exposure
    return ParabolicMotion(
        acceleration=motion.acceleration, half_exposure=half, velocity=motion.velocity
    )


@pytest.fixture(scope="module")
def few():
    """A snapshot and a parabola in dim light, in the room of a small picture."""
    limits = Limits(max_stroke=20, max_half_exposure=0.02)
    scene = Scene.uniform(
        max_speed=2800.0, num_speeds=5, photon_rate=3e4, read_noise=10, limits=limits
    )
    still, moving = made_up({BEST_SNAPSHOT: 23.0, "Hann": 24.4})
    still = changed(still, motion=StillCamera(half_exposure=2.2e-3))
    moving = changed(moving, motion=ParabolicMotion.from_stroke(16.0, half_exposure=6e-3))
    return scene, [still, moving]


@pytest.mark.slow
def test_the_exposure_is_the_best_of_those_beside_it(few):
    """Of each camera, by captures and restorations at all speeds of the scene, on equal columns."""
    scene, rows = few
    found = judged_by(WienerDecoder(), PICTURES, scene, rows, rows[0]).cameras
    taps = longest_kernel(scene, [exposed(row, 1.18) for row in rows])

    def level(picture, row, share):
        camera = (scene, exposed(row, share), row.shutter)
        decoders = {"mine": WienerDecoder()}
        result = restore_by_each(picture, *camera, decoders, num_seeds=1, least_taps=taps)
        return result["mine"].mean_psnr

    for row in rows:
        best = found[row.name]
        shares = best.exposure_share, 0.85 * best.exposure_share, 1.0
        own, shorter, as_it_was = (
            np.mean([level(picture, row, share) for picture in PICTURES]) for share in shares
        )
        assert own == pytest.approx(best.levels.mean(), abs=1e-6)
        assert own > shorter - 0.01
        assert own >= as_it_was
        half = float(row.motion.half_exposure)
        assert float(best.motion.half_exposure) == pytest.approx(best.exposure_share * half)


@pytest.mark.parametrize(("best", "share"), [(0.7, 0.72), (1.0, 1.0), (1.3, 1.18)])
def test_exposures_are_tried_on_both_sides(best, share, few, monkeypatch):
    """Shorter ones in turn, and a longer one, as long as they gain something."""
    scene, rows = few
    own = float(rows[0].motion.half_exposure)

    def restored(picture, scene, motion, *given, **how):
        level = 25 - abs(float(motion.half_exposure) / own - best)
        return {"": SimpleNamespace(mean_psnr=level)}

    monkeypatch.setattr(by_decoder, "restore_by_each", restored)
    found = judged_by(WienerDecoder(), PICTURES, scene, rows[:1], rows[0]).cameras
    assert found[BEST_SNAPSHOT].exposure_share == pytest.approx(share)


@pytest.mark.slow
def test_a_comparison_ends_with_the_decoder(few):
    """The answer's last line is of the best option; every row of one exposure is judged."""
    scene, rows = few
    table = compare(scene, rows[1].motion, decoder=WienerDecoder(), pictures=PICTURES[:2])
    built = table.choice.name if table.is_coded else None
    assert table.verdict.splitlines()[-1] == table.judgement.sentence(built)
    assert table.judgement.num_pictures == 2
    names = {row.name for row in table.rows if row.is_of_one_exposure}
    assert set(table.judgement.cameras) == names
    assert "on pictures" in table.text(verbose=True)


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (
            {"decoder": WienerDecoder()},
            "`compare(pictures=...)` must be two or more beside a decoder, for a standard error; "
            "got 0.",
        ),
        (
            {"decoder": WienerDecoder(), "pictures": PICTURES[:1]},
            "`compare(pictures=...)` must be two or more beside a decoder, for a standard error; "
            "got 1.",
        ),
        (
            {"pictures": PICTURES},
            "`compare(decoder=...)` must stand beside compare(pictures=...); got None.",
        ),
    ],
)
def test_one_without_the_other_is_refused_before_any_search(arguments, line):
    """By the argument, what must hold, and what came."""
    with pytest.raises(ValueError, match="must") as caught:
        compare(SCENE, MOVING, **arguments)
    assert str(caught.value) == line
