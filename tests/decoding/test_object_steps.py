"""Steps of the restoration of things before a background, by small sums of their own.

Three frames of unlike exposures show two things that overlap, one of which goes back and up.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

import mishutter as ms
from mishutter.decoding.objects import finding
from mishutter.decoding.objects.arrangement import Arrangement, Thing
from mishutter.decoding.objects.composite import Alone, _along, _blur, _told, whole_of
from mishutter.decoding.objects.finding import _drop_weakest, _merge, _shown, _tells_nothing
from mishutter.decoding.objects.grids import from_outline
from mishutter.decoding.objects.light import (
    Knowledge,
    Misfit,
    Prior,
    Sight,
    _expected,
    _ground,
    _of_own_detail,
    explaining,
    light_of,
    pulled,
    steps,
)
from mishutter.decoding.objects.mattes import Mixed
from mishutter.decoding.objects.outlines import (
    Along,
    Lights,
    _costs,
    _cover,
    _doubt,
    _Layer,
    behind_in_frames,
    given_others,
    mean_lights,
)
from mishutter.decoding.objects.restored import _instants_of
from mishutter.decoding.objects.stills import Stills
from mishutter.decoding.objects.velocities import _along as along_thing
from mishutter.decoding.objects.velocities import _at_outline, _within
from mishutter.pictures.registration.windows import Window, smoothed, splines

TIMES, EXPOSURES = np.array([-0.02, 0.005, 0.03]), np.array([0.004, 0.012, 0.006])
RATE, READ_NOISE, SHAPE = 5e4, 6.0, (36, 44)
VELOCITIES = np.array([[-200.0, -120.0], [100.0, 160.0]])


def stills_of(light, exposures=EXPOSURES, times=TIMES):
    light = np.asarray(light, np.float32)
    return Stills(light, times, exposures, RATE * exposures, READ_NOISE, 500.0, (True, True))


def noise_of(level, k):
    """Variance of a pixel of a frame."""
    white = RATE * EXPOSURES[k]
    return np.maximum(level, 0.002) / white + (READ_NOISE / white) ** 2


def power_of(size):
    down, across = np.fft.fftfreq(size[0])[:, None], np.fft.rfftfreq(size[1])
    return 1e-3 / (0.02 + down**2 + across**2)


def aperture_of(size):
    return np.sinc(np.fft.fftfreq(size[0]))[:, None] * np.sinc(np.fft.rfftfreq(size[1]))


KNOWN = Knowledge(power_of, aperture_of)


def mattes_of():
    mattes = np.zeros((2, *SHAPE), np.float32)
    mattes[0, 12:24, 10:26] = 1
    mattes[1, 16:28, 20:36] = 1
    return mattes


def arrangement(order=(1, 0), light=None, exposures=EXPOSURES, velocities=VELOCITIES):
    light = texture(3) if light is None else light
    things = [
        Thing(v.copy(), m, v.copy(), 20.0) for v, m in zip(velocities, mattes_of(), strict=True)
    ]
    return Arrangement(stills_of(light, exposures), things, list(order))


def texture(count, seed=0):
    random = np.random.default_rng(seed)
    return 0.35 + 0.1 * smoothed(random.normal(size=(count, *SHAPE)), 1.0)


def displaced(picture, by):
    """A picture of zeros outside, displaced, bilinear."""
    return ndimage.shift(picture.astype(float), by, order=1, mode="grid-constant", cval=0.0)


def test_what_things_cover_is_their_matte_over_their_way():
    """Within each exposure, in steps of 1.5 px at most; what is in front hides what is behind."""
    found = arrangement()
    covers = np.empty((2, 3, *SHAPE))
    for thing, (velocity, matte) in enumerate(zip(VELOCITIES, mattes_of(), strict=True)):
        for k, (time, exposure) in enumerate(zip(TIMES, EXPOSURES, strict=True)):
            way = velocity * exposure
            count = int(np.ceil(np.hypot(*way) / 1.5))
            places = [velocity * time + way * ((n + 0.5) / count - 0.5) for n in range(count)]
            covers[thing, k] = np.mean([displaced(matte, place) for place in places], axis=0)
    np.testing.assert_allclose(found.cover, covers, atol=1e-5)
    np.testing.assert_allclose(found.seen(1), covers[1], atol=1e-5)
    np.testing.assert_allclose(found.seen(0), covers[0] * (1 - covers[1]), atol=1e-5)
    np.testing.assert_allclose(found.ground, (1 - covers[0]) * (1 - covers[1]), atol=1e-5)
    mattes = mattes_of()
    clear = (1 - mattes[0]) * (1 - mattes[1])
    np.testing.assert_allclose(found.alphas(), [clear, mattes[0] * (1 - mattes[1]), mattes[1]])
    assert (found.behind(1), found.behind(0)) == ([0], [])
    half = np.where(mattes[0] > 0, 0.5, 0).astype(np.float32)
    np.testing.assert_allclose(found.covered(found.things[0], half), covers[0] / 2, atol=1e-5)


@pytest.fixture(scope="module")
def sight():
    found = arrangement()
    return found, Sight.of(found.stills, found, KNOWN)


def layers_like(sight, seed):
    random = np.random.default_rng(seed)
    return [random.normal(size=sheet.size).astype(np.float32) for sheet in sight.sheets]


def product(one, other):
    return sum(float(np.sum(a.astype(float) * b)) for a, b in zip(one, other, strict=True))


def test_what_frames_tell_of_layers_is_the_adjoint_of_what_they_see(sight):
    """Of the background and of both things, of parts of exposures of unlike length."""
    _, sight = sight
    layers, frames = layers_like(sight, 1), np.random.default_rng(2).normal(size=(3, *SHAPE))
    seen, told = sight.frames(layers), sight.layers(frames.astype(np.float32))
    assert np.sum(seen * frames) == pytest.approx(product(layers, told), rel=1e-4)
    misfit = Misfit.of(sight)
    curved = misfit.curvature(layers)
    assert product(layers, curved) == pytest.approx(np.sum(sight.inverse * seen**2), rel=1e-4)


def test_frames_are_layers_in_their_order():
    """Of short exposures: each thing displaced by its way, before the others and the background."""
    short = np.full(3, 1e-6)
    whole = np.array([[-200.0, -400.0], [200.0, 200.0]])
    found = arrangement(exposures=short, velocities=whole)
    known = Knowledge(power_of, lambda size: np.ones((size[0], size[1] // 2 + 1)))
    sight = Sight.of(found.stills, found, known)
    layers, pictures = layers_like(sight, 3), []
    for sheet, light in zip(sight.sheets, layers, strict=True):
        picture = np.zeros(SHAPE, np.float32)
        sheet.window.add(picture, light)
        pictures.append(picture)
    for k, time in enumerate(TIMES):
        wanted = pictures[0]
        for number in (0, 1):
            matte = displaced(mattes_of()[number], whole[number] * time)
            own = displaced(mattes_of()[number] * pictures[number + 1], whole[number] * time)
            wanted = wanted * (1 - matte) + own
        np.testing.assert_allclose(sight.frames(layers)[k], wanted, atol=2e-3)


def on_a_path(stills):
    """The same frames of a sensor that turns back in the first, and pans in the last."""
    rates, velocities, places = (3e4, 0.0, 0.0), (60.0, 0.0, 300.0), (1.4, 0.0, -2.3)
    each = zip(TIMES, EXPOSURES, rates, velocities, places, strict=True)
    frames = [
        ms.TimedFrame(
            ms.FreeMotion(accelerations=[rate], half_exposure=exposure / 2, velocity=velocity),
            float(time),
            place,
        )
        for time, exposure, rate, velocity, place in each
    ]
    return replace(stills, instants=_instants_of(frames, 500.0))


@pytest.mark.parametrize("moves", [False, True])
@pytest.mark.parametrize("number", [0, 1])
def test_frames_are_linear_in_a_matte(number, moves):
    """Those of another matte are what is seen of it, before and behind; slopes are of squares."""
    found, other = arrangement(), arrangement()
    if moves:
        found, other = (each.seen_in(on_a_path(each.stills)) for each in (found, other))
    for one in (*found.things, *other.things):
        soft = smoothed(one.matte, 1.5)
        one.matte = np.where(soft > 0.01, soft, np.float32(0))
    own = other.things[number]
    own.matte = own.matte * (0.7 + 0.2 * smoothed(texture(1, 12)[0], 3.0)).astype(np.float32)
    found.place()
    sight, other = (Sight.of(each.stills, each, KNOWN) for each in (found, other))
    assert len(found.stills.parts) > 8 * moves
    layers = [0.3 + 0.1 * smoothed(one, 1.0) for one in layers_like(sight, 11)]
    mixed = Mixed.of(found, Misfit.of(sight), layers, number)
    matte, left = other.sheets[number + 1].matte, found.stills.light - other.frames(layers)
    near = found.cover[number] > 0.01
    assert np.all(np.sum(near, axis=(1, 2)) > 200)
    np.testing.assert_allclose((mixed.rest - mixed.frames(matte))[near], left[near], atol=4e-3)
    along = np.random.default_rng(13).normal(size=matte.shape).astype(np.float32)

    def half(matte):
        return np.sum(mixed.weights * (mixed.rest - mixed.frames(matte)).astype(float) ** 2) / 2

    rise = (half(matte + along) - half(matte - along)) / 2
    slope = np.sum(mixed.slope(matte).astype(float) * along)
    assert abs(rise) > 10
    assert slope == pytest.approx(rise, rel=1e-2)


def test_a_change_of_an_outline_explains_what_it_makes():
    """Of the frames, and little of a change that one of them alone has within the thing."""
    found = arrangement()
    sight = Sight.of(found.stills, found, KNOWN)
    layers = [(0.8, 0.1, 0.1)[n] + 0 * one for n, one in enumerate(layers_like(sight, 11))]
    misfit = Misfit.of(sight)
    mixed = Mixed.of(found, misfit, layers, 0)
    matte = mixed.sheet.matte
    none, inner = np.zeros_like(matte), from_outline(matte > 0.5) * (matte > 0.5)

    def left(change):
        rest = mixed.unexplained(misfit, change)
        return np.sum(sight.inverse * rest**2) / np.sum(sight.inverse * change**2)

    wider = ndimage.binary_dilation(matte > 0.5).astype(np.float32)
    assert left(mixed.frames(wider) - mixed.frames(matte)) < 0.05
    within = mixed.frames((inner > 5).astype(np.float32)) - mixed.frames(none)
    assert left(within) < 0.1
    within[1:] = 0
    assert left(within) > 0.4


def test_outlines_cost_less_at_edges_of_light():
    """Along the thing, above the slopes that noise gives; without an edge they cost about all."""
    random, step = np.random.default_rng(14), np.zeros(SHAPE)
    step[:, 22:] = 0.4
    noises = np.stack([np.sqrt(noise_of(0.3, k)) * random.normal(size=SHAPE) for k in range(3)])
    window, seen = Window.whole(SHAPE), np.ones((3, *SHAPE), np.float32)
    flat, edge = (
        _costs(stills_of(light), Along(light.astype(np.float32), seen, window))
        for light in (0.3 + noises, 0.3 + step + noises)
    )
    assert np.mean(flat) > 0.7
    assert np.max(edge[:, 21:23]) < 0.15
    assert np.mean(edge[:, 30:]) > 0.9


def test_levels_are_those_of_each_layer():
    """Far from that of all frames: of a bright thing before a dark background."""
    covers = np.array(arrangement().seen(1))
    found = arrangement(light=0.1 + 0.6 * covers)
    sight = Sight.of(found.stills, found, KNOWN)
    assert np.mean(found.stills.light) < 0.3
    assert sight.means[2] == pytest.approx(0.7, abs=0.06)
    assert sight.means[0] == pytest.approx(0.1, abs=0.03)


def test_densities_are_sums_over_the_frames_that_see(sight):
    """Of the background, which stands still: its share of each frame over the frame's noise."""
    found, sight = sight
    own = sight.densities()[0]
    window = sight.sheets[0].window
    noises = [
        noise_of(np.maximum(smoothed(one, 1.5), 0), k) for k, one in enumerate(found.stills.light)
    ]
    np.testing.assert_allclose(sight.inverse, 1 / np.array(noises), rtol=1e-4)
    clear = [window.cut(one) for one in found.ground]
    wanted = sum(c**2 * window.cut(1 / n) for c, n in zip(clear, noises, strict=True))
    inside = window.cut(np.ones(SHAPE))
    # Edges pass the aperture, which covers do not.
    flat = ndimage.binary_erosion(inside > 0, iterations=2)
    flat &= np.all([(c > 0.999) | (c < 0.001) for c in clear], axis=0)
    flat = ndimage.binary_erosion(flat, iterations=4)
    assert np.sum(flat) > 50
    np.testing.assert_allclose(own[flat], wanted[flat], rtol=0.1)


def test_differences_and_their_adjoint():
    """Of neighbours down and across, on a ring."""
    random = np.random.default_rng(4)
    light, other = random.normal(size=(5, 7)), random.normal(size=(2, 5, 7))
    found = steps(light)
    assert found[0, 4, 3] == pytest.approx(light[0, 3] - light[4, 3])
    assert found[1, 2, 5] == pytest.approx(light[2, 6] - light[2, 5])
    assert np.sum(found * other) == pytest.approx(np.sum(light * pulled(other)))


def test_priors_weigh_frequencies_pixels_and_differences(sight):
    """A share of the inverse power, and a weight of the light of each pixel or of its steps."""
    _, sight = sight
    layers = layers_like(sight, 5)
    weights = [np.abs(one) + 0.5 for one in layers_like(sight, 6)]
    smooth = [
        np.fft.irfft2(np.fft.rfft2(x) * 0.3 / s.power, s.size)
        for x, s in zip(layers, sight.sheets, strict=True)
    ]
    each = list(zip(layers, smooth, weights, strict=True))
    found = Prior([], 0.3, weights).of(sight.sheets, layers)
    for own, (x, s, w) in zip(found, each, strict=True):
        np.testing.assert_allclose(own, s + w * x, rtol=1e-3, atol=1e-2)
    found = Prior([], 0.3, weights, differences=True).of(sight.sheets, layers)
    for own, (x, s, w) in zip(found, each, strict=True):
        np.testing.assert_allclose(own, s + pulled(w * steps(x)), rtol=1e-3, atol=1e-2)


def cost_of(sight, share):
    """Half of the misfit and of a share of the power of layers over their expectation."""
    pairs = zip(sight.sheets, sight.means, strict=True)
    level = sight.frames([np.full(s.size, mean, np.float32) for s, mean in pairs])

    def cost(layers):
        left = (sight.stills.light - level - sight.frames(layers)).astype(float)
        total = np.sum(left**2 * sight.inverse) / 2
        for light, sheet in zip(layers, sight.sheets, strict=True):
            spectrum = np.abs(np.fft.rfft2(light)) ** 2 / sheet.power
            spectrum[:, 1:-1] *= 2 if sheet.size[1] % 2 == 0 else 1
            total += share * np.sum(spectrum) / light.size / 2
        return total

    return cost


@pytest.mark.parametrize("kind", ["linear", "explaining", "total variation"])
def test_light_is_of_the_least_cost(sight, kind):
    """Of misfit and prior, whichever layer changes: a part of it, one pixel, or its level."""
    _, sight = sight
    assert all(sheet.size[1] % 2 == 0 for sheet in sight.sheets)
    misfit = Misfit.of(sight)
    if kind == "linear":
        light, smooth = light_of(misfit, ms.EnsembleDecoder()), cost_of(sight, 1.0)
    elif kind == "explaining":
        light, smooth = explaining(misfit), cost_of(sight, 0.02)
    else:
        decoder = ms.TotalVariationDecoder(num_iterations=60, strength=0.6)
        light, smooth = light_of(misfit, decoder), cost_of(sight, 0.1)
    light = [one - np.float32(mean) for one, mean in zip(light, sight.means, strict=True)]

    def cost(layers):
        edges = 0.0
        if kind == "total variation":
            edges = sum(
                np.sum(0.3 * 0.6 / np.sqrt(error) * np.hypot(*steps(one)))
                for one, error in zip(layers, misfit.errors, strict=True)
            )
        return smooth(layers) + edges

    least = cost(light)
    for number in range(3):
        spot = smoothed((np.indices(light[number].shape).sum(0) == 40).astype(np.float32), 4.0)
        for other in (light[number], spot, layers_like(sight, 7)[number]):
            scale = 0.1 * np.std(light[number]) / np.std(other)
            for side in (1, -1):
                changed = list(light)
                changed[number] = light[number] + np.float32(side * scale) * other
                assert cost(changed) > least


def test_a_denoiser_of_layers_is_given_what_misfit_and_distance_balance(sight):
    """By the error of each pixel; within a layer, at the nearest of three levels at most."""
    _, sight = sight
    misfit, given = Misfit.of(sight), []

    def keep(light, sigma):
        given.append(sigma)
        return light

    options = {"num_iterations": 1, "first_noise": 0.8, "last_noise": 0.8, "strength": 0.4}
    found = light_of(misfit, ms.PlugAndPlayDecoder(keep, **options))
    start = light_of(misfit, ms.EnsembleDecoder())
    levels = np.array(sight.means, np.float32)
    curved = misfit.curvature([one - level for one, level in zip(found, levels, strict=True)])
    scale = max(np.std(one) for one in misfit.data)
    for number, error in enumerate(misfit.errors):
        weight = 0.4 / (0.64 * error)
        left = misfit.data[number] + weight * (start[number] - levels[number])
        left = left - curved[number] - weight * (found[number] - levels[number])
        assert np.std(left) < 0.1 * scale
    errors = np.sqrt(np.concatenate([one.ravel() for one in misfit.errors]))
    assert all(0.8 * errors.min() <= sigma <= 0.8 * errors.max() * 1.001 for sigma in given)
    assert len(given) <= 9


def test_expected_errors_are_means_over_frequencies(sight):
    """Of the power over 1 and its own product with the density and the mean square response."""
    _, sight = sight
    for sheet in sight.sheets:
        response = np.mean(np.abs(sheet.of_frames) ** 2, axis=0)
        density = np.array([[1e3, 3e4], [2e2, 1e4]], np.float32)
        found = _expected(sheet, density)
        for place in np.ndindex(2, 2):
            every = sheet.power / (1 + sheet.power * response * density[place])
            both = np.concatenate([every, every[:, -2:0:-1]], axis=1)
            assert found[place] == pytest.approx(np.mean(both), rel=0.03)


@pytest.mark.parametrize("count", [1, 3])
def test_a_layer_has_the_power_that_it_shows(count):
    """A quarter of the power that is expected, in noisy frames and in one alone."""
    random, shape = np.random.default_rng(8), (96, 110)
    spectrum = np.fft.rfft2(random.normal(size=shape)) * np.sqrt(power_of(shape) / 4)
    clean = np.fft.irfft2(spectrum * aperture_of(shape), shape) + 0.4
    noises = [noise_of(0.4, k) for k in range(count)]
    frames = clean + np.sqrt(noises)[:, None, None] * random.normal(size=(count, *shape))
    own = stills_of(frames, EXPOSURES[:count], TIMES[:count])
    sheet = _ground(own, KNOWN)
    shares = [sheet.window.cut(np.ones(shape, np.float32))] * count
    found = _of_own_detail(sheet, shares, own)
    ratio = found.power / sheet.power
    down, across = np.fft.fftfreq(sheet.size[0])[:, None], np.fft.rfftfreq(sheet.size[1])
    radius = np.hypot(down, across)
    middle = np.mean(np.log(ratio[(radius > 0.05) & (radius < 0.3)]))
    assert np.exp(middle) == pytest.approx(0.25, rel=0.3)


def test_the_shares_of_what_frames_tell_add_up(sight):
    """To all of it where layers are pure, and by their light: the long frame tells the most."""
    _, sight = sight
    misfit = Misfit.of(sight)
    each = np.array([_told(misfit, k) for k in range(3)])
    corner = np.s_[:, 2:5, 2:5]
    np.testing.assert_allclose(np.sum(each[corner], axis=0), 1, atol=0.05)
    wanted = sight.inverse[corner] / np.sum(sight.inverse[corner], axis=0)
    np.testing.assert_allclose(each[corner], wanted, atol=0.05)


def test_the_share_of_one_frame_is_that_of_the_least_error(sight):
    """The larger of two by neighbourhoods, each the excess of a product over noise and blur."""
    _, sight = sight
    misfit = Misfit.of(sight)
    layers = light_of(misfit, ms.EnsembleDecoder())
    random, middle = np.random.default_rng(9), sight.stills.middle
    assert middle == 1
    shown = sight.frames(layers)[middle]
    apart = 0.05 * random.normal(size=SHAPE) + 0.7 * (sight.stills.light[middle] - shown)
    taken, blur = np.full(SHAPE, 1e-5), 0.02 * random.normal(size=SHAPE)
    alone = Alone(np.zeros(SHAPE), shown + apart, taken)
    noise = 1 / sight.inverse[middle]
    wanted = np.zeros(SHAPE)
    for sigma in (2.0, 6.0):
        square = smoothed(apart**2, sigma)
        cross = smoothed((sight.stills.light[middle] - shown) * apart, sigma)
        error = np.sqrt(smoothed(noise, sigma) * square / (4 * np.pi * sigma**2))
        less = taken * (1 - _told(misfit, middle))
        own = (cross - less - 2 * error) / (square + smoothed(blur**2, sigma))
        wanted = np.maximum(wanted, np.clip(own, 0, 1))
    assert 0.1 < np.mean(wanted) < 0.9
    np.testing.assert_allclose(alone.share(misfit, layers, blur), wanted, atol=1e-3)


def test_sums_along_a_layer_are_over_frames_that_see_it():
    """Of whole pixels: two frames see a place that the third hides."""
    own, window = stills_of(texture(3)), Window(10, 12, 6, 7)
    velocity, squares = (
        np.array([-200.0, 400.0]),
        np.random.default_rng(1).uniform(size=(3, *SHAPE)),
    )
    shares = np.ones((3, *SHAPE))
    shares[2] = 0.9
    total, count = _along(own, (squares, shares), velocity, window)
    places = [(round(10 - 200 * t), round(12 + 400 * t)) for t in TIMES[:2]]
    wanted = sum(squares[k][a : a + 6, b : b + 7] for k, (a, b) in enumerate(places))
    np.testing.assert_allclose(count, 2)
    np.testing.assert_allclose(total, wanted, rtol=1e-5)
    whole = whole_of(Window(-1, 40, 3, 8), np.ones((3, 8)), SHAPE)
    assert np.sum(whole) == 2 * 4


def test_a_blur_is_the_sharp_light_less_its_mean_over_the_way():
    """Of things over the middle exposure, in steps; what stands still has none."""
    found = arrangement()
    lights = [np.full(SHAPE, 0.2, np.float32), np.full(SHAPE, 0.6, np.float32)]
    lights.append(np.full(SHAPE, 0.9, np.float32))

    def at(time):
        light = lights[0].astype(float)
        for number in (0, 1):
            matte = displaced(mattes_of()[number], VELOCITIES[number] * time)
            own = displaced(lights[number + 1], VELOCITIES[number] * time)
            light = light + matte * (own - light)
        return light

    way = 0.012 * np.max(np.hypot(*VELOCITIES.T))
    count = int(np.ceil(way / 1.5))
    times = 0.005 + 0.012 * ((np.arange(count) + 0.5) / count - 0.5)
    wanted = at(0.005) - np.mean([at(each) for each in times], axis=0)
    np.testing.assert_allclose(_blur(found, lights), wanted, atol=1e-4)
    still = arrangement(velocities=np.zeros((2, 2)))
    np.testing.assert_allclose(_blur(still, lights), 0, atol=1e-6)


def test_frames_are_as_likely_as_noise_of_others_makes_them():
    """Of a flat picture: the square of what a Gaussian leaves over a share of both noises."""
    random = np.random.default_rng(10)
    frames = 0.35 + 0.01 * random.normal(size=(3, *SHAPE))
    own = stills_of(frames)
    found = given_others(own, own.light, np.ones((3, *SHAPE), np.float32))
    weights = 1 / np.array([noise_of(0.3, k) for k in range(3)])
    weights = weights / np.mean(weights)
    np.testing.assert_allclose(own.weights, weights, rtol=1e-4)
    np.testing.assert_allclose(found.others, 3, rtol=1e-4)
    mean = np.tensordot(weights, frames, 1) / 3
    level = smoothed(mean, 1.2)
    slope = sum(each**2 for each in np.gradient(level))
    for k in range(3):
        rest = 3 - weights[k]
        told = (3 * mean - weights[k] * frames[k]) / rest
        left = smoothed(frames[k] - told, 1.0)
        typical = 3 / sum(1 / noise_of(level, j) for j in range(3))
        variance = (noise_of(level, k) + typical / rest) / (4 * np.pi)
        wanted = -(left**2) / (2 * (variance + 0.15**2 * slope))
        wanted = wanted - 0.5 * np.log1p(0.15**2 * slope / variance)
        np.testing.assert_allclose(found.logarithms[k], wanted, rtol=1e-3, atol=1e-3)


def test_the_cover_of_a_pixel_is_of_two_likelihoods():
    """Half of the curvature and the slope are of a cover of 1 as likely as the thing is."""
    random, shape = np.random.default_rng(11), (5, 6)
    own = stills_of(texture(3))
    frames = random.uniform(0.3, 0.5, size=(3, *shape))
    frames[:, 1, 4] = 0.05  # which tells more than a pixel may
    seen = np.ones((3, *shape))
    seen[0, 2:] = 0
    thing = _Layer(np.full(shape, 0.44), np.full(shape, 4e-3))
    behind = _Layer(np.stack([np.full(shape, 0.36)] * 3), np.full((3, *shape), 2e-3))
    along = Along(frames, seen, Window(0, 0, *shape))
    square, cross = _cover(own, along, thing, behind)
    for place in np.ndindex(*shape):
        noises = np.array([noise_of(0.44, k) for k in range(3)]) * 1.5
        worth, doubtful = seen[:, *place] / noises, seen[:, *place] / (noises + 2e-3)
        light = frames[:, *place]
        bare = np.sum(doubtful * (light - 0.36) ** 2 + seen[:, *place] * np.log1p(2e-3 / noises))

        def left(weights, one):
            # The least over a light that is off by x, of the variance 4e-3.
            off = np.linspace(-0.4, 0.4, 40001)
            sums = np.sum(weights[:, None] * (one[:, None] - off) ** 2, axis=0) + off**2 / 4e-3
            return np.min(sums)

        covered = left(worth, light - 0.44) + np.log1p(4e-3 * np.sum(worth))
        lead, q = bare - covered, left(doubtful, np.full(3, 0.08))
        scale = min(1, 30 / max(q, abs(lead)))
        assert square[place] == pytest.approx(scale * q, rel=1e-3)
        assert cross[place] == pytest.approx(scale * (q + lead) / 2, rel=1e-3, abs=1e-3)


def test_light_that_was_filled_in_is_off_by_its_variance():
    """A quarter of it from three pixels on, and less nearer; known light is not off."""
    random = np.random.default_rng(12)
    light, known = random.normal(size=(20, 24)), np.ones((20, 24), bool)
    known[:, 14:] = False
    near = smoothed(known.astype(np.float32), 3.0)
    mean = smoothed(np.where(known, light, 0), 3.0) / near
    square = smoothed(np.where(known, light**2, 0), 3.0) / near
    away = np.maximum(np.arange(24) - 13, 0) * np.ones((20, 1))
    wanted = 0.25 * np.maximum(square - mean**2, 0) * np.minimum(away / 3, 1)
    found = _doubt(light, known)
    np.testing.assert_allclose(found[:, :20], wanted[:, :20], rtol=1e-3, atol=1e-6)
    assert np.all(found[:, :14] == 0)


def flat_scene():
    """Frames of flat layers, without noise."""
    found = arrangement()
    frames = 0.2 * found.ground + 0.6 * found.seen(0) + 0.9 * found.seen(1)
    return arrangement(light=frames)


def test_mean_lights_are_those_of_the_layers():
    """Of flat layers each its own; the background's by the light of the frames that see it."""
    found = flat_scene()
    lights = mean_lights(found)
    np.testing.assert_allclose(lights.ground[lights.known > 0], 0.2, atol=0.012)
    for own, told, level in zip(lights.things, lights.told, (0.6, 0.9), strict=True):
        assert np.sum(told) > 60
        np.testing.assert_allclose(own[told], level, atol=0.04)
        assert np.mean(own[told]) == pytest.approx(level, abs=0.004)
    random = np.random.default_rng(13)
    noisy = arrangement(light=found.stills.light + 0.02 * random.normal(size=(3, *SHAPE)))
    weights = (noisy.ground > 0.95) * noisy.stills.weights[:, None, None]
    known = np.sum(weights, axis=0) > 0
    ground = np.sum(weights * noisy.stills.light, axis=0)[known] / np.sum(weights, axis=0)[known]
    np.testing.assert_allclose(mean_lights(noisy).ground[known], ground, rtol=1e-4)


def test_what_is_behind_a_thing_is_what_is_left_without_it():
    """Before the background the other thing, where it lies behind; nothing behind the last."""
    found = flat_scene()
    lights = mean_lights(found)
    flat = lights._replace(
        ground=np.full(SHAPE, 0.2),
        things=[0 * x + v for x, v in zip(lights.things, (0.6, 0.9), strict=True)],
    )
    inner = found.cover[0] > 0.999
    behind = behind_in_frames(found, flat, 1)
    np.testing.assert_allclose(behind[inner], 0.6, atol=1e-4)
    np.testing.assert_allclose(behind, 0.2 + found.cover[0] * 0.4, atol=1e-3)
    np.testing.assert_allclose(behind_in_frames(found, flat, 0), 0.2, atol=1e-6)


def test_an_outline_pushes_as_least_squares_say():
    """Of a velocity and a cover that are both unknown, pixel by pixel."""
    found = flat_scene()
    noisy = found.stills.light + 0.01 * np.random.default_rng(14).normal(size=(3, *SHAPE))
    found = arrangement(light=noisy)
    number = 1
    lights = Lights(np.full(SHAPE, 0.2), np.ones(SHAPE), mean_lights(found).things, [])
    along, front = along_thing(found, number)
    thing, stills = found.things[number], found.stills
    light = np.full(along.frames.shape[1:], 0.9)
    push = _at_outline(found, number, (along, front), light, lights)
    assert push.by_noise == 0
    window, ways = thing.window, stills.ways(thing.velocity)
    behind = behind_in_frames(found, lights, number)
    hidden = splines(behind)
    behind = np.stack(
        [window.taken(h, w, is_spline=True) for h, w in zip(hidden, ways, strict=True)]
    )
    inside = window.of(thing.matte) > 0.5
    cover = ndimage.gaussian_filter(inside.astype(float), 1.5, mode="nearest")
    down, across = np.gradient(cover)
    distances = [ndimage.distance_transform_edt(x) for x in (inside, ~inside)]
    band = np.maximum(*distances) <= 3
    checked = 0
    for place in zip(*np.nonzero(band), strict=True):
        seen = front[:, *place]
        if not seen.all():
            continue
        contrast = 0.9 - behind[:, *place]
        noises = np.array([noise_of(max(0.9, behind[k][place]), k) for k in range(3)])
        slope = np.array([down[place], across[place]])
        left = along.frames[:, *place] - behind[:, *place] - cover[place] * contrast
        design = np.stack([TIMES * contrast, contrast], axis=1) / np.sqrt(noises)[:, None]
        normal = design.T @ design
        told = design.T @ (left / np.sqrt(noises))
        information = normal[0, 0] - normal[0, 1] ** 2 / normal[1, 1]
        pull = told[0] - normal[0, 1] * told[1] / normal[1, 1]
        np.testing.assert_allclose(
            push.curvatures[:, :, *place],
            np.outer(slope, slope) * information,
            rtol=5e-3,
            atol=1e-3,
        )
        np.testing.assert_allclose(push.forces[:, *place], -slope * pull, rtol=2e-2, atol=0.3)
        checked += 1
    assert checked > 30


def test_the_light_within_an_outline_is_the_mean_of_what_frames_see():
    """By the worth of each frame; a pixel that none sees tells nothing."""
    found = arrangement(light=texture(3, 15))
    along, front = along_thing(found, 0)
    seen = front * (found.things[0].window.of(found.things[0].matte) > 0.5)
    mean, push = _within(found, found.things[0], along, seen)
    weights = found.stills.weights[:, None, None] * seen
    known = np.sum(weights, axis=0) > 0
    wanted = np.sum(weights * along.frames, axis=0)[known] / np.sum(weights, axis=0)[known]
    np.testing.assert_allclose(mean[known], wanted, rtol=1e-4)
    assert np.all(push.forces[:, ~known] == 0)
    worth = np.sum(weights, axis=0)
    late = TIMES[:, None, None] - np.sum(weights * TIMES[:, None, None], axis=0) / np.maximum(
        worth, 1e-9
    )
    told = np.sum(weights * late**2, axis=0)
    assert push.by_noise == pytest.approx(
        np.sum((told / np.maximum(worth, 1e-9))[known]) / (8 * np.pi), rel=1e-3
    )


def test_the_weakest_of_too_little_evidence_or_area_is_left_out():
    """One at a time: the one of least evidence, and none where all have enough."""
    found = arrangement()
    found.things[0].matte = np.zeros(SHAPE, np.float32)
    found.things[0].matte[5:20, 5:25] = 1
    found.things[1].matte = found.things[0].matte.copy()
    for evidence, left in (((151.0, 151.0), 2), ((149.0, 100.0), 1)):
        for thing, each in zip(found.things, evidence, strict=True):
            thing.evidence = each
        _drop_weakest(found)
        assert len(found.things) == left
    assert found.things[0].evidence == 149
    found.things[0].evidence = 900.0
    _drop_weakest(found)
    assert len(found.things) == 1
    found.things[0].matte[5:20, 5:12] = 0
    _drop_weakest(found)
    assert found.things == []


def test_a_thing_that_is_drawn_nowhere_is_left_out(monkeypatch):
    """Before the outlines of the others are solved."""
    found = arrangement()

    def empty(arrangement, *, at_edges):
        arrangement.things[0].matte = np.zeros(SHAPE, np.float32)

    monkeypatch.setattr(finding, "cut_out", empty)
    kept = found.things[1]
    finding._sharpen(found)
    assert found.things == [kept]


def test_no_outline_is_drawn_anew_of_a_thing_that_has_none(monkeypatch):
    """Of several that the last look draws nowhere one is left out for its little evidence."""
    found, areas = arrangement(), []
    for thing, left in zip(found.things, (5, 8), strict=True):
        thing.matte = np.zeros(SHAPE, np.float32)
        thing.matte[5:20, left : left + 20] = 1

    def drawn(arrangement, *, at_edges=False):
        areas.append([thing.area for thing in arrangement.things])
        for thing in arrangement.things:
            is_last, thing.evidence = len(areas) == finding._ROUNDS, 1e4
            thing.matte = np.zeros(SHAPE, np.float32) if is_last else thing.matte

    monkeypatch.setattr(finding, "cut_out", drawn)
    monkeypatch.setattr(finding, "candidates", lambda stills, velocities: found)
    assert finding.found_in(found.stills, finding.Told(np.array(VELOCITIES))).things == []
    assert all(area > 0 for each in areas for area in each)
    assert [len(each) for each in areas] == [2] * finding._ROUNDS + [0, 0]


@pytest.mark.parametrize(
    ("errors", "evidence", "tells"),
    [
        ((11.9, 40.0), 200.0, True),
        ((12.1, 40.0), 200.0, False),
        ((0.0, 5.0), 200.0, True),
        ((0.0, 12.1), 200.0, False),
        ((1.0, 1.0), 149.0, False),
        ((0.0, 0.0), 200.0, False),
    ],
)
def test_a_velocity_as_unsure_as_the_first_guess_tells_nothing(errors, evidence, tells):
    """Along the axis that is known best, of those on which things move; 0.6 of 20 px/s."""
    thing = arrangement().things[0]
    thing.matte = np.ones(SHAPE, np.float32)
    thing.covariance, thing.evidence = np.diag(np.square(errors)), evidence
    assert _tells_nothing(thing) is not tells


@pytest.mark.parametrize(
    ("off", "rest", "left"), [(28.0, 100.0, 1), (32.0, 100.0, 2), (90.0, 28.0, 1), (90.0, 32.0, 2)]
)
def test_things_that_move_alike_are_one_and_those_at_rest_none(off, rest, left):
    """Within 1.5 px over 50 ms, which is 30 px/s; pixels of the second are then the first's."""
    found = arrangement()
    found.things[0].velocity = np.array([0.0, -rest])
    found.things[1].velocity = np.array([-off, -rest])
    whole = np.maximum(*mattes_of())
    _merge(found)
    assert len(found.things) == left
    if rest == 100.0 and left == 1:
        np.testing.assert_array_equal(found.things[0].matte, whole)


def test_squares_by_a_things_own_light_are_over_the_noise():
    """Of frames that fit they are the noise's mean over 1.3; known where another frame shows it."""
    found = flat_scene()
    random = np.random.default_rng(16)
    noise = np.sqrt([noise_of(found.stills.light[k], k) for k in range(3)])
    found = arrangement(light=found.stills.light + noise * random.normal(size=(3, *SHAPE)))
    over = np.zeros((3, *SHAPE), bool)
    over[0] = found.cover[1][0] > 0.5
    squares, known = _shown(found.stills, found.things[1], over)
    inner = found.cover[1][0] > 0.999
    assert np.all(known[0] <= over[0])
    assert not known[1:].any()
    both = inner & known[0]
    assert np.sum(both) > 60
    assert 0.7 < np.mean(squares[0][both]) < 1.5
    assert np.max(squares) <= 12
