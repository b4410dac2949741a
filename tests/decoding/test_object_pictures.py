"""From frames to things and back to what a user has: steps of `restore_frames` of several objects.

Rows, columns, exposures and velocities are unlike, and each turn of axes has its second case.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

import mishutter as ms
from mishutter.decoding.objects import finding
from mishutter.decoding.objects.arrangement import Arrangement, Thing
from mishutter.decoding.objects.candidates import _even, _velocities, within
from mishutter.decoding.objects.composite import (
    Alone,
    Composite,
    _blur,
    composite,
    labels_of,
    trusted,
)
from mishutter.decoding.objects.light import Knowledge, Misfit, Sight
from mishutter.decoding.objects.readout import Readout
from mishutter.decoding.objects.restored import (
    Known,
    _instants_of,
    _result,
    _told,
    _Whole,
    knowledge_of,
    stills_of,
)
from mishutter.decoding.objects.stills import Stills
from mishutter.evaluation.fans import picture_power_on
from mishutter.pictures.registration.windows import smoothed

TIMES, EXPOSURES = np.array([-0.02, 0.005, 0.03]), np.array([0.004, 0.012, 0.006])
RATE, READ_NOISE, SHAPE = 5e4, 6.0, (36, 44)
VELOCITIES = np.array([[-200.0, -120.0], [100.0, 160.0]])


def stills_with(light, times=TIMES, exposures=EXPOSURES, moves=(True, True)):
    light = np.asarray(light, np.float32)
    return Stills(light, times, exposures, RATE * exposures, READ_NOISE, 500.0, moves)


def textured(shape, seed=0):
    return 0.35 + 0.1 * smoothed(np.random.default_rng(seed).normal(size=shape), 1.0)


def block(rows, columns, shape=SHAPE):
    matte = np.zeros(shape, np.float32)
    matte[rows, columns] = 1
    return matte


def overlapping():
    """Two things, the second in front, whose mattes are clear in part."""
    mattes = 0.8 * block(np.s_[12:24], np.s_[10:26]), block(np.s_[16:28], np.s_[20:36])
    things = [Thing(v.copy(), m, v.copy(), 20.0) for v, m in zip(VELOCITIES, mattes, strict=True)]
    return Arrangement(stills_with(textured((3, *SHAPE))), things, [1, 0])


def at(picture, by, order=1, mode="nearest"):
    """A picture at its own pixels displaced."""
    return ndimage.shift(picture.astype(float), -np.asarray(by), order=order, mode=mode)


def test_a_picture_is_of_layers_and_of_the_frame_where_they_fail():
    """Each layer is replaced, where it is seen, by its own share of what the frame shows there."""
    found, random = overlapping(), np.random.default_rng(3)

    def flat(size):
        return np.full((size[0], size[1] // 2 + 1), 1e-3)

    sight = Sight.of(found.stills, found, Knowledge(flat, lambda size: 1 + 0 * flat(size)))
    misfit = Misfit.of(sight)
    layers = [
        0.35 + 0.1 * smoothed(random.normal(size=s.size), 2.0).astype(np.float32)
        for s in sight.sheets
    ]
    middle = found.stills.middle
    shown = sight.frames(layers)[middle]
    shown = shown + 0.7 * (found.stills.light[middle] - shown) + 0.02 * random.normal(size=SHAPE)
    alone = Alone(textured(SHAPE, 4), shown, np.zeros(SHAPE))
    whole = composite(found, misfit, layers, alone)
    lights = []
    for sheet, light in zip(sight.sheets, layers, strict=True):
        lights.append(np.zeros(SHAPE))
        sheet.window.add(lights[-1], light)
    doubt = alone.share(misfit, layers, _blur(found, [x.astype(np.float32) for x in lights]))
    assert 0.05 < np.mean(doubt) < 0.95
    seen = [found.ground, found.seen(0), found.seen(1)]
    wanted, single = np.zeros(SHAPE), np.zeros(SHAPE)
    inner = np.zeros(SHAPE, bool)
    inner[2:-2, 2:-2] = True  # Beyond its ends a spline goes on in another way
    for layer, alpha in enumerate(found.alphas()):
        velocity = VELOCITIES[layer - 1] if layer else np.zeros(2)
        way = velocity * TIMES[middle]
        inside = ndimage.shift(np.ones(SHAPE), -way, order=0, cval=0.0) > 0
        share = at(seen[layer][middle], way) / np.maximum(alpha, 0.01)
        weight = at(doubt, way) * inside * np.minimum(2 * share, 1)
        frame = at(alone.light, way, order=3, mode="mirror")
        own = lights[layer] + weight * (frame - lights[layer])
        # Of a thing about its outline; what lies far from it is in no picture.
        near = ndimage.binary_dilation(alpha > 0, np.ones((9, 9))) if layer else alpha > -1
        near &= inner
        np.testing.assert_allclose(whole.lights[layer][near], own[near], atol=1e-3)
        wanted, single = wanted + alpha * own, single + alpha * weight
    np.testing.assert_allclose(whole.light[inner], wanted[inner], atol=1e-3)
    np.testing.assert_allclose(whole.alone[inner], single[inner], atol=1e-3)
    assert np.max(single[labels_of(found) == 2]) > 0.1


def test_a_pixel_is_trusted_that_two_frames_agree_on_away_from_outlines():
    """More than 2 px from any, of which clear pixels count as one, and nothing else wrong."""
    found = overlapping()
    good = Composite(
        np.zeros(SHAPE), [], np.full(SHAPE, 1.49), np.full(SHAPE, 1.6), np.full(SHAPE, 0.24)
    )
    wanted = np.ones(SHAPE, bool)
    labels = labels_of(found)
    for place in np.ndindex(SHAPE):
        around = [
            (a, b)
            for a in range(place[0] - 3, place[0] + 4)
            for b in range(place[1] - 3, place[1] + 4)
            if (a - place[0]) ** 2 + (b - place[1]) ** 2 <= 4 and a in range(36) and b in range(44)
        ]
        for a, b in around:
            below, right = (min(a + 1, 35), b), (a, min(b + 1, 43))
            differs = labels[a, b] != labels[below] or labels[a, b] != labels[right]
            wanted[place] &= not differs and labels[a, b] != 1  # 0.8 of the first is seen
    assert 300 < np.sum(wanted) < 1200
    np.testing.assert_array_equal(trusted(found, good), wanted)
    for name, value in (("misfit", 1.51), ("num_seen", 1.4), ("alone", 0.26)):
        bad = good._replace(**{name: np.full(SHAPE, value)})
        assert not trusted(found, bad).any()


@pytest.mark.parametrize(
    ("off", "error", "gap", "is_two"),
    [
        ((30.0, -25.0), 3.0, 8, True),
        ((30.0, -25.0), 6.0, 8, False),  # of both, the difference is 39 +- 8.5
        ((20.0, -15.0), 1.0, 8, False),  # 1.25 px over the frames
        ((30.0, -25.0), 3.0, 4, True),
    ],
)
def test_parts_that_lie_apart_are_two_things_where_they_move_apart(
    monkeypatch, off, error, gap, is_two
):
    """By 5 standard errors and 1.5 px; the smaller part is a new thing before the others."""
    shape = (40, 80)
    matte = block(np.s_[4:34], np.s_[2:36], shape)
    matte[6:32, 36 + gap : 64 + gap] = 1
    matte[15:17, 36 : 36 + gap] = 1  # a bridge of two rows
    other = block(np.s_[36:39], np.s_[:60], shape)
    velocity = np.array([90.0, 60.0])
    things = [Thing(np.zeros(2), other, np.zeros(2), 20.0)]
    things.append(Thing(velocity, matte.copy(), velocity, 20.0))
    found = Arrangement(stills_with(textured((3, *shape))), things, [1, 0])

    def refine(arrangement, number, lights):
        thing = arrangement.things[number]
        is_left = np.average(np.arange(80), weights=thing.matte.sum(axis=0)) < 36
        thing.velocity = velocity + (0 if is_left else 1) * np.array(off)
        thing.covariance = error**2 * np.eye(2)

    monkeypatch.setattr(finding, "refine_velocity", refine)
    finding._split(found)
    if not is_two:
        assert len(found.things) == 2
        np.testing.assert_array_equal(found.things[1].matte, matte)
        return
    assert len(found.things) == 3
    assert found.order == [2, 1, 0]
    new, old = found.things[2], found.things[1]
    np.testing.assert_allclose(new.velocity, velocity + off)
    np.testing.assert_array_equal(new.matte + old.matte, matte)
    left = np.arange(80) < 36
    assert np.all(new.matte[:, left] == 0)
    assert np.all(old.matte[:, 36 + gap :] == 0)
    np.testing.assert_array_equal(old.matte[:, left], matte[:, left])


def test_frames_are_compared_by_numbers_of_even_noise():
    """Of one scale, whatever their exposures; about of the variance 1, at any level."""
    random, level = np.random.default_rng(5), np.array([0.05, 0.3, 1.0])[:, None]
    exposures = np.array([0.004, 0.0046, 0.0052])
    counts = random.poisson(level * RATE * exposures[:, None, None], (3, 3, 20000))
    counts = counts + READ_NOISE * random.normal(size=counts.shape)
    frames = counts / (RATE * exposures[:, None, None])
    found = _even(stills_with(frames, exposures=exposures))
    means = found.mean(axis=2)
    np.testing.assert_allclose(means, np.broadcast_to(means[1], means.shape), rtol=0.006)
    scale = np.mean(exposures) / exposures[:, None]
    white = level[..., 0] * RATE * np.mean(exposures)
    noise = (white * scale + (READ_NOISE * scale) ** 2) / (white + READ_NOISE**2)
    np.testing.assert_allclose(found.var(axis=2), noise, rtol=0.04)


def test_velocities_lie_on_a_grid_up_to_the_fastest():
    """Along the axes on which things move."""
    for moves, count in (((True, False), 1), ((False, True), 1), ((True, True), 2)):
        grid = _velocities(stills_with(np.zeros((3, 8, 9)), moves=moves), 90.0)
        sides = [np.arange(-6, 7) * 90.0 if each else np.zeros(1) for each in moves]
        wanted = {(a, b) for a in sides[0] for b in sides[1] if np.hypot(a, b) <= 590.0}
        assert {tuple(each) for each in grid.tolist()} == wanted
        assert len(grid) == len(wanted)
        assert np.sum(np.any(grid != 0, axis=0)) == count


def test_things_of_known_outlines_begin_at_the_velocity_that_explains_them():
    """Of those a pixel apart in the frame that is furthest from the picture."""
    light, random = textured((3, *SHAPE)), np.random.default_rng(6)
    steps = np.array([[-3.0, 2.0], [2.0, 4.0]])
    labels = np.zeros(SHAPE, int)
    labels[10:22, 8:20], labels[14:26, 24:36] = 1, 3  # a number without pixels is left out
    times = np.array([-0.03, 0.01, 0.02])
    for number, step in zip((1, 3), steps, strict=True):
        own = 0.5 + 0.3 * random.normal(size=SHAPE)
        for k, time in enumerate(times):
            way = tuple(np.rint(step * time / 0.03).astype(int))
            own_there, mask = (np.roll(x, way, (0, 1)) for x in (own, labels == number))
            light[k][mask] = own_there[mask]
    stills = stills_with(light, times)
    found = within(stills, labels)
    assert [thing.uncertainty for thing in found.things] == pytest.approx([2 / 0.03] * 2)
    np.testing.assert_allclose([t.velocity for t in found.things], steps / 0.03)
    np.testing.assert_array_equal(found.things[1].matte, labels == 3)
    told = np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])
    known = within(stills, labels, told)
    np.testing.assert_array_equal([t.velocity for t in known.things], told[[0, 2]])


PLANE = ms.PlaneFrames(
    np.array([0.01, 0.05]), np.array([0.004, 0.012]), np.array([0.06]), np.zeros((2, 2))
)
IN_PLANE = ms.Scene.any_direction(900.0, photon_rate=RATE, read_noise=READ_NOISE)


def test_grey_has_the_noise_of_its_colours_and_times_count_from_the_middle():
    """Of three and of one; along the readout frames show things faster."""
    planes = textured((3, 2, 9, 12))
    grey, alone = stills_of(planes, IN_PLANE, PLANE, Readout(2e-4, 0, 4.0))
    shares = np.array([0.2126, 0.7152, 0.0722])
    np.testing.assert_allclose(grey.light, np.tensordot(shares, planes, 1), rtol=1e-5)
    np.testing.assert_allclose(grey.times, np.array([0.01, 0.05]) - (0.008 + 0.056) / 2)
    assert grey.fastest == pytest.approx(900 / (1 - 0.18))
    assert grey.moves == (True, True)
    assert grey.instants is None
    for k, white in enumerate(RATE * PLANE.exposures):
        wanted = 0.4 / white * np.sum(shares**2) + np.sum(shares**2) * (READ_NOISE / white) ** 2
        assert grey.noise(0.4, k) == pytest.approx(wanted)
        assert alone[2].noise(0.4, k) == pytest.approx(0.4 / white + (READ_NOISE / white) ** 2)
    axis = ms.Scene.uniform(max_speed=900.0, photon_rate=RATE, read_noise=READ_NOISE)
    still = ms.StillCamera(half_exposure=0.003)
    frames = [ms.TimedFrame(still, time) for time in (-0.01, 0.03)]
    grey, _ = stills_of(planes[:1], axis, frames, Readout(2e-4, 0, 4.0))
    assert (grey.fastest, grey.moves) == (900.0, (False, True))  # across the readout
    np.testing.assert_allclose(grey.times, [-0.01, 0.03])
    np.testing.assert_allclose(grey.exposures, 0.006)


def test_a_sensor_that_moves_has_places_down_and_across():
    """Along an axis none down; in panels in which a layer moves by 1.5 px at most."""
    path = replace(PLANE, velocities=np.array([[300.0, 300.0], [-500.0, -500.0]]))
    for frames, pan in ((path, (-500.0, 300.0)), (None, (0.0, 300.0))):
        if frames is None:
            motion = ms.FreeMotion(accelerations=[0.0], half_exposure=0.004, velocity=300.0)
            frames = [ms.TimedFrame(motion, time, 300.0 * time) for time in (-0.01, 0.02)]
        found = _instants_of(frames, 900.0)
        late = found.time - found.time[:, :1]
        for place, velocity in zip(found.place, pan, strict=True):
            np.testing.assert_allclose(place - place[:, :1], velocity * late, atol=1e-6)
        panels = late.shape[1] / 8 if late.shape[1] % 8 == 0 else None
        lasting = np.max(found.exposure)
        assert np.max(np.diff(late)) * (900 + np.hypot(*pan)) < 1.5
        assert panels is None or panels < 3 * lasting * (900 + np.hypot(*pan)) / 1.5 + 2


def test_pictures_of_objects_have_the_contrast_of_the_frame():
    """Less its noise; pixels blur along an axis alone, or in the plane, and the lens as well."""
    optics = ms.Optics(lens_blur=0.4)
    stills = stills_with(textured((3, *SHAPE)))
    frame = stills.light[1]
    noise = frame.mean() / (RATE * 0.012) + (READ_NOISE / (RATE * 0.012)) ** 2
    size = (30, 40)
    down, across = np.fft.fftfreq(30)[:, None], np.fft.rfftfreq(40)
    for in_plane in (True, False):
        scene = replace(IN_PLANE, optics=optics)
        if not in_plane:
            light = {"photon_rate": RATE, "read_noise": READ_NOISE, "optics": optics}
            scene = ms.Scene.uniform(max_speed=900.0, **light)
        known = knowledge_of(scene, stills, in_plane=in_plane)
        scale = (np.var(frame) - noise) / float(scene.picture.deviation) ** 2
        power = picture_power_on(scene, down[:, 0], across)
        np.testing.assert_allclose(known.power(size), scale * power, rtol=1e-4)
        radius = np.hypot(down, across) if in_plane else 0 * down + across
        lens = np.exp(-2 * (np.pi * 0.4 * radius) ** 2)
        wanted = np.sinc(across) * lens * (np.sinc(down) if in_plane else 1)
        inner = np.s_[1:14, :19]
        np.testing.assert_allclose(known.aperture(size)[inner], wanted[inner], rtol=1e-6)


def test_known_objects_are_turned_as_the_frames_are():
    """Speeds to the left and up become velocities down and across, as rows in turn show them."""
    outlines = np.zeros((5, 7), int)
    outlines[1:3, 4:6], outlines[3:, :2] = 1, 2
    none, turn = Readout(0.0, 0, 2.0), Readout(1e-4, 0, 2.0)
    speeds = [[30.0, -40.0], [50.0, 60.0]]
    told = _told(Known(speeds, outlines), "rows", turn, in_plane=True, shape=(5, 7))
    true = np.array([[40.0, -30.0], [-60.0, -50.0]])
    np.testing.assert_allclose(told.velocities, true / (1 - 1e-4 * true[:, :1]))
    np.testing.assert_array_equal(told.labels, outlines)
    told = _told(Known([30.0, -40.0], outlines), "columns", none, in_plane=False, shape=(7, 5))
    np.testing.assert_allclose(told.velocities, [[0.0, -30.0], [0.0, 40.0]])
    np.testing.assert_array_equal(told.labels, outlines.T)
    for known, words in (
        (Known(speeds, outlines[:, :6]), "5 x 7 px"),
        (Known(speeds[:1], outlines), "one of each outline"),
        (Known([30.0, 40.0, 50.0]), "velocity along rows and columns"),
    ):
        with pytest.raises(ValueError, match=words):
            _told(known, "rows", none, in_plane=True, shape=(5, 7))


@pytest.mark.parametrize(
    ("axis", "in_plane"), [("rows", True), ("rows", False), ("columns", False)]
)
def test_objects_are_as_a_user_has_them(axis, in_plane):
    """From the largest to the smallest, layers from the back to the front, turned back."""
    found = overlapping()
    if not in_plane:
        for thing in found.things:
            thing.velocity[0] = 0
    for thing, spread in zip(
        found.things, ([[4.0, 1.0], [1.0, 9.0]], np.diag([1.0, 625.0])), strict=True
    ):
        thing.covariance = np.array(spread)
    labels, trust = labels_of(found), np.ones(SHAPE, bool)
    trust[13] = False
    light = [[textured(SHAPE, 10 * c + n).astype(np.float32) for n in range(3)] for c in range(3)]
    picture = textured((*SHAPE, 3), 8)
    back = (lambda x: x) if axis == "rows" else (lambda x: np.swapaxes(x, 0, 1))
    result = _result(_Whole(found, light, picture, labels, trust), axis, in_plane=in_plane)
    np.testing.assert_array_equal(result.light, back(picture))
    np.testing.assert_array_equal(result.trust, back(trust))
    # The front one is the larger: 192 of 192 pixels against 152.
    numbers = np.array([0, 2, 1])
    np.testing.assert_array_equal(result.labels, back(numbers[labels]))
    for own, number in zip(result.objects, (1, 0), strict=True):
        thing, mask = found.things[number], labels == number + 1
        down, across = thing.velocity
        velocity = (-across, -down) if axis == "rows" else (-down, -across)
        np.testing.assert_allclose(own.velocity, velocity)
        turned = thing.covariance[::-1, ::-1] if axis == "rows" else thing.covariance
        np.testing.assert_allclose(own.covariance, turned)
        speed = np.hypot(down, across) if in_plane else -across
        assert own.speed == pytest.approx(speed)
        middles = [np.mean(x) for x in np.nonzero(back(mask))]
        assert own.place == pytest.approx(middles)
        assert own.area == pytest.approx(np.sum(thing.matte))
    assert result.objects[1].error == pytest.approx(np.sqrt((13 + np.sqrt(29)) / 2))
    assert result.objects[1].trusted
    doubt = "its velocity is known to 1 px over the frames only"  # 25 px/s over 50 ms
    assert result.objects[0].doubt == doubt
    trust[:] = labels != 1
    bare = _result(_Whole(found, light, picture, labels, trust), axis, in_plane=in_plane)
    assert bare.objects[1].doubt == "the frames agree on 0% of its pixels only"
    first, *layers = result.layers.layers
    np.testing.assert_allclose(first.picture.light, back(np.stack([x[0] for x in light], -1)))
    for layer, number, top, left in zip(layers, (0, 1), (11, 15), (9, 19), strict=True):
        across, down = -found.things[number].velocity[::-1]
        assert np.ravel(layer.velocity) == pytest.approx((across, down))
        matte = found.things[number].matte[top : top + 14, left : left + 18]
        np.testing.assert_allclose(layer.matte, back(matte))
        own = [x[number + 1][top : top + 14, left : left + 18] for x in light]
        np.testing.assert_allclose(layer.picture.light, back(np.stack(own, -1)))
        assert (layer.top, layer.left) == ((top, left) if axis == "rows" else (left, top))
