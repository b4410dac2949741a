"""Frames of a few pixels against dense covariances: likelihoods, slopes, fits and pictures.

Three frames of unlike exposures and noises, of a sensor that moves itself, show a picture that
moves back along the rows and down the columns. Their pixels have a covariance by their distance,
of responses that are written down here once more.
"""

import numpy as np
import pytest
import scipy.linalg

from mishutter import (
    EnsembleDecoder,
    PlaneFrames,
    PlugAndPlayDecoder,
    Scene,
    StillCamera,
    TimedFrame,
    TotalVariationDecoder,
)
from mishutter.decoding.decoders.base import power_at
from mishutter.decoding.frame_likelihood import (
    Own,
    Prior,
    _bounded,
    climbed,
    peak_near,
    slope_at,
)
from mishutter.decoding.frame_restoration import (
    method_in_plane,
    restored_in_plane,
    restored_on_axis,
)
from mishutter.decoding.likeliest import noises_of, volume_of
from mishutter.decoding.rolling import GLOBAL
from mishutter.evaluation.fans import picture_power_on
from mishutter.model.optics import NUM_FREQUENCIES
from mishutter.model.scene import power_on_grid

TIMES, EXPOSURES = np.array([0.02, 0.06, 0.11]), np.array([0.008, 0.03, 0.014])
NOISES = np.array([2e-2, 5e-3, 1e-2])
MEAN = 0.25


class Dense:
    """Frames of 12 x 10 pixels, or of 2 rows of 40, as numbers of a Gaussian distribution."""

    def __init__(self, axes, size=1, noises=NOISES):
        self.axes, self.size = axes, size
        light = {"photon_rate": 3e4, "read_noise": 6.0}
        if axes == 2:
            self.velocity, self.pan = np.array([-61.0, 43.0]), np.array([17.0, 9.0])
            self.scene, self.shape = Scene.any_direction(150.0, **light), (12 * size, 10 * size)
            path = np.repeat(self.pan[:, None], 2, axis=1)
            self.taken = PlaneFrames(TIMES, EXPOSURES, np.full(1, 0.13), path)
        else:
            self.velocity, self.pan = np.array([-61.0]), np.zeros(1)
            self.scene, self.shape = Scene(np.linspace(-150.0, 150.0, 5), **light), (2, 40 * size)
            pairs = zip(TIMES, EXPOSURES, strict=True)
            self.taken = [TimedFrame(StillCamera(half_exposure=e / 2), t) for t, e in pairs]
        frames = np.zeros((3, *self.shape))
        self.own = Own(frames, noises, self.taken, Prior(self.scene))
        self.canvas = self.own.level(self.velocity[None], size).canvas
        self.frequencies = np.fft.rfftfreq(self.canvas.shape[-1])[None], np.zeros((1, 1))
        if axes == 2:
            self.frequencies = self.frequencies[0], np.fft.fftfreq(self.canvas.shape[0])[:, None]
        self.noise = np.repeat(noises / size**axes + self.finer(), np.prod(self.sensor))
        self.mixture = self.covariance() + np.diag(self.noise)
        random = np.random.default_rng(7)
        drawn = np.linalg.cholesky(self.mixture) @ random.normal(size=(len(self.noise), self.rows))
        self.told = drawn  # Frames of each picture
        self.frames = np.moveaxis(drawn.reshape(3, *self.sensor, self.rows), -1, 1)
        if axes == 2:
            self.frames = self.frames[:, 0]

    @property
    def rows(self):
        return 1 if self.axes == 2 else 2

    @property
    def sensor(self):
        sizes = self.shape if self.axes == 2 else self.shape[1:]
        return tuple(n // self.size for n in sizes)

    def power(self):
        across, down = self.frequencies
        if self.axes == 2:
            every = picture_power_on(self.scene, down[:, 0] / self.size, across[0] / self.size)
        else:
            steps = power_on_grid(self.scene, NUM_FREQUENCIES)
            every = power_at(across[0] / self.size, steps)[None]
        return every / self.size**self.axes

    def finer(self):
        """Variance of binned pixels by waves of more than half a cycle in one."""
        if self.size == 1:
            return 0.0
        each = np.fft.fftfreq(256)
        assert self.axes == 2
        power = picture_power_on(self.scene, each, np.fft.rfftfreq(256))
        power = np.concatenate([power, power[:, -2:0:-1]], axis=1)
        box = np.sinc(self.size * each) ** 2
        fine = np.abs(each) > 0.5 / self.size
        return np.mean(power * box[:, None] * box * (fine[:, None] | fine))

    def responses(self, velocity, shift=None):
        """Each frame's, of a sensor at its own velocity; moved besides by a shift."""
        across, down = self.frequencies
        pan = (velocity - self.pan) / self.size
        way = across * pan[0] + (down * pan[1] if self.axes == 2 else 0)
        middle = (TIMES[0] - EXPOSURES[0] / 2 + TIMES[2] + EXPOSURES[2] / 2) / 2
        late = 0.0 if self.axes == 1 else middle
        passed = np.sinc(across) * np.sinc(down) * (np.abs(across) < 0.5) * (np.abs(down) < 0.5)
        if shift is not None:
            turn = across * shift[0] + (down * shift[1] if self.axes == 2 else 0)
            passed = passed * np.exp(-2j * np.pi * turn)
        pairs = zip(TIMES - late, EXPOSURES, strict=True)
        return [passed * np.sinc(way * e) * np.exp(2j * np.pi * way * t) for t, e in pairs]

    def lags(self, spectrum):
        """The matrix between pixels of two frames whose numbers depend on their distance."""
        if self.axes == 1:
            (count,), line = self.sensor, np.fft.irfft(spectrum[0], self.canvas.shape[0])
            return line[np.arange(count)[:, None] - np.arange(count)]
        plane = np.fft.irfft2(spectrum, self.canvas.shape)
        down, across = np.divmod(np.arange(np.prod(self.sensor)), self.sensor[1])
        return plane[down[:, None] - down, across[:, None] - across]

    def covariance(self, velocity=None, other=None, shift=None):
        """Of what frames see at a velocity, and at another."""
        velocity = self.velocity if velocity is None else velocity
        one = self.responses(velocity, shift)
        two = self.responses(velocity if other is None else other)
        return np.block([[self.lags(a * b.conj() * self.power()) for b in two] for a in one])

    def gain(self, velocity):
        """Logarithm of the likelihood of the frames of each row, but for the determinant."""
        mixture = self.covariance(velocity) + np.diag(self.noise)
        explained = self.told * np.linalg.solve(mixture, self.told)
        return np.sum(self.told**2 / self.noise[:, None] - explained, axis=0) / 2

    def light(self):
        """The mean of the picture where the sensor is, given the frames."""
        cross = np.hstack([self.lags(one.conj() * self.power()) for one in self.seeing])
        return (cross @ np.linalg.solve(self.mixture, self.told)).T

    @property
    def seeing(self):
        return self.responses(self.velocity)

    def seen(self, velocity=None, shift=None):
        """Light that the likeliest picture, at its velocity, has in frames at another."""
        velocity = self.velocity if velocity is None else velocity
        cross = self.covariance(velocity, self.velocity, shift)
        return cross @ np.linalg.solve(self.mixture, self.told)

    def level(self):
        """The package's own, of frames whose pixels are as large."""
        whole = self.frames
        for axis in range(-self.axes, 0):
            whole = np.repeat(whole, self.size, axis=axis)
        return self.own._replace(frames=whole).level(self.velocity[None], self.size)


KINDS = [(1, 1), (2, 1), (2, 2)]


@pytest.fixture(scope="module", params=KINDS, ids=str)
def dense(request):
    return Dense(*request.param)


def unit(k, axes):
    return np.eye(axes)[k]


def test_the_likelihood_is_that_of_a_dense_covariance(dense):
    """At the velocity and beside it, and so is what the likeliest picture leaves in frames."""
    level = dense.level()
    for velocity in (dense.velocity, dense.velocity + 4.0):
        found = level.likeliest(velocity[None], 1e-7)
        np.testing.assert_allclose(found.gains.ravel(), dense.gain(velocity), rtol=1e-5)
    found = level.likeliest(dense.velocity[None], 1e-7)
    seen = np.moveaxis(found.seen.reshape(3, dense.rows, -1), 1, -1).reshape(-1, dense.rows)
    np.testing.assert_allclose(seen, dense.seen(), atol=3e-4)


def test_slopes_and_information_are_those_of_the_dense_likelihood(dense):
    """The slope is its derivative but for volumes, and information that of moved pixels."""
    level, axes, side = dense.level(), dense.axes, 1e-3
    slope = slope_at(level, dense.velocity, 1e-8)
    parts = np.sum(slope.scores, axis=(1, 2, 3))
    changes, wanted, volumes = [], [], []
    furthest = level.canvas.size / np.ptp(level.instants.time)
    for k in range(axes):
        apart = side * unit(k, axes)
        gains = [np.sum(dense.gain(dense.velocity + s * apart)) for s in (1, -1)]
        wanted.append((gains[0] - gains[1]) / (2 * side))
        moved = dense.seen(dense.velocity + apart) - dense.seen(dense.velocity - apart)
        changes.append(moved / (2 * side))
        far = 0.1 * furthest * unit(k, axes)
        ends = [level.volume(dense.velocity + s * far).logarithm for s in (1, -1)]
        volumes.append(dense.rows * (ends[0] - ends[1]) / (0.2 * furthest))
    np.testing.assert_allclose(parts, wanted, rtol=2e-3)
    np.testing.assert_allclose(slope.value, parts - np.ravel(volumes), rtol=1e-9)
    climb = climbed(level, dense.velocity, 1e-8)
    weak = 1 / (64 * furthest) ** 2
    information = [
        [np.sum(a * np.linalg.solve(dense.mixture, b)) for b in changes] for a in changes
    ]
    np.testing.assert_allclose(climb.information, information + weak * np.eye(axes), rtol=1e-3)
    step = np.linalg.solve(climb.information, slope.value)
    length = min(np.linalg.norm(step), furthest)
    np.testing.assert_allclose(
        climb.best, dense.velocity + step * length / np.linalg.norm(step), rtol=1e-9
    )
    value = np.sum(dense.gain(dense.velocity)) - dense.rows * level.volume(dense.velocity).logarithm
    assert climb.value(level) == pytest.approx(value, rel=1e-5)


def test_the_peak_has_the_curvature_and_the_scatter_of_its_places(dense):
    """By differences of slopes over one side, and by pulls less each place's share of the sum."""
    level, axes = dense.level(), dense.axes
    climb = climbed(level, dense.velocity, 1e-6)
    peak = peak_near(level, climb, 1e-6)
    side = 0.15 * climb.furthest
    values = [slope_at(level, climb.best + side * unit(k, axes), 1e-6).value for k in range(axes)]
    curvature = np.stack([(peak.near.value - value) / side for value in values])
    curvature = (curvature + curvature.T) / 2
    shares = scipy.linalg.eigh(curvature, climb.information)
    bounded = np.clip(shares[0], 0.01, 1.0)
    back = climb.information @ shares[1]
    np.testing.assert_allclose(peak.curvature, (back * bounded) @ back.T, rtol=1e-6)
    pulls, pixels = peak.near.by_place(level)
    own = pulls - np.outer(np.sum(pulls, axis=1), pixels / np.sum(pixels))
    count = len(pixels)
    total = np.sum(pulls, axis=1)
    scatter = count / max(count - 1, 1) * own @ own.T + np.outer(total, total)
    shares = scipy.linalg.eigh(scatter, climb.information)
    back = climb.information @ shares[1]
    scatter = (back * np.maximum(shares[0], 1)) @ back.T
    inverse = np.linalg.inv(peak.curvature)
    np.testing.assert_allclose(peak.covariance, inverse @ scatter @ inverse, rtol=1e-6)
    step = inverse @ peak.near.value
    step *= min(1, climb.furthest / np.linalg.norm(step))
    np.testing.assert_allclose(peak.best, climb.best + step, rtol=1e-9)


def test_a_matrix_is_bounded_in_units_of_another():
    """Eigenvalues of the pair that lie between the ends stay; others go to the nearer end."""
    unit_, random = np.array([[3.0, 1.0], [1.0, 2.0]]), np.random.default_rng(1)
    vectors = np.linalg.cholesky(unit_) @ np.linalg.qr(random.normal(size=(2, 2)))[0]
    found = _bounded(unit_, (vectors * [0.02, 5.0]) @ vectors.T, (0.1, 3.0))
    np.testing.assert_allclose(found, (vectors * [0.1, 3.0]) @ vectors.T)
    found = _bounded(unit_, (vectors * [0.2, 2.0]) @ vectors.T, (0.1, 3.0))
    np.testing.assert_allclose(found, (vectors * [0.2, 2.0]) @ vectors.T)


def test_frames_fit_as_dense_least_squares_say(dense):
    """Gains, black levels and displacements of each frame, their errors, and what is left."""
    level, axes = dense.level(), dense.axes
    fit, space = level.fit(dense.velocity, MEAN, 1e-8), level.volume(dense.velocity)
    seen, count = dense.seen(), len(dense.noise) // 3
    side, design = 1e-3, [dense.seen() + MEAN, np.ones_like(seen)]
    for k in range(axes):
        ends = [dense.seen(shift=s * side * unit(k, axes)) for s in (1, -1)]
        design.append((ends[0] - ends[1]) / (2 * side))
    widths = np.array([0.2, 0.2, *[10 / dense.size] * axes])
    left = dense.told - seen
    found, errors = [], []
    for k in range(3):
        part = slice(k * count, k * count + count)
        noise = dense.noise[k * count]
        matrix = np.stack([one[part].ravel() for one in design], axis=1)
        error = np.linalg.inv(matrix.T @ matrix / noise + np.diag(widths**-2))
        change = error @ matrix.T @ left[part].ravel() / noise
        left[part] -= (matrix[:, :2] @ change[:2]).reshape(-1, dense.rows)
        found.append(change)
        errors.append(error[2:, 2:])
    found = np.array(found)
    np.testing.assert_allclose(fit.gains, found[:, 0], rtol=5e-3, atol=1e-4)
    np.testing.assert_allclose(fit.offsets, found[:, 1], rtol=5e-3, atol=1e-4)
    for k in range(3):
        others = [j for j in range(3) if j != k]
        information = sum(np.linalg.inv(errors[j]) for j in others)
        # The picture lies between all frames, and moves with each by its share of what they tell.
        every = information + np.linalg.inv(errors[k])
        apart = np.linalg.solve(information, every @ found[k, 2:])
        variance = np.diag(errors[k] + np.linalg.inv(information))
        np.testing.assert_allclose(fit.shifts[k], dense.size * apart, rtol=5e-3, atol=1e-3)
        np.testing.assert_allclose(fit.shift_errors[k], dense.size * np.sqrt(variance), rtol=1e-4)
    squares = np.sum((left**2 / dense.noise[:, None]).reshape(3, -1), axis=1)
    free = dense.rows * space.freedoms - 2
    np.testing.assert_allclose(fit.misfits, squares / free, rtol=1e-4)
    assert fit.misfit == pytest.approx(np.sum(squares) / np.sum(free), rel=1e-4)
    if axes == 1:
        parts = dense.gain(dense.velocity) - space.logarithm
    else:
        each = np.sum((left[:, 0] ** 2 / dense.noise).reshape(3, *dense.sensor), axis=0)
        cuts = [np.linspace(0, n, 8, endpoint=False).astype(int) for n in dense.sensor]
        tiles = [
            np.sum(one)
            for row in np.split(each, cuts[0][1:])
            for one in np.split(row, cuts[1][1:], 1)
        ]
        parts = -np.array(tiles) / 2
    np.testing.assert_allclose(fit.parts, parts, rtol=3e-3, atol=1e-3)


def test_volumes_are_near_those_of_the_dense_covariance():
    """Of rows: half the logarithm of the determinant over the noise, and the freedom left."""
    dense = Dense(1)
    volume = dense.level().volume(dense.velocity)
    half = (np.linalg.slogdet(dense.mixture)[1] - np.sum(np.log(dense.noise))) / 2
    assert volume.logarithm == pytest.approx(half, rel=0.1)
    free = (np.diag(np.linalg.inv(dense.mixture)) * dense.noise).reshape(3, -1)
    np.testing.assert_allclose(volume.freedoms, np.sum(free, axis=1), rtol=0.08)


@pytest.mark.parametrize("axes", [1, 2])
def test_volumes_are_of_waves_of_the_coarse_grid(axes):
    """Up to half a cycle a pixel."""
    dense = Dense(axes)
    level = dense.level()
    power, aperture = level.coarse
    way = np.fft.rfftfreq(2 * power.shape[-1] - 2) * (dense.velocity - dense.pan)[0]
    if axes == 2:
        way = way + np.fft.fftfreq(len(power))[:, None] * (dense.velocity - dense.pan)[1]
    seen = np.stack([np.sinc(way * exposure) ** 2 for exposure in EXPOSURES])
    density = seen * aperture**2 * power / NOISES.reshape(3, *[1] * axes)
    wanted = volume_of(density, level.instants.middles(dense.velocity)[::-1], dense.sensor)
    volume = level.volume(dense.velocity)
    assert volume.logarithm == pytest.approx(wanted.logarithm, rel=1e-6)


def told_by_scene(axes):
    """Frames with the noise that their scene has at its mean level."""
    scene = Dense(axes).scene
    return Dense(axes, noises=noises_of(scene, EXPOSURES, float(scene.picture.mean_level)))


def test_pictures_of_rows_are_the_dense_means():
    """Through a capture as good as the frames, and its filter, about the level of each row."""
    dense = told_by_scene(1)
    captures = dense.frames + np.array([0.2, 0.4])[:, None]
    rows = np.mean(captures, axis=(0, 2), keepdims=True)
    dense.told = (captures - rows).transpose(0, 2, 1).reshape(-1, 2)
    found = restored_on_axis(
        captures[None], dense.scene, dense.taken, EnsembleDecoder(), -61.0, times=GLOBAL
    )
    wanted = dense.light() + rows[0]
    np.testing.assert_allclose(np.asarray(found)[:, 1:-2, 0], wanted[:, 1:-2], atol=2e-3)


def test_pictures_of_the_plane_are_the_dense_means():
    """Each colour about its own level."""
    dense = told_by_scene(2)
    captures = dense.frames + 0.3
    planes = np.stack([captures, 0.5 * captures])
    decode = method_in_plane(EnsembleDecoder())
    own = planes, dense.scene, dense.taken, decode, dense.velocity
    found = restored_in_plane(*own, times=GLOBAL)
    level = np.mean(captures)
    dense.told = (captures - level).reshape(-1, 1)
    light = dense.light().reshape(dense.sensor)
    for k, share in enumerate((1.0, 0.5)):
        np.testing.assert_allclose(found[..., k], share * (light + level), atol=1e-3)


def plane_problem():
    """The likeliest picture of frames of the plane, and what they tell when they go on."""
    dense = told_by_scene(2)
    found = dense.level().likeliest(dense.velocity[None], 1e-8)
    density = sum(
        np.abs(one) ** 2 / noise for one, noise in zip(dense.seeing, dense.own.noises, strict=True)
    )
    whole = (density + 1 / dense.power()) * np.fft.rfft2(found.picture[0])
    full = [np.concatenate([x, x[:, -2:0:-1]], axis=1) for x in (dense.power(), density)]
    error = np.mean(full[0] / (1 + full[0] * full[1]))
    return dense, found, density, whole, error


def test_total_variation_of_frames_ends_at_its_minimum():
    """Of misfit, a twentieth of the power over its expectation and 0.3 c/e of the edges."""
    dense, found, density, whole, error = plane_problem()
    decoder = TotalVariationDecoder(num_iterations=600, strength=0.7)
    picture = method_in_plane(decoder)(found, MEAN)
    shape = picture.shape

    def cost(light):
        spectrum = np.fft.rfft2(light)
        smooth = np.abs(spectrum) ** 2 / dense.power()
        smooth[0, 0] = 0.0
        every = density * np.abs(spectrum) ** 2 / 2 - np.real(whole.conj() * spectrum) + smooth / 20
        every[:, 1:-1] *= 2
        steps = [np.roll(light, -1, axis) - light for axis in (0, 1)]
        edges = 0.3 * 0.7 / np.sqrt(error) * np.sum(np.hypot(*steps))
        return np.sum(every) / np.prod(shape) + edges

    least, random = cost(picture), np.random.default_rng(3)
    wave = np.cos(2 * np.pi * np.arange(shape[0]) / shape[0])[:, None] * np.ones(shape)
    for other in (picture, wave, np.ones(shape), random.normal(size=shape), found.picture[0]):
        scale = 1e-4 * np.max(np.abs(picture)) / np.max(np.abs(other))
        for side in (1, -1):
            assert cost(picture + side * scale * other) > least


def test_a_denoiser_of_frames_is_given_what_misfit_and_distance_balance():
    """The misfit of frames that go on, by the error that the likeliest picture leaves."""
    _, found, density, whole, error = plane_problem()
    given = []

    def keep(light, sigma):
        given.append((light, sigma))
        return light

    decoder = PlugAndPlayDecoder(keep, num_iterations=3, first_noise=1.7, last_noise=0.6)
    method_in_plane(decoder)(found, MEAN)
    light = found.picture[0]
    sigmas = np.sqrt(error) * 1.7 * (0.6 / 1.7) ** np.array([0, 0.5, 1])
    for (shown, sigma), wanted in zip(given, sigmas, strict=True):
        assert sigma == pytest.approx(wanted, rel=1e-3)
        weight = 0.25 / wanted**2
        spectrum = (whole + weight * np.fft.rfft2(light)) / (density + weight)
        light = np.fft.irfft2(spectrum, light.shape)
        np.testing.assert_allclose(shown, light + MEAN, atol=5e-4)


def test_means_of_some_frames_are_those_of_their_own_instants():
    """A part of the frames has the likelihood of these alone, whatever the others are."""
    dense = Dense(2)
    part = slice(1, 3)
    level = dense.own._replace(frames=dense.frames).level(dense.velocity[None], 1, part)
    assert np.mean(level.instants.time) == pytest.approx(0, abs=1e-12)
    count = len(dense.noise) // 3
    told, noise = dense.told[count:, 0], dense.noise[count:]
    if level.canvas.shape != dense.canvas.shape:
        dense.canvas = level.canvas
        dense.frequencies = (
            np.fft.rfftfreq(level.canvas.shape[1])[None],
            np.fft.fftfreq(level.canvas.shape[0])[:, None],
        )
    mixture = dense.covariance()[count:, count:] + np.diag(noise)
    gain = (np.sum(told**2 / noise) - told @ np.linalg.solve(mixture, told)) / 2
    found = level.likeliest(dense.velocity[None], 1e-7)
    assert float(found.gains[0]) == pytest.approx(gain, rel=1e-4)
    many = dense.velocity + np.array([[0.0, 0.0], [5.0, 0.0], [0.0, -7.0]])
    each = [
        float(level.likeliest(one[None], 1e-7).gains[0]) - level.volume(one).logarithm
        for one in many
    ]
    np.testing.assert_allclose(level.logarithms(many, 1e-7).ravel(), each, rtol=1e-5)


def test_flat_frames_tell_as_little_as_sixty_four_steps():
    """The information of a velocity without detail is that of a pixel over the frames, by 64."""
    dense = Dense(2)
    level = dense.own.level(dense.velocity[None])
    lasts = np.ptp([TIMES[0] - EXPOSURES[0] / 2, TIMES[2] + EXPOSURES[2] / 2])
    found = climbed(level, dense.velocity).information
    np.testing.assert_allclose(found, (lasts / 64) ** 2 * np.eye(2), rtol=0.02)


def test_detail_of_frames_scales_their_power():
    """Frames of a fourth of the scene's power have a prior of about a fourth, in every band."""
    dense = Dense(2)
    random = np.random.default_rng(8)
    shape = (96, 128)
    power = picture_power_on(dense.scene, np.fft.fftfreq(96), np.fft.rfftfreq(128))
    light = np.fft.irfft2(np.fft.rfft2(random.normal(size=shape)) * np.sqrt(power / 4), shape)
    passed = np.sinc(np.fft.rfftfreq(128)) * np.sinc(np.fft.fftfreq(96))[:, None]
    frames = np.stack([np.fft.irfft2(np.fft.rfft2(light) * passed, shape)] * 3)
    noises = np.array([1e-6, 2e-6, 4e-6])
    frames = frames + np.sqrt(noises)[:, None, None] * random.normal(size=frames.shape)
    still = PlaneFrames(TIMES, EXPOSURES, np.full(1, 0.13), np.zeros((2, 2)))
    own = Own(frames, noises, still, Prior(dense.scene)).with_own_detail(np.zeros((1, 2)))
    np.testing.assert_allclose(own.prior.detail.scale, 0.25, rtol=0.35)
    assert np.exp(np.mean(np.log(own.prior.detail.scale[1:]))) == pytest.approx(0.25, rel=0.12)
