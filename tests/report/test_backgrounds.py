"""What is left of a gain where part of the picture stands still."""

from dataclasses import replace

import pytest

from mishutter import ExpectedErrorLoss, Limits, Occlusion, RectShutter, Scene, StillCamera
from mishutter.design.design import given_design
from mishutter.report import backgrounds
from mishutter.report.backgrounds import (
    BackgroundGain,
    background_gains,
    background_line,
    before_still_background,
)
from mishutter.search.rivals import RivalSearch, snapshots

LIMITS = Limits(max_stroke=14, max_half_exposure=0.006, min_half_exposure=0.0005)
DIM = Scene([-2300.0, 0.0, 2300.0], photon_rate=7e4, read_noise=9.0, limits=LIMITS)


@pytest.mark.slow
def test_a_still_background_takes_of_the_gain():
    """The more of the picture stands still, the less a moving camera gains; never less than 0."""
    names = []
    half, most = background_gains(DIM, begin=names.append)
    assert names == ["50% still", "70% still"]
    assert half.still_share == 0.5
    assert half.gain >= most.gain >= 0
    rows = snapshots(RivalSearch(before_still_background(DIM, 0.5), ExpectedErrorLoss()))
    snapshot = max(row.level for row in rows)
    own = float(half.camera.metrics.expected_psnr)
    assert half.gain == pytest.approx(max(own - snapshot, 0), abs=1e-6)


@pytest.mark.parametrize(("loss", "gain", "is_design"), [(0.25, 1.5836, True), (0.31, 0.0, False)])
def test_the_gain_is_of_errors_and_the_camera_the_better(loss, gain, is_design, monkeypatch):
    """The loss is the root of a squared error; a snapshot that nothing beats is the camera."""
    made = given_design(DIM, StillCamera(half_exposure=2e-3), RectShutter(), "Given.")
    snapshot, design, other = (replace(made, loss=each) for each in (0.3, loss, 0.4))
    found = {"panned": other, "best": snapshot}
    monkeypatch.setattr(backgrounds, "snapshot_designs", lambda search: found)
    monkeypatch.setattr(backgrounds, "optimise", lambda *given, **how: design)
    for each in background_gains(DIM):
        assert each.gain == pytest.approx(gain, abs=1e-4)
        assert each.camera is (design if is_design else snapshot)


@pytest.mark.parametrize(
    "scene",
    [
        Scene([0.0], photon_rate=2e4, read_noise=9.0),
        Scene([900.0], photon_rate=2e4, read_noise=9.0, decoder_speed="found"),
        Scene([900.0], photon_rate=2e4, read_noise=9.0, occlusion=Occlusion(front_share=0.4)),
    ],
    ids=["nothing moves", "the speed is found", "the scene says it"],
)
def test_there_are_none_of_other_worlds(scene):
    """A scene that says which world it is of has no other beside it."""
    assert background_gains(scene) == ()
    assert background_line(()) == ""


def test_the_line_says_which_world():
    """Gains are told in decibels, those too small to count as none, in lines as a verdict's."""
    gains = [BackgroundGain(0.5, 0.414), BackgroundGain(0.7, 0.004)]
    assert background_line(tuple(gains)) == (
        "This is for a picture that moves as a whole. For objects that move before a\n"
        "background, a camera designed for them gains 0.41 dB where half of the picture\n"
        "stands still and nothing where 70% stands still."
    )
