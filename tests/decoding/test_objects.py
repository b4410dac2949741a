"""Several things before a background, restored object by object from frames of a sensor at rest."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage
from support.moving_things import Thing, decibels, frames_of, shown, texture

import mishutter as ms
from mishutter.decoding.objects.arrangement import Arrangement
from mishutter.decoding.objects.arrangement import Thing as Found
from mishutter.decoding.objects.candidates import candidates
from mishutter.decoding.objects.composite import Alone, composite, labels_of, trusted
from mishutter.decoding.objects.finding import found_in, put_in_order
from mishutter.decoding.objects.grids import moved
from mishutter.decoding.objects.light import WEAK, Knowledge, Misfit, Sight, _sheet, light_of
from mishutter.decoding.objects.mattes import Mixed, settle
from mishutter.decoding.objects.outlines import cut_out, given_others, sharpen
from mishutter.decoding.objects.restored import _instants_of as instants_of
from mishutter.decoding.objects.restored import knowledge_of
from mishutter.decoding.objects.stills import Stills
from mishutter.decoding.objects.velocities import refine_velocity
from mishutter.pictures.registration.windows import Window, splines

RATE, READ_NOISE, FASTEST = 1e5, 8.0, 900.0
TIMES = np.array([-0.03, -0.01, 0.01, 0.03])
EXPOSURES = np.full(4, 0.004)


def ground(seed=5, size=128):
    return texture(np.random.default_rng(seed), size)


def thing(seed, centre, radius, velocity, light=None):
    own = texture(np.random.default_rng(seed), 96, 0.45) if light is None else light
    return Thing(own, centre, radius, velocity)


def stills(frames, times=TIMES, exposures=EXPOSURES):
    electrons = RATE * np.asarray(exposures)
    light = np.asarray(frames, np.float32)
    return Stills(light, times, exposures, electrons, READ_NOISE, FASTEST, (True, True))


def plane_frames(times=TIMES, exposures=EXPOSURES):
    duration = times[-1] - times[0] + (exposures[0] + exposures[-1]) / 2
    return ms.PlaneFrames(
        times=times - times[0] + exposures[0] / 2,
        exposures=exposures,
        durations=np.array([duration]),
        velocities=np.zeros((2, 2)),
    )


def in_any_direction(**others):
    others = {"photon_rate": RATE, "read_noise": READ_NOISE} | others
    return ms.Scene.any_direction(FASTEST, **others)


TWO = (
    thing(7, (52.3, 44.1), 23.0, (310.0, -240.0)),
    thing(8, (80.6, 88.2), 20.0, (-150.0, 420.0)),
)


def crossing():
    """Two things that overlap at the time 0, the second in front."""
    return (
        thing(7, (46.3, 34.1), 15.0, (310.0, -240.0)),
        thing(8, (50.6, 54.2), 17.0, (-150.0, 420.0)),
    )


def arrangement_of(things, order):
    """Their frames of 96 x 112 px, with the outlines and velocities that they have."""
    behind = ground(size=112)[:96]
    frames = frames_of(behind, things, TIMES, EXPOSURES, np.random.default_rng(3))
    known = []
    for one in things:
        matte = shown(behind, [one], 0.0)[1][0].astype(np.float32)
        known.append(Found(np.array(one.velocity), matte, np.array(one.velocity), 20.0))
    return Arrangement(stills(frames), known, list(order))


@pytest.fixture(scope="module")
def two():
    """Frames of two things, and the picture in the middle."""
    random = np.random.default_rng(3)
    return frames_of(ground(), TWO, TIMES, EXPOSURES, random), shown(ground(), TWO, 0.0)


def test_part_of_a_picture_moves_by_parts_of_a_pixel():
    """A spline at displaced pixels, and its way back, are those of a smooth function."""
    down, across = np.mgrid[:40, :50]
    wave = np.sin(0.2 * down) * np.cos(0.15 * across)
    window = Window(8, 9, 20, 22)
    taken = window.taken(splines(wave[None])[0], np.array([1.3, -2.6]), is_spline=True)
    wanted = window.of(np.sin(0.2 * (down + 1.3)) * np.cos(0.15 * (across - 2.6)))
    np.testing.assert_allclose(taken, wanted, atol=2e-4)
    put = moved(window.of(wave), window, np.array([1.3, -2.6]), wave.shape)
    inner = Window(12, 9, 14, 12)
    wanted = np.sin(0.2 * (down - 1.3)) * np.cos(0.15 * (across + 2.6))
    np.testing.assert_allclose(inner.of(put), inner.of(wanted), atol=0.02)


@pytest.mark.slow
def test_two_things_are_found_with_their_velocities_and_outlines(two):
    """Both velocities are within three errors, both mattes within a pixel of their outlines."""
    frames, (_, mattes) = two
    found = found_in(stills(frames))
    assert len(found.things) == 2
    alphas = found.alphas()
    for each, matte in zip(TWO, mattes, strict=True):
        near = min(range(2), key=lambda n: np.hypot(*(found.things[n].velocity - each.velocity)))
        own = found.things[near]
        apart = own.velocity - np.array(each.velocity)
        assert apart @ np.linalg.solve(own.covariance, apart) < 3**2 * 2
        outline = 2 * np.pi * each.radius
        assert np.sum(np.abs(alphas[near + 1] - matte)) < outline


@pytest.mark.slow
def test_a_thing_without_texture_is_told_by_its_outline():
    """A flat disc before a textured background is found, and its error is honest."""
    disc = thing(0, (60.2, 70.7), 26.0, (-180.0, 260.0), np.full((96, 96), 0.2))
    for seed in (11, 12):
        frames = frames_of(ground(), [disc], TIMES, EXPOSURES, np.random.default_rng(seed))
        (own,) = found_in(stills(frames)).things
        apart = own.velocity - np.array(disc.velocity)
        assert np.hypot(*apart) < 5
        assert apart @ np.linalg.solve(own.covariance, apart) < 4**2 * 2


def test_a_velocity_is_refined_where_frames_are_half_a_stroke_out_of_place():
    """The mean of frames out of place has too little slope: whole steps by it would swing."""
    blocks = np.random.default_rng(2).choice([0.2, 0.7], (24, 24))
    page = thing(0, (60.0, 66.0), 30.0, (310.0, -115.0), np.kron(blocks, np.ones((4, 4))))
    frames = frames_of(ground(), [page], TIMES, EXPOSURES, np.random.default_rng(13))
    matte = shown(ground(), [page], 0.0)[1][0].astype(np.float32)
    for off in ((12.0, 18.0), (0.0, -30.0)):
        start = np.array(page.velocity) + off
        own = Found(start, matte, start.copy(), 20.0)
        refine_velocity(Arrangement(stills(frames), [own], [0]), 0, None)
        np.testing.assert_allclose(own.velocity, page.velocity, atol=1.0)


def test_an_outline_keeps_what_is_as_dark_as_the_background():
    """Dark bars that reach it before a dark background stay, however often it is solved."""
    bars = np.where(np.arange(96) % 12 < 5, 0.1, 0.6) * np.ones((96, 1))
    one = thing(0, (60.0, 62.0), 30.0, (340.0, 420.0), bars)
    dark = 0.15 + 0.05 * (ground() - 0.35)
    frames = frames_of(dark, [one], TIMES, EXPOSURES, np.random.default_rng(4))
    truth = shown(dark, [one], 0.0)[1][0].astype(np.float32)
    velocity = np.array(one.velocity)
    found = Arrangement(stills(frames), [Found(velocity, truth, velocity, 1.0)], [0])
    for _ in range(6):
        sharpen(found, [truth])
        found.place()
    # of 2,830 pixels and an outline of 190
    assert np.abs(found.things[0].matte - truth).sum() < 200


def test_outlines_are_settled_by_light_that_is_freed_of_blur():
    """Bars hardly wider than the way within an exposure: by blurred light they are further off."""
    bars = np.where(np.arange(96) % 9 < 4, 0.15, 0.8) * np.ones((96, 1))
    one = thing(0, (60.0, 62.0), 26.0, (640.0, 620.0), bars)
    frames = frames_of(ground(), [one], TIMES, EXPOSURES, np.random.default_rng(4))
    truth = shown(ground(), [one], 0.0)[1][0].astype(np.float32)
    velocity, own = np.array(one.velocity), stills(frames)
    found = Arrangement(own, [Found(velocity, truth, velocity, 1.0)], [0])
    for _ in range(2):
        sharpen(found, [truth])
        found.place()
    before = np.abs(found.things[0].matte - truth).sum()
    settle(found, knowledge_of(in_any_direction(), own, in_plane=True))
    after = np.abs(found.things[0].matte - truth).sum()
    # of an outline of 163 px
    assert after < 0.8 * before


def test_velocities_are_told_by_frames_of_unlike_exposures():
    """Within their errors, where the frames along a thing differ by its blur as well."""
    exposures = np.array([0.02, 0.003, 0.02, 0.003])
    frames = frames_of(ground(), TWO, TIMES, exposures, np.random.default_rng(4))
    _, mattes = shown(ground(), TWO, 0.0)
    own, off = stills(frames, exposures=exposures), np.array([9.0, -12.0])
    things = []
    for one, matte, sign in zip(TWO, mattes, (1, -1), strict=True):
        velocity = np.array(one.velocity) + sign * off
        things.append(Found(velocity, matte.astype(np.float32), velocity.copy(), 20.0))
    found, known = (
        Arrangement(own, things, [1, 0]),
        knowledge_of(in_any_direction(), own, in_plane=True),
    )
    settle(found, known)
    assert np.array_equal(found.things[0].velocity, found.things[0].first)
    settle(found, known, are_told=False)
    for one, thing in zip(TWO, found.things, strict=True):
        apart = thing.velocity - np.array(one.velocity)
        assert np.hypot(*apart) < 2
        assert apart @ np.linalg.solve(thing.covariance, apart) < 3**2 * 2


def test_light_and_an_outline_explain_a_change_of_the_frames_together():
    """What both make is explained, though each alone would leave much of it, and noise is not."""
    found, random = arrangement_of(crossing(), [1, 0]), np.random.default_rng(3)
    known = knowledge_of(in_any_direction(), found.stills, in_plane=True)
    misfit = Misfit.of(Sight.of(found.stills, found, known))
    mixed = Mixed.of(found, misfit, light_of(misfit, ms.EnsembleDecoder()), 1)
    lights = [
        0.05 * ndimage.gaussian_filter(random.normal(size=s.size), 2) for s in misfit.sight.sheets
    ]
    matte = np.where(mixed.near, 0.2 * random.normal(size=mixed.near.shape), 0).astype(np.float32)
    light = misfit.sight.frames([one.astype(np.float32) for one in lights])
    outline = mixed.frames(matte) - mixed.frames(np.zeros_like(matte))

    def share(change, left):
        return np.sum(misfit.sight.inverse * left**2) / np.sum(misfit.sight.inverse * change**2)

    change = light + outline
    assert share(change, mixed.unexplained(misfit, change)) < 0.02
    target = misfit.sight.layers(misfit.sight.inverse * change)
    by_light = misfit.sight.frames(misfit.likeliest(target, WEAK))
    assert share(change, change - by_light) > 0.04
    noise = random.normal(size=change.shape).astype(np.float32)
    left = mixed.unexplained(misfit, noise)
    assert 0.6 < share(noise, left) < 0.8


@pytest.mark.slow
def test_things_that_move_nearly_alike_are_two_where_they_lie_apart():
    """Two whose velocities differ by 3 px over the frames, less than the first look tells."""
    alike = (
        thing(7, (38.0, 40.0), 20.0, (250.0, -300.0)),
        thing(8, (90.0, 84.0), 20.0, (290.0, -270.0)),
    )
    frames = frames_of(ground(), alike, TIMES, EXPOSURES, np.random.default_rng(5))
    found = found_in(stills(frames)).things
    assert len(found) == 2
    for one in alike:
        away = [np.hypot(*(own.velocity - one.velocity)) for own in found]
        assert min(away) < 8


def test_what_one_frame_alone_shows_is_told_by_the_layer_about_it():
    """A strip that goes on as a flat layer does is likely, another light in it is not."""
    random, seen = np.random.default_rng(14), np.ones((3, 40, 60))
    light = np.where(np.arange(60) < 30, 0.5, np.arange(60) % 7 / 6) * np.ones((40, 1))
    frames = light + random.normal(0, 0.03, (3, 40, 60))
    seen[1:, :, 10:16] = 0
    other = frames.copy()
    other[0, :, 10:16] += 0.2
    likely, unlikely = (
        given_others(stills(each, TIMES[:3], EXPOSURES[:3]), each, seen).logarithms[0]
        for each in (frames, other)
    )
    strip = np.s_[8:-8, 11:15]
    assert np.mean((likely - unlikely)[strip]) > 1.2
    assert np.mean(likely[strip]) > -1
    # Where the layer has texture, its neighbourhood tells little.
    seen[1:, :, 40:46] = 0
    textured = given_others(stills(frames, TIMES[:3], EXPOSURES[:3]), frames, seen).logarithms[0]
    assert np.mean(textured[8:-8, 41:45]) < -1.5


def test_nothing_is_found_where_nothing_moves():
    """Noise makes no objects."""
    random = np.random.default_rng(4)
    frames = frames_of(ground(), [], TIMES, EXPOSURES, random)
    assert candidates(stills(frames)).things == []


def test_slow_and_touching_things_are_candidates():
    """One that goes 3 px in all, and two side by side, each within 1.5 px over the frames."""
    slow = [thing(7, (64.0, 64.0), 26.0, (40.0, -30.0))]
    beside = [
        thing(8, (64.0, 40.0), 24.0, (0.0, 150.0)),
        thing(9, (64.0, 88.0), 24.0, (90.0, 150.0)),
    ]
    for things in (slow, beside):
        frames = frames_of(ground(), things, TIMES, EXPOSURES, np.random.default_rng(4))
        found = candidates(stills(frames)).things
        for each in things:
            away = [np.hypot(*(own.velocity - each.velocity)) * 0.06 for own in found]
            assert min(away, default=9.0) < 1.5


@pytest.mark.slow
def test_the_picture_is_far_better_than_that_of_one_frame(two):
    """The linear picture is 3 dB above the frame's, and what is trusted is right."""
    frames, (truth, _) = two
    scene = in_any_direction(objects=ms.Objects(width=40.0))
    found = ms.restore_frames(frames, scene, plane_frames())
    alone = plane_frames(TIMES[1:2], EXPOSURES[1:2])
    one = ms.restore_frames(frames[1:2], in_any_direction(), alone, speed=np.zeros(2))
    single = shown(ground(), TWO, TIMES[1])[0]
    assert decibels(found.light, truth) > decibels(one.light, single) + 3
    assert [each.trusted for each in found.objects] == [True, True]
    error = np.abs(np.asarray(found.light) - truth)
    noise = np.sqrt(truth / (RATE * 0.004) + (READ_NOISE / (RATE * 0.004)) ** 2)
    assert np.mean(np.asarray(found.trust)) > 0.8
    assert np.mean(error[found.trust] > 3 * noise[found.trust]) < 0.01
    assert found.labels is not None
    assert set(np.unique(found.labels)) == {0, 1, 2}
    # To the left and up, as speeds of the package are.
    speeds = sorted(float(each.velocity[0]) for each in found.objects)
    np.testing.assert_allclose(speeds, [-420.0, 240.0], atol=6)


@pytest.mark.slow
@pytest.mark.parametrize("decoder", [ms.EnsembleDecoder(), ms.TotalVariationDecoder()])
def test_what_turns_is_as_good_as_in_the_one_frame(decoder):
    """No picture, and no window of 32 px that is trusted, is worse than by the middle frame."""
    times = np.array([-0.04, -0.02, 0.0, 0.02, 0.04])
    exposures = np.full(5, 0.004)
    light = texture(np.random.default_rng(9), 96, 0.45)
    turning = Thing(light, (64.0, 64.0), 26.0, (90.0, 210.0), lobes=0.25, turn=12.0)
    frames = frames_of(ground(), [turning], times, exposures, np.random.default_rng(6))
    truth = shown(ground(), [turning], 0.0)[0]
    scene = in_any_direction(objects=ms.Objects(width=40.0))
    found = ms.restore_frames(frames, scene, plane_frames(times, exposures), decoder=decoder)
    alone = plane_frames(times[2:3], exposures[2:3])
    taken = [frames[2]]
    one = ms.restore_frames(taken, in_any_direction(), alone, decoder=decoder, speed=[0.0, 0.0])
    trust = np.asarray(found.trust)
    assert decibels(found.light, truth) > decibels(one.light, truth) + 1
    worst = [
        decibels(found.light[part][own], truth[part][own])
        - decibels(one.light[part][own], truth[part][own])
        for down in range(0, 97, 16)
        for across in range(0, 97, 16)
        for part in [np.s_[down : down + 32, across : across + 32]]
        for own in [trust[part]]
        if own.mean() > 0.5
    ]
    assert len(worst) > 10
    assert min(worst) > -1


def test_an_outline_is_where_a_thing_is_at_the_time_0():
    """Though all frames are later: in the first it is 20 px further down and 15 to the left."""
    one = thing(7, (52.0, 70.0), 23.0, (400.0, -300.0))
    times = np.array([0.05, 0.07, 0.09])
    frames = frames_of(ground(), [one], times, EXPOSURES[:3], np.random.default_rng(3))
    found = candidates(stills(frames, times, EXPOSURES[:3]))
    matte = max(found.things, key=lambda each: each.area).matte
    place = [np.average(each, weights=matte) for each in np.indices(matte.shape)]
    assert place == pytest.approx(one.centre, abs=6)


@pytest.mark.parametrize("velocity", [(600.0, 0.0), (0.0, 600.0)])
def test_a_layer_is_blurred_along_its_way(velocity):
    """Over 3 px in the short frame and 9 in the long one, and not across it."""
    own = stills(np.full((2, 40, 56), 0.3), np.array([-0.01, 0.02]), np.array([0.005, 0.015]))
    matte = np.zeros((40, 56), np.float32)
    matte[15:25, 20:40] = 1
    known = Knowledge(lambda size: np.ones((size[0], size[1] // 2 + 1)), lambda size: np.ones(()))
    sheet = _sheet(own, matte, np.array(velocity), known)
    down, across = np.fft.fftfreq(sheet.size[0])[:, None], np.fft.rfftfreq(sheet.size[1])
    for response, way in zip(sheet.responses, (3.0, 9.0), strict=True):
        along = down + 0 * across if velocity[0] else across + 0 * down
        np.testing.assert_allclose(np.abs(response), np.abs(np.sinc(way * along)), atol=1e-5)


@pytest.mark.parametrize("velocity", [(600.0, 250.0), (-150.0, 420.0)])
def test_parts_of_an_exposure_add_up_to_one_blur(velocity):
    """Of a sensor that moves at an even velocity, down as across, and a thing that does so too."""
    exposures, pan = np.array([0.008, 0.015]), np.array([-700.0, 1100.0])
    path = ms.PlaneFrames(
        times=np.array([0.01, 0.035]),
        exposures=exposures,
        durations=np.array([0.05]),
        velocities=np.repeat(pan[::-1, None], 2, axis=1),
    )
    middle = (0.006 + 0.0425) / 2  # of the light of all
    own = replace(
        stills(np.full((2, 72, 90), 0.3), path.times - middle, exposures),
        instants=instants_of(path, FASTEST),
    )
    assert len(own.parts) > 8
    matte = np.zeros((72, 90), np.float32)
    matte[25:45, 30:50] = 1
    known = Knowledge(lambda size: np.ones((size[0], size[1] // 2 + 1)), lambda size: np.ones(()))
    sheet = _sheet(own, matte, np.array(velocity), known)
    down, across = np.fft.fftfreq(sheet.size[0])[:, None], np.fft.rfftfreq(sheet.size[1])
    ways = own.ways(np.array(velocity)) - sheet.until
    for response, way, exposure in zip(sheet.of_frames, ways, exposures, strict=True):
        blur = (np.array(velocity) + pan) * exposure
        turns = down * way[0] + across * way[1]
        wanted = np.sinc(down * blur[0] + across * blur[1]) * np.exp(-2j * np.pi * turns)
        np.testing.assert_allclose(response, wanted, atol=1e-4)


@pytest.mark.parametrize("order", [[0, 1], [1, 0]])
def test_the_thing_whose_light_is_seen_where_two_overlap_is_in_front(order):
    """Of two discs that cross, the second hides the first, whichever was taken to do so."""
    found = arrangement_of(crossing(), order)
    put_in_order(found)
    assert found.order == [1, 0]


def test_outlines_of_things_that_cross_are_drawn_between_them():
    """From ones that lie 4 px aside; what is behind another is no likelier where that hides it."""
    found = arrangement_of(crossing(), [1, 0])
    truth = [one.matte.copy() for one in found.things]
    for one, matte in zip(found.things, truth, strict=True):
        one.matte = np.roll(matte, (3, -3), (0, 1))
    found.place()
    cut_out(found)
    errors = [float(np.abs(x.matte - m).sum()) for x, m in zip(found.things, truth, strict=True)]
    # of 707 pixels, a part of them hidden, and of 908
    assert errors[0] < 130
    assert errors[1] < 85


def test_the_misfit_of_layers_counts_what_the_frames_have_fitted():
    """Residuals of four frames about their own light have the mean square of three."""
    found = arrangement_of(crossing(), [1, 0])
    known = knowledge_of(in_any_direction(), found.stills, in_plane=True)
    misfit = Misfit.of(Sight.of(found.stills, found, known))
    layers = light_of(misfit, ms.EnsembleDecoder())
    alone = Alone.of(found.stills, known, ms.EnsembleDecoder())
    whole = composite(found, misfit, layers, alone)
    ground = (labels_of(found) == 0) & trusted(found, whole)
    assert np.sum(ground) > 8000
    assert np.mean(whole.misfit[ground]) == pytest.approx(1, abs=0.04)


def test_a_velocity_that_nothing_tells_stays_as_uncertain_as_it_was():
    """Within a grey thing no frame tells more than what was known before, 30 px/s."""
    frames = 0.3 + 0.03 * np.random.default_rng(6).normal(size=(4, 64, 72))
    matte = np.zeros((64, 72), np.float32)
    matte[20:50, 15:55] = 1
    first = np.array([120.0, -80.0])
    one = Found(first.copy(), matte, first, 30.0)
    refine_velocity(Arrangement(stills(frames), [one], [0]), 0, None)
    np.testing.assert_allclose(np.sqrt(np.diag(one.covariance)), 30.0, rtol=0.1)
    np.testing.assert_allclose(one.velocity, first, atol=10)


def test_a_thing_that_is_left_out_leaves_the_others_in_their_order():
    """Of three, the last in front: without the first, numbers fall and what hides what stays."""
    mattes = np.zeros((3, 40, 48), np.float32)
    for k, matte in enumerate(mattes):
        matte[8 + 4 * k : 24 + 4 * k, 10 : 20 + 8 * k] = 1
    things = [Found(np.zeros(2), matte, np.zeros(2), 30.0) for matte in mattes]
    every = Arrangement(stills(np.full((4, 40, 48), 0.3)), things, [2, 0, 1])
    seen = every.seen(1) + every.seen(0) * mattes[1]
    every.drop(0)
    assert every.order == [1, 0]
    assert every.behind(1) == [0]
    np.testing.assert_allclose(every.seen(0), seen, atol=1e-6)
    np.testing.assert_allclose(every.alphas()[1], mattes[1] * (1 - mattes[2]), atol=1e-6)
