"""Noise by photon transfer, against clips of photographs whose noise is known."""

import io
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage
from support.clips import ClipOf, Thing

from mishutter.measurement.clip import Clip, clip_of
from mishutter.measurement.measurement import noise_from
from mishutter.measurement.noise import _black_of
from mishutter.measurement.signs import too_few

THINGS = (
    Thing((70, 80), (38, 46), (190.0, 310.0)),
    Thing((120, 150), (40, 36), (-150.0, 240.0), "chelsea.png"),
)
CLIP = ClipOf(THINGS, size=(192, 224), background="camera.png", electrons=3100.0, read_noise=4.3)
LEVELS = CLIP.levels()
UNCOMPRESSED = "no compression"


def found(levels=LEVELS, clip=CLIP, **told):
    """The clip and its noise."""
    return noise_from(clip_of(levels, 50.0, 4e-3, float(clip.full)), **told)


def holds(estimate, truth, share):
    """Whether a number is within a share of the truth, and within three of its errors."""
    near = abs(estimate.value - truth) < min(share * truth, 3 * estimate.error)
    return near and estimate.error < share * truth


@pytest.mark.parametrize("told", [{"dark": CLIP.dark()}, {"dark": CLIP.dark(1)}, {"black": 64.0}])
def test_electrons_and_read_noise_are_found(told):
    """Though objects move over a third of the picture; black from dark frames, or told."""
    _, noise = found(**told)
    assert holds(noise.electrons_at_white, 3100, 0.05)
    assert holds(noise.read_noise, 4.3, 0.15)
    assert abs(noise.black.value - 64) < 0.2
    assert not noise.refusals
    gain = noise.gain.error / noise.gain.value
    of_black = noise.black.error / (CLIP.full - noise.black.value)
    value, error = noise.electrons_at_white
    assert error == pytest.approx(value * np.hypot(gain, of_black))
    if "one dark frame" in noise.sources[1]:  # a tenth of it may be fixed pattern
        value, error = noise.read_noise
        assert error == pytest.approx(value * np.hypot(0.1, gain))


def test_without_black_the_read_noise_is_an_interval():
    """Which holds the truth, and whose ends are those of black."""
    _, noise = found()
    low, high = noise.read_noise_range
    assert low < 4.3 < high + 0.3
    assert noise.black is None
    assert noise.read_noise == pytest.approx(((low + high) / 2, (high - low) / 4))
    assert noise.black_level == pytest.approx(np.mean(noise.black_range))
    least, most = noise.black_range
    assert least <= 64 <= most + 1
    # No noise has a square below 0, and no black lies above the darkest block.
    assert least == pytest.approx(max(0.0, -noise.law.dark / noise.gain.value))
    assert low == pytest.approx(0, abs=0.7) or least == 0
    of_black = (most - least) / np.sqrt(12) / (CLIP.full - (most + least) / 2)
    value, error = noise.electrons_at_white
    gain = noise.gain.error / noise.gain.value
    assert error == pytest.approx(value * np.hypot(gain, of_black))
    assert "--dark" in noise.sources[1]


def test_dark_frames_tell_black_as_well_as_they_agree():
    """Of two whose means are two levels apart, at steps of 4; a hot pixel counts in neither."""
    random = np.random.default_rng(3)
    dark = 64 + 9 * random.normal(size=(2, 60, 70)) + np.array([-1.0, 1.0])[:, None, None]
    dark[:, 3, 5] = 4000
    clip = Clip(LEVELS[:2].astype(np.float32), 50.0, None, 4095.0, 4.0, (-np.inf, np.inf))
    known, source, _, refusals = _black_of(clip, dark.astype(np.float32), None)
    assert known.value == pytest.approx(64, abs=0.3)
    assert known.error == pytest.approx(np.hypot(1 / np.sqrt(2), 0.04), rel=0.15)
    assert (source, refusals) == ("2 dark frames", [])


def test_eight_bits_tell_the_electrons_and_not_the_read_noise():
    """Which is below half a step: the limit is said, and what to do."""
    clip = replace(CLIP, bits=8, electrons=9000.0)
    _, noise = found(clip.levels(), clip, black=float(clip.black_level))
    assert holds(noise.electrons_at_white, 9000, 0.1)
    assert noise.read_noise is None
    assert "below half a step of the file, 17." in noise.refusals[0].text
    assert "more bits" in noise.refusals[0].remedy


def test_pairs_of_flat_fields_are_better_than_the_clip():
    """As EMVA 1288 takes them; a pattern of the pixels is in both frames and counts nothing."""
    _, alone = found(dark=CLIP.dark())
    _, noise = found(dark=CLIP.dark(), flats=CLIP.flats())
    assert holds(noise.electrons_at_white, 3100, 0.05)
    assert noise.electrons_at_white.error < alone.electrons_at_white.error
    assert "8 flat frames" in noise.sources[0]


def test_flat_fields_tell_the_noise_of_a_clip_in_which_all_moves():
    """Which alone is refused: nothing of it shows noise."""
    ways = ((1, 1), (1, -1), (-1, 1), (-1, -1))
    moving = np.stack([LEVELS[k][::down, ::across] for k, (down, across) in enumerate(ways)])
    (refusal,) = found(moving)[1].refusals
    assert "too little of the clip stands still" in refusal.text
    _, noise = found(moving, dark=CLIP.dark(), flats=CLIP.flats())
    assert holds(noise.electrons_at_white, 3100, 0.05)
    assert holds(noise.read_noise, 4.3, 0.15)


def test_objects_that_pass_are_no_drift_of_the_exposure():
    """A third of a dim picture of little contrast brightens and darkens; all else stays."""
    things = tuple(replace(thing, photograph="rocket.jpg") for thing in THINGS)
    clip = replace(CLIP, things=things, background="microaneurysms.png", electrons=9100.0)
    frames, noise = found(clip.levels(), clip, dark=clip.dark())
    assert not any("drifts" in word for word in frames.words)
    assert holds(noise.electrons_at_white, 9100, 0.1)


def test_an_exposure_that_drifts_is_divided_out():
    """And said; the electrons are those of the usual exposure."""
    clip = replace(CLIP, flicker=0.04)
    frames, noise = found(clip.levels(), clip, dark=clip.dark())
    assert holds(noise.electrons_at_white, 3100, 0.1)
    (word,) = (word for word in frames.words if "drifts" in word)
    assert "divided out" in word
    assert not any("drifts" in word for word in found()[0].words)


def jpeg(frame, quality):
    content = io.BytesIO()
    Image.fromarray(frame).save(content, "JPEG", quality=quality)
    return np.asarray(Image.open(content))


EIGHT = replace(CLIP, bits=8, electrons=1000.0)
LIGHT = replace(CLIP, bits=16, black=0.0).levels() / 65535


def compressed(quality):
    return np.stack([jpeg(frame, quality) for frame in EIGHT.levels()])


def repeating():
    """Half of the pixels keep their level, as those that a video does not send again."""
    levels = EIGHT.levels()
    rng = np.random.default_rng(8)
    for k in range(1, len(levels)):
        skipped = rng.random(levels[k].shape) < 0.5
        levels[k][skipped] = levels[k - 1][skipped]
    return levels


def smoothed():
    levels = EIGHT.levels().astype(float)
    return np.rint((levels + np.roll(levels, 1, -1)) / 2).astype(np.uint8)


def bent():
    """A sensor that saturates softly above a third of white, as no gamma does."""
    light = np.broadcast_to(np.linspace(60, 3600, 224), (8, 192, 224))
    electrons = np.random.default_rng(6).poisson(light)
    return np.rint(electrons - 0.3 * np.maximum(electrons - 1300, 0)).astype(np.uint16)


def flat_scene():
    rng = np.random.default_rng(3)
    light = rng.uniform(900, 1100, (192, 224))
    return np.stack([rng.poisson(light) for _ in range(6)]).astype(np.uint16)


def dark_scene():
    levels = LEVELS.astype(int) - 4000
    return np.clip(levels, 0, None).astype(np.uint16)


def bright_scene():
    levels = np.clip(LEVELS.astype(int) * 90, 0, CLIP.full).astype(np.uint16)
    levels[:, :9, :9] = LEVELS[:, :9, :9]  # no two frames are equal
    return levels


def still_levels():
    """Noise of a tenth of a step at white."""
    clip = replace(CLIP, bits=8, electrons=3e6, things=())
    levels = clip.levels()
    levels[::2, 0, 0] += 1  # no two frames are equal
    return levels


SIGNS = {
    "JPEG 95": (lambda: compressed(95), "steps of 8 x 8 px", UNCOMPRESSED),
    "JPEG 98": (lambda: compressed(98), "steps of 8 x 8 px", UNCOMPRESSED),
    "JPEG 100": (lambda: compressed(100), "steps of 8 x 8 px", UNCOMPRESSED),
    "JPEG 100, cut": (lambda: compressed(100)[:, 3:, 6:], "steps of 8 x 8 px", UNCOMPRESSED),
    "JPEG 80": (lambda: compressed(80), "correlates by", "Record raw frames"),
    "repeats": (repeating, "of the pixels at rest repeat from frame to frame", UNCOMPRESSED),
    "neighbours": (smoothed, "noise of neighbouring pixels correlates by 0.", "raw frames"),
    "gamma 2.2": (
        lambda: np.rint(255 * LIGHT ** (1 / 2.2)).astype(np.uint8),
        "gamma of 2.",
        "Switch gamma off",
    ),
    "a bend": (bent, "the variance over the mean is ", "proportional to light"),
    "one level": (flat_scene, "lie within a factor of 1", "bright and dark parts"),
    "black": (dark_scene, "of the picture is cut off at black", "Expose so that"),
    "white": (bright_scene, "of the picture is cut off at white", "Expose so that"),
    "steps": (still_levels, "smaller than the steps of the file", "more bits"),
}


@pytest.mark.parametrize("slug", SIGNS)
def test_a_sign_forbids_the_number(slug):
    """No number is given, but the reason and the remedy."""
    levels, reason, remedy = SIGNS[slug]
    _, noise = found(levels(), replace(CLIP, bits=8 if levels().dtype == np.uint8 else 12))
    assert noise.electrons_at_white is None
    assert noise.read_noise is None
    assert any(reason in r.reason and remedy in r.remedy for r in noise.refusals), noise.refusals


def test_a_whole_clip_has_no_sign():
    """Neither at 8 bits, nor where nothing moves."""
    assert not found(EIGHT.levels(), EIGHT)[1].refusals
    still = replace(CLIP, things=())
    assert not found(still.levels(), still)[1].refusals


def test_dark_frames_below_level_0_are_not_cut_off_there():
    """Black was taken off, in levels of either sign."""
    levels, dark = (each.astype(np.int16) - 64 for each in (LEVELS, CLIP.dark()))
    _, noise = noise_from(clip_of(levels, 50.0, 4e-3, CLIP.full - 64.0), dark=dark)
    assert not noise.refusals
    assert noise.black.value == pytest.approx(CLIP.black_level - 64, abs=3 * noise.black.error)
    assert holds(noise.read_noise, 4.3, 0.2)


def test_dark_frames_that_are_cut_off_tell_no_black():
    """The camera's offset is too low for its noise, which the reason says."""
    clip = replace(CLIP, black=0.0)
    _, noise = found(clip.levels(), clip, dark=clip.dark())
    assert noise.black is None
    assert "dark frames are cut off at their lowest level" in noise.refusals[0].text
    assert noise.read_noise_range is not None


@pytest.mark.parametrize("bits", [8, 12, 16])
@pytest.mark.parametrize("name", ["page.png", "rocket.jpg"])
def test_uncompressed_photographs_have_no_sign(name, bits):
    """Whose edges lie where they like, and whose noise is that of their light alone."""
    clip = replace(CLIP, background=name, bits=bits, electrons=2100.0, num_frames=5)
    assert not found(clip.levels(), clip)[1].refusals


def coded(gamma, **others):
    """Levels of 8 bits that are a power of the light."""
    clip = replace(CLIP, bits=16, black=0.0, **others)
    return np.rint(255 * (clip.levels() / 65535) ** (1 / gamma)).astype(np.uint8)


def test_a_gamma_of_one_and_a_half_is_refused_where_noise_shows_it():
    """By the curve, of more frames than a few; the same clip without it has a number."""
    still = {"things": (), "background": "coffee.png", "num_frames": 16}
    still |= {"electrons": 9000.0, "read_noise": 12.0}
    _, noise = found(coded(1.5, **still), EIGHT)
    assert noise.electrons_at_white is None
    (refusal,) = noise.refusals
    assert "gamma of 1." in refusal.reason
    straight = replace(EIGHT, **still)
    assert found(straight.levels(), straight)[1].electrons_at_white is not None


def test_a_gamma_without_read_noise_is_doubted():
    """A gamma of 1.5 is as straight as a line of much read noise: the clip's words say so."""
    frames, noise = found(coded(1.5), EIGHT)
    assert noise.electrons_at_white is None or "a gamma of 1." in frames.words[-1]
    assert not any("gamma" in word for word in found()[0].words)


STILL = replace(CLIP, things=(), num_frames=7)
LIT = STILL.exposed(0.0)


def recorded(pictures, seed=5, clip=STILL):
    rng = np.random.default_rng(seed)
    return np.stack([clip.recorded(np.clip(each, 0, 1), rng) for each in pictures])


def is_right(noise):
    """Whether the numbers are those of the camera, within three errors and 5 and 15 %."""
    return holds(noise.electrons_at_white, 3100, 0.05) and holds(noise.read_noise, 4.3, 0.15)


@pytest.mark.parametrize("share", [0.15, -0.3])
def test_noise_reduction_over_time_is_refused(share):
    """Frames that hold a share of the one before them are less unlike it than those after that.

    Where change over time is enhanced they are more unlike it.
    """
    frames = [each.astype(float) for each in recorded([LIT] * 14)]
    for k in range(1, len(frames)):
        frames[k] = (1 - share) * frames[k] + share * frames[k - 1]
    _, noise = found(np.rint(frames[7:]).astype(np.uint16), dark=STILL.dark())
    assert noise.electrons_at_white is None
    assert any("denoising over time" in each.reason for each in noise.refusals)
    assert is_right(found(recorded([LIT] * 14), dark=STILL.dark())[1])


@pytest.mark.parametrize(
    "gains", [np.linspace(0.5, 1, 7), np.array([1, 0.54, 0.84, 0.74, 0.6, 0.75, 0.78])]
)
def test_a_lamp_that_warms_up_or_flashes_changes_no_number(gains):
    """A frame that is divided by its exposure has more noise where that is short."""
    frames, noise = found(recorded([gain * LIT for gain in gains]), dark=STILL.dark())
    assert is_right(noise)
    assert any("exposure drifts" in word for word in frames.words)


def test_what_is_stuck_changes_no_number():
    """Rows at 0 and at white, a column, and a bar of white; the dark frames have them too."""

    def stuck(frames):
        frames = frames.copy()
        frames[:, 50:53], frames[:, 120:124] = 0, CLIP.full
        frames[:, :, 77] = 500
        frames[:, 8:40, 150:190] = CLIP.full
        return frames

    _, noise = found(stuck(recorded([LIT] * 7)), dark=stuck(STILL.dark()))
    assert is_right(noise)
    assert abs(noise.black.value - 64) < 0.1
    (alone,) = (found(stuck(recorded([LIT] * 7)), dark=stuck(STILL.dark(1)))[1],)
    assert is_right(alone)


@pytest.mark.parametrize("shake", [0.05, 0.2])
def test_a_shaking_camera_changes_no_number(shake):
    """Its motion is taken out, which is said; the errors grow by what that may leave."""
    moves = shake * np.random.default_rng(2).normal(size=(7, 2))
    pictures = [ndimage.shift(LIT, move, order=3, mode="nearest") for move in moves]
    frames, noise = found(recorded(pictures), dark=STILL.dark())
    assert abs(noise.electrons_at_white.value - 3100) < 2 * noise.electrons_at_white.error
    assert abs(noise.read_noise.value - 4.3) < 2 * noise.read_noise.error
    assert noise.electrons_at_white.error < 0.05 * 3100
    (word,) = (word for word in frames.words if "shakes" in word)
    size = np.sqrt(np.mean(np.sum((moves - moves.mean(axis=0)) ** 2, axis=1)))
    assert float(word.split()[4]) == pytest.approx(size, rel=0.15)
    assert not any("shakes" in word for word in found()[0].words)


def test_edges_that_move_are_no_gamma():
    """A camera that rolls by a third of a degree makes noise of edges, which is doubted."""
    angles = 0.3 * np.random.default_rng(2).normal(size=7)
    pictures = [ndimage.rotate(LIT, a, reshape=False, order=3, mode="nearest") for a in angles]
    frames, noise = found(recorded(pictures), dark=STILL.dark())
    assert noise.refusals or "noise is too high" in " ".join(frames.words)
    assert all("gamma" not in each.text for each in noise.refusals)


def test_a_focus_that_drifts_is_said():
    """By how much blur changes over the clip."""
    pictures = [ndimage.gaussian_filter(LIT, 0.1 * k) for k in range(7)]
    frames, noise = found(recorded(pictures), dark=STILL.dark())
    assert any("focus drifts by 0.59 px" in word for word in frames.words)
    assert all("denoising" not in each.text for each in noise.refusals)
    assert not any("focus" in word for word in found()[0].words)


@pytest.mark.parametrize("name", ["brick.png", "coins.png", "cell.png"])
def test_a_picture_that_pans_tells_no_exposure(name):
    """Other detail comes into each place, which is no drift of the lamp."""
    clip = ClipOf((Thing((96, 112), (900, 900), (60.0, 200.0), name),), (192, 224), name)
    assert not any("drifts" in word for word in found(clip.levels(), clip)[0].words)


@pytest.mark.parametrize(("most", "read_noise"), [(9000, 60), (900, 8), (3000, 20)])
def test_a_sensor_of_two_gains_is_told_no_gamma(most, read_noise):
    """Its bright part has more read noise, by which the variance leaps; be they few electrons."""
    rng = np.random.default_rng(4)
    light = np.broadcast_to(np.linspace(most / 150, most, 224), (8, 192, 224))
    electrons = rng.poisson(light)
    noises = np.where(electrons < most / 3, 2, read_noise)
    noisy = electrons + noises * rng.normal(size=light.shape)
    _, noise = found(np.rint(100 + 4 * noisy).clip(0).astype(np.uint16), black=100.0)
    (refusal,) = noise.refusals
    assert "two gains" in refusal.reason
    assert "gamma" not in refusal.text


@pytest.mark.parametrize(
    ("deviation", "whole", "words"),
    [(0.29, 1.0, "smaller than the steps"), (0.31, 1.0, "stands still"), (0.29, 0.05, "cut off")],
)
def test_noise_below_three_tenths_of_a_step_is_hidden_by_it(deviation, whole, words):
    """Beside that of rounding, a twelfth of its square; of a picture that is not cut off."""
    clip = Clip(np.zeros((2, 16, 16), np.float32), 50.0, None, 255.0, 4.0, (0.0, 255.0))
    refusal = too_few(clip, whole, 16 * (deviation**2 + 1 / 12))
    assert words in " ".join(map(str, refusal))
