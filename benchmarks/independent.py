"""Can a search that shares no code with the package find better designs or rivals than it does?

Transfer functions, expected error, paths, splines and starts are written anew from the docstrings;
of the package only the numbers of a `Scene` are read. The search screens random points, descends
from the best that differ by SciPy's SLSQP, with the scene's limits as constraints, and counts what
a finer quadrature confirms. Beside it each row's path is sampled and held against every limit, the
purchases must rise, and the command must print what the function finds.
"""

import json
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.interpolate import BSpline
from scipy.optimize import minimize

from benchmarks import harness
from benchmarks.scenes import scenes as six_scenes
from mishutter import (
    AbstractShutter,
    Comparison,
    FreeMotion,
    Limits,
    Scene,
    SplineShutter,
    Texture,
    compare,
    example_picture,
    example_scene,
    optimise,
)
from mishutter.evaluation.speed_knowledge import UNKNOWN_SPEED
from mishutter.model.motion import AbstractMotion, steady

ALLOWED = 0.02
"""How much better than the package's the independent figure may be; dB."""
NUM_COEFFICIENTS, DEGREE = 24, 3
NODES_PER_PIECE, NUM_FREQUENCIES = 16, 256
"""Gauss nodes for each polynomial piece of a profile, and frequencies; figures have twice both."""
NUM_SCREENED, NUM_DESCENTS, NUM_STEPS = 1000, 3, 150
NUM_PIECES = 12
"""Pieces of constant acceleration of a free path, as many as the package's have."""
MOST_PIECES_DIFFER = 20.0
"""How many times more or less than their mean, about, pieces of a free path accelerate."""
NUM_INSTANTS = 20_001
"""Instants at which the package's paths are sampled."""
SAME_LEVEL = 1e-4
"""Levels within which the comparison takes the plainer of two rows for the better; dB."""
SLACK = 1e-5
"""Share of a limit by which sampling and rounding may exceed it."""
LEAST_SHARE = 0.02
"""Least acceleration that is searched, over the largest within limits."""
MARGIN = 0.25
"""Velocities that are searched beyond the speeds that occur, over the width of their range."""
FAR = 0.2
"""Difference of two starts' motions in some coordinate."""


class Mode(NamedTuple):
    """A kind of camera: whether it codes its exposure, pans, accelerates, and how it may."""

    coded: bool
    pans: bool
    accelerates: bool
    is_free: bool = False
    is_told: bool = False
    """Whether its decoder is told the speed."""


SNAPSHOT = Mode(coded=False, pans=False, accelerates=False)
PANNED_SNAPSHOT = Mode(coded=False, pans=True, accelerates=False)
CODED_STILL = Mode(coded=True, pans=True, accelerates=False)
ACCELERATED = Mode(coded=True, pans=True, accelerates=True)
OPEN_TOLD = Mode(coded=False, pans=True, accelerates=True, is_told=True)
SHAPED_TOLD = Mode(coded=True, pans=True, accelerates=True, is_told=True)
ROWS = {
    "optimised": (ACCELERATED, CODED_STILL),
    "best snapshot": (SNAPSHOT,),
    "best panned snapshot": (PANNED_SNAPSHOT,),
    "best coded still": (CODED_STILL,),
}
"""Rows of the comparison, and the cameras the best of which each is."""


class Numbers(NamedTuple):
    """A scene's numbers, and nodes over the exposure with the basis of profiles on them.

    `stage` is its greatest travel, px, its acceleration, px/s^2, and whether it makes the pan.
    """

    speeds: np.ndarray
    weights: np.ndarray
    power: np.ndarray
    light: np.ndarray
    limits: np.ndarray
    stage: np.ndarray
    tau: np.ndarray
    basis: np.ndarray


class Track(NamedTuple):
    """A motion of equal pieces: half exposure, s, velocity at its middle, px/s, $a$, px/s^2."""

    half: Any
    velocity: Any
    accelerations: Any


@dataclass(frozen=True)
class Best:
    """The best of a search: expected PSNR, dB, its motion, and its point of the unit box."""

    psnr: float
    track: Track
    point: np.ndarray


def scenes() -> dict[str, Scene]:
    """Two of the six scenes of `benchmarks.scenes`, and ten of other speeds, light and stages."""
    known = six_scenes()
    photograph = Texture.of_photograph(example_picture())
    camera = {"max_stroke": 45, "max_top_speed": 2e4, "max_half_exposure": 0.04}
    usual = Limits(**camera, min_half_exposure=5e-4)
    quick = Limits(**camera, min_half_exposure=5e-5)
    held = Limits(
        max_stroke=30,
        max_top_speed=5000,
        min_half_exposure=5e-4,
        max_half_exposure=0.04,
        max_pan=0,
    )
    both_ways = np.linspace(-1, 1, 7)
    return {name: scene for name, scene in known.items() if name[:6] in ("street", "daylig")} | {
        "slow, one way: 100 to 600 px/s": Scene(
            np.linspace(100, 600, 5),
            photon_rate=5e4,
            read_noise=6.0,
            limits=usual,
            picture=photograph,
        ),
        "fast and dim, one way: 2,000 to 8,000 px/s": Scene(
            np.linspace(2000, 8000, 7), photon_rate=2e4, read_noise=3.0, limits=usual
        ),
        "lopsided: -1,000 to 4,000 px/s, most at rest": Scene(
            [-1000.0, 0.0, 500.0, 4000.0],
            [0.1, 0.5, 0.2, 0.2],
            photon_rate=1e5,
            read_noise=5.0,
            limits=usual,
            picture=photograph,
        ),
        "bright: both ways to 3,000 px/s, exposures from 0.1 ms": Scene(
            3000 * both_ways, photon_rate=5e6, read_noise=4.0, limits=quick
        ),
        "dim: both ways to 2,000 px/s, 5e3 e-/s": Scene(
            2000 * both_ways, photon_rate=5e3, read_noise=2.0, limits=usual, picture=photograph
        ),
        "no pan, top speed 5,000 px/s: one way, 1,000 to 4,000 px/s": Scene(
            np.linspace(1000, 4000, 7),
            photon_rate=1e5,
            read_noise=8.0,
            limits=held,
            picture=photograph,
        ),
        "two ways: 2,500 to 4,000 px/s either way, three in four of them to the right": Scene(
            [-4000.0, -3250.0, -2500.0, 2500.0, 3250.0, 4000.0],
            [0.05, 0.1, 0.1, 0.25, 0.25, 0.25],
            photon_rate=6e4,
            read_noise=4.0,
            limits=usual,
            picture=photograph,
        ),
        "short stroke: one way, 4,500 to 5,100 px/s, the stage of 2 px pans": Scene(
            np.linspace(4500, 5100, 5),
            photon_rate=1e5,
            read_noise=5.0,
            limits=Limits(max_stroke=2, min_half_exposure=5e-5, max_half_exposure=0.01),
        ),
        "turned camera: one way and back, -2,000 to 12,000 px/s": Scene(
            np.linspace(-2000, 12000, 15),
            photon_rate=4e5,
            read_noise=6.0,
            limits=Limits(
                max_stroke=25,
                max_top_speed=15000,
                min_half_exposure=1e-5,
                max_half_exposure=5e-3,
                pans="camera",
            ),
        ),
        "piezo stage: 39 px from rest to rest, 2.4e6 px/s^2, -500 to 1,500 px/s": Scene(
            np.linspace(-500, 1500, 6),
            photon_rate=4e4,
            read_noise=3.0,
            limits=Limits(
                max_stroke=39,
                max_top_speed=2e4,
                min_half_exposure=5e-4,
                max_half_exposure=0.04,
                max_travel=39,
                max_acceleration=2.4e6,
            ),
            picture=photograph,
        ),
    }


def numbers_of(scene: Scene, fineness: int = 1) -> Numbers:
    """The numbers of a scene, with so many times as many nodes and frequencies."""
    limits, count = scene.limits, NUM_FREQUENCIES * fineness
    frequency = (np.arange(count) + 0.5) / (2 * count)
    if scene.picture.power_spectrum is None:
        power = 1 / (frequency**2 + 0.01**2)
    else:
        given = np.asarray(scene.picture.power_spectrum)
        power = given[(2 * frequency * given.size).astype(int)]
    power = np.where(frequency <= float(scene.optics.cutoff_frequency), power, 0)
    power = power / power.mean() * float(scene.picture.deviation) ** 2
    tau, basis = _nodes(NODES_PER_PIECE * fineness)
    light = scene.photon_rate, scene.read_noise, scene.picture.mean_level
    furthest = limits.max_stroke, limits.max_top_speed, limits.max_pan
    exposures = limits.min_half_exposure, limits.max_half_exposure
    stage = [
        np.inf if limit is None else float(limit)
        for limit in (limits.max_travel, limits.max_acceleration)
    ]
    return Numbers(
        speeds=np.asarray(scene.speeds),
        weights=np.asarray(scene.weights),
        power=power,
        light=np.array([float(x) for x in light]),
        limits=np.array([float(x) for x in (*furthest, *exposures)]),
        stage=np.array([*stage, limits.pans == "stage"]),
        tau=tau,
        basis=basis,
    )


def _nodes(per_piece: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss nodes of all pieces, and the basis there times their share of the exposure."""
    edges = np.linspace(-1, 1, NUM_COEFFICIENTS - DEGREE + 1)
    place, weight = np.polynomial.legendre.leggauss(per_piece)
    half = (edges[1] - edges[0]) / 2
    tau = (edges[:-1, None] + half * (1 + place)).ravel()
    knots = np.concatenate([[-1.0] * DEGREE, edges, [1.0] * DEGREE])
    basis = BSpline(knots, np.eye(NUM_COEFFICIENTS), DEGREE)(tau)
    return tau, basis * np.tile(weight * half / 2, edges.size - 1)[:, None]


def motion_at(x: jax.Array, numbers: Numbers, mode: Mode) -> Track:
    """The motion at a point of the unit box, which may exceed the limits."""
    stroke, top, pan, shortest, longest = numbers.limits
    half = shortest * (longest / shortest) ** x[0]
    velocity, a = jnp.zeros(()), jnp.zeros(NUM_PIECES)
    if mode.accelerates:
        largest = jnp.minimum(stroke / half**2, top / (2 * half))
        a = a + largest * LEAST_SHARE ** (1 - x[1])
    if mode.is_free:
        a = a * MOST_PIECES_DIFFER ** (2 * x[3 : 3 + NUM_PIECES] - 1)
    if mode.pans:
        slowest, fastest = jnp.min(numbers.speeds), jnp.max(numbers.speeds)
        margin = MARGIN * (fastest - slowest)
        low, high = jnp.minimum(slowest - margin, 0), jnp.maximum(fastest + margin, 0)
        velocity = jnp.clip(low + x[2] * (high - low), -pan, pan)
    return Track(half, velocity, a)


def ends_of(track: Track) -> tuple[jax.Array, jax.Array]:
    """Velocity, px/s, and position, px, where the pieces of a path meet; shape `(K + 1,)`."""
    step = 2 * track.half / NUM_PIECES
    gained = jnp.concatenate([jnp.zeros(1), jnp.cumsum(2 * track.accelerations * step)])
    velocity = track.velocity + gained - gained[NUM_PIECES // 2]
    passed = jnp.cumsum((velocity[1:] + velocity[:-1]) / 2 * step)
    position = jnp.concatenate([jnp.zeros(1), passed])
    return velocity, position - position[NUM_PIECES // 2]


def uses(track: Track, numbers: Numbers) -> jax.Array:
    """Shares of stroke, top speed, pan, travel and acceleration that a path takes; `(5,)`."""
    stroke, top, pan, *_ = numbers.limits
    most_travel, most_acceleration, stage_pans = numbers.stage
    velocity, _ = ends_of(track)
    by_stage = track._replace(velocity=track.velocity * stage_pans)
    u, x = ends_of(by_stage)
    bends = by_stage.accelerations > 0
    turns = bends & (u[:-1] < 0) & (u[1:] > 0)
    lowest = jnp.min(
        jnp.where(
            turns, x[:-1] - u[:-1] ** 2 / (4 * jnp.where(bends, track.accelerations, 1)), x[0]
        )
    )
    lowest, highest = jnp.minimum(lowest, jnp.min(x)), jnp.max(x)
    run_up = x[0] - jnp.abs(u[0]) * u[0] / (2 * most_acceleration)
    run_out = x[-1] + jnp.abs(u[-1]) * u[-1] / (2 * most_acceleration)
    ends = jnp.stack([run_up, run_out])
    travel = jnp.maximum(highest, jnp.max(ends)) - jnp.minimum(lowest, jnp.min(ends))
    shares = [
        (highest - lowest) / stroke,
        jnp.max(jnp.abs(velocity)) / top,
        jnp.abs(track.velocity) / jnp.maximum(pan, 1e-9),
        travel / most_travel,
        2 * jnp.max(track.accelerations) / most_acceleration,
    ]
    return jnp.stack(shares)


@partial(jax.jit, static_argnums=2)
def within(x: jax.Array, numbers: Numbers, mode: Mode) -> jax.Array:
    """What is left of every limit at a point of the unit box, as a share; `(5,)`."""
    return 1 - uses(motion_at(x, numbers, mode), numbers)


@partial(jax.jit, static_argnums=2)
def decibels(x: jax.Array, numbers: Numbers, mode: Mode) -> jax.Array:
    """Expected squared error of the best single linear filter at a point of the unit box; dB."""
    profile = x[3 + NUM_PIECES :] if mode.coded else jnp.ones(NUM_COEFFICIENTS)
    track = motion_at(x, numbers, mode)
    return error_of(profile, track, numbers, mode)


def error_of(profile, track: Track, numbers: Numbers, mode: Mode) -> jax.Array:
    """Expected squared error of a profile's coefficients on a motion; dB."""
    half = track.half
    rate, read_noise, mean_level = numbers.light
    speeds = numbers.speeds
    tau = numbers.tau[None]
    if mode.is_free:
        position = _positions(track, numbers.tau)[None] - (half * speeds)[:, None] * tau
        position = position - _lowest(track, speeds)[:, None]
    else:
        seen, a = speeds - track.velocity, track.accelerations[0]
        position = a * (half * tau) ** 2 - (half * seen)[:, None] * tau
        if mode.accelerates:
            turn = jnp.clip(seen / (2 * a), -half, half)
            position = position - ((a * turn - seen) * turn)[:, None]
    light = numbers.basis @ profile
    response = _transfer(position, light, numbers.power.size)
    electrons = 2 * half * rate
    noise = light.sum() * mean_level / electrons + (read_noise / electrons) ** 2
    frequency = (np.arange(numbers.power.size) + 0.5) / (2 * numbers.power.size)
    power = numbers.power * jnp.sinc(frequency) ** 2
    if mode.is_told:
        lost = numbers.weights @ (noise / (power[None] * _squared(response) + noise))
        return 10 * jnp.log10(jnp.mean(numbers.power * lost))
    mean = jnp.sum(numbers.weights[:, None].astype(complex) * response, axis=0)
    spread = numbers.weights @ _squared(response - mean[None])
    lost = (power * spread + noise) / (power * (_squared(mean) + spread) + noise)
    return 10 * jnp.log10(jnp.mean(numbers.power * lost))


def _positions(track: Track, tau: Any) -> jax.Array:
    """Positions at times in half exposures; px, shape of `tau`."""
    velocity, position = ends_of(track)
    piece = jnp.clip((tau + 1) / 2 * NUM_PIECES, 0, NUM_PIECES - 1).astype(int)
    time = (tau - (2 * piece / NUM_PIECES - 1)) * track.half
    return position[piece] + velocity[piece] * time + track.accelerations[piece] * time**2


def _lowest(track: Track, speeds: np.ndarray) -> jax.Array:
    """Lowest position of objects on the sensor during the exposure; px, shape of `speeds`."""
    velocity, position = ends_of(track)
    times = (2 * np.arange(NUM_PIECES + 1) / NUM_PIECES - 1) * track.half
    x = position[None] - speeds[:, None] * times[None]
    u = velocity[None] - speeds[:, None]
    a = track.accelerations[None]
    turns = (u[:, :-1] < 0) & (u[:, 1:] > 0)
    turned = x[:, :-1] - jnp.where(turns, u[:, :-1] ** 2 / (4 * a), 0)
    return jnp.minimum(jnp.min(turned, axis=1), jnp.min(x, axis=1))


def _transfer(path: jax.Array, light: jax.Array, count: int) -> jax.Array:
    """Sums of waves along paths, px; shape `(speeds, count)`.

    The wave of frequency `16 j + l` is the product of two, so the sums are products of matrices.
    """
    num_fine, phase = 16, path[..., None] * (-jnp.pi / count)
    coarse = _wave(phase * np.arange(0.0, count, num_fine)[None, None])
    fine = _wave(phase * (np.arange(num_fine) + 0.5)[None, None])
    sums = jnp.einsum("sqj,sql->sjl", coarse * light[None, :, None].astype(complex), fine)
    return sums.reshape(path.shape[0], count)


def _wave(phase: jax.Array) -> jax.Array:
    return jax.lax.complex(jnp.cos(phase), jnp.sin(phase))


def _squared(value: jax.Array) -> jax.Array:
    return value.real**2 + value.imag**2


_with_gradient = jax.jit(jax.value_and_grad(decibels), static_argnums=2)
_slopes_of_limits = jax.jit(jax.jacrev(within), static_argnums=2)


def search(
    scene: Scene,
    mode: Mode,
    *,
    first: tuple[np.ndarray, ...] = (),
    num_screened: int = NUM_SCREENED,
    num_descents: int = NUM_DESCENTS,
) -> Best:
    """The best design of a kind of camera within limits; `first` are points to start from too."""
    numbers, fine = numbers_of(scene), numbers_of(scene, 2)
    random = np.random.default_rng(20)
    points = [_random_point(random) for _ in range(num_screened)]
    points = [x for x in points if np.min(within(x, numbers, mode)) > 0]
    losses = [float(decibels(x, numbers, mode)) for x in points]
    starts = [*first, *_differing(points, losses, num_descents)]
    rest = {"fun": lambda x: np.asarray(within(x, numbers, mode), float), "type": "ineq"}
    rest["jac"] = lambda x: np.asarray(_slopes_of_limits(x, numbers, mode), float)

    def descended(x: np.ndarray) -> np.ndarray:
        function = lambda x: tuple(np.asarray(y) for y in _with_gradient(x, numbers, mode))  # noqa: E731
        rules = {"maxiter": NUM_STEPS, "ftol": 1e-7}
        bounds = [(0, 1)] * x.size
        found = minimize(
            function, x, jac=True, method="SLSQP", bounds=bounds, constraints=rest, options=rules
        )
        end = np.clip(found.x, 0, 1)
        return end if np.min(within(end, numbers, mode)) > -SLACK else x

    ends = [descended(x) for x in starts]
    errors = [float(decibels(x, fine, mode)) for x in ends]
    best = int(np.argmin(errors))
    end = ends[best]
    return Best(-errors[best], motion_at(jnp.asarray(end), numbers, mode), end)


def _random_point(random: np.random.Generator) -> np.ndarray:
    """A motion, its pieces, and a profile that is a bump, a code, noise or a bump with some."""
    place = np.linspace(-1, 1, NUM_COEFFICIENTS)
    width, centre = np.exp(random.uniform(np.log(0.1), np.log(2))), random.uniform(-0.5, 0.5)
    bump = np.exp(-(np.abs((place - centre) / width) ** random.uniform(1.5, 8)))
    code = random.integers(0, 2, NUM_COEFFICIENTS)
    noise = random.uniform(size=NUM_COEFFICIENTS)
    profile = (bump, code, noise, bump + 0.3 * (noise - 0.5))[random.integers(4)]
    motion = random.uniform(size=3)
    motion[1] **= 0.5  # most near the fullest stroke
    walk = np.cumsum(random.standard_normal(NUM_PIECES)) * random.uniform(0, 0.1)
    pieces = np.clip(0.5 + walk - np.mean(walk), 0, 1)
    return np.concatenate([motion, pieces, np.clip(profile, 0, 1)])


def _differing(points: list[np.ndarray], losses: list[float], count: int) -> list[np.ndarray]:
    """The best points whose motions differ, and then the best of any."""
    order = np.argsort(losses)
    chosen: list[np.ndarray] = []
    for index in order:
        far = [np.max(np.abs(points[index][:3] - other[:3])) > FAR for other in chosen]
        if all(far) and len(chosen) < (count + 1) // 2:
            chosen.append(points[index])
    others = [points[i] for i in order if not any(points[i] is x for x in chosen)]
    return chosen + others[: count - len(chosen)]


def compared(scene: Scene) -> tuple[Comparison, dict[str, dict[str, float]]]:
    """A comparison, and its rows `beside` those of this search."""
    table = compare(scene, optimise(scene))
    names = {row.name for row in table.rows}
    return table, beside(scene, {name: table.row(name) for name in ROWS if name in names})


def beside(scene: Scene, rows: dict[str, Any], **effort: Any) -> dict[str, dict[str, float]]:
    """Expected PSNR, dB, velocity, px/s, and stroke, px, by the package and by this search.

    `anew` is what the package found by the measure of this search.

    Args:
        scene: Speeds, light, noise and limits.
        rows: Designs or rows of a comparison by the name of the row that they stand for.
        effort: Of `search`.
    """
    modes = {mode for name in rows for mode in ROWS[name]}
    ends = {mode: search(scene, mode, **effort) for mode in sorted(modes)}
    figures = {}
    for name, row in rows.items():
        best = max((ends[mode] for mode in ROWS[name]), key=lambda each: each.psnr)
        figures[name] = {
            "tool": float(UNKNOWN_SPEED.psnr(row.metrics)),
            "independent": best.psnr,
            "anew": measured_anew(scene, row.shutter, row.motion),
            "tool_velocity": float(row.motion.velocity),
            "independent_velocity": float(best.track.velocity),
            "tool_stroke": float(row.motion.stroke),
        }
    return figures


def measured_anew(
    scene: Scene, shutter: AbstractShutter, motion: AbstractMotion, *, is_told: bool = False
) -> float:
    """Expected PSNR of a design of the package by the measure of this search; dB."""
    profile = np.ones(NUM_COEFFICIENTS)
    if isinstance(shutter, SplineShutter):
        profile = np.asarray(shutter.coefficients)
    a = motion.accelerations if isinstance(motion, FreeMotion) else steady(motion).acceleration
    track = Track(
        float(motion.half_exposure), float(motion.velocity), np.ones(NUM_PIECES) * np.asarray(a)
    )
    accelerates = bool(np.max(a) > 0)
    is_free = isinstance(motion, FreeMotion) and accelerates
    mode = ACCELERATED._replace(accelerates=accelerates, is_free=is_free, is_told=is_told)
    return -float(error_of(profile, track, numbers_of(scene, 2), mode))


def most_used(scene: Scene, motion: AbstractMotion) -> float:
    """Share of the limit that a motion comes nearest to, from positions at many instants."""
    limits, half = scene.limits, float(motion.half_exposure)
    times = np.linspace(-half, half, NUM_INSTANTS)
    whole = np.asarray(motion.position(times), float)
    stage = whole - (float(motion.velocity) * times if limits.pans == "camera" else 0)
    speeds, speeds_of_stage = (np.diff(x) / np.diff(times) for x in (whole, stage))
    most = np.inf if limits.max_acceleration is None else float(limits.max_acceleration)
    u = speeds_of_stage[[0, -1]]
    ends = stage[[0, -1]] + np.array([-1, 1]) * u * np.abs(u) / (2 * most)
    travel = np.ptp(np.append(stage, ends))
    accelerations = np.diff(speeds) / (times[1] - times[0])
    shares = [
        np.ptp(stage) / float(limits.max_stroke),
        np.max(np.abs(speeds)) / float(limits.max_top_speed),
        abs(float(motion.velocity)) / max(float(limits.max_pan), 1e-9),
        half / float(limits.max_half_exposure),
        float(limits.min_half_exposure) / half,
        travel / (np.inf if limits.max_travel is None else float(limits.max_travel)),
        # The second difference of positions rounds by some 1e-4 of the largest.
        np.percentile(np.abs(accelerations), 99) / most,
    ]
    return float(np.max(shares))


def purchases_rise(table: Comparison) -> bool:
    """Whether no purchase is worse than one that it holds, by more than equals may differ."""
    levels = {name: row.level for name, row in table.rivals.items()}
    pairs = [("nothing", "a stage"), ("nothing", "a shutter")]
    pairs += [("a stage", "both"), ("a shutter", "both")]
    known = [(less, more) for less, more in pairs if less in levels and more in levels]
    return all(levels[less] <= levels[more] + SAME_LEVEL for less, more in known)


def command_agrees(scene: Scene, *, of_photograph: bool) -> bool:
    """Whether the command ends at the last digit of what the function finds for one file."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scene.toml"
        file.write_text(file_of(scene, of_photograph=of_photograph))
        command = [
            sys.executable,
            "-m",
            "mishutter",
            "optimise",
            str(file),
            "--json",
        ]
        printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
        design = optimise(Scene.load(file))
    return json.loads(printed)["design"]["loss"] == float(design.loss)


def file_of(scene: Scene, *, of_photograph: bool) -> str:
    """The text of a scene file."""
    limits = scene.limits
    lines = [
        "[speeds]",
        f"list_px_per_s = {np.asarray(scene.speeds).tolist()}",
        f"weights = {np.asarray(scene.weights).tolist()}",
        f"[light]\nphoton_rate_per_s = {float(scene.photon_rate)}",
        f"[sensor]\nread_noise_e = {float(scene.read_noise)}",
        f"[optics]\ncutoff_cycles_per_px = {float(scene.optics.cutoff_frequency)}",
        f"[limits]\npans = '{limits.pans}'",
        f"min_half_exposure_ms = {1e3 * float(limits.min_half_exposure)}",
        f"max_half_exposure_ms = {1e3 * float(limits.max_half_exposure)}",
        f"max_stroke_px = {float(limits.max_stroke)}",
        f"max_top_speed_px_per_s = {float(limits.max_top_speed)}",
        f"max_pan_px_per_s = {float(limits.max_pan)}",
    ]
    if limits.max_travel is not None:
        lines.append(f"max_travel_px = {float(limits.max_travel)}")
    if limits.max_acceleration is not None:
        lines.append(f"max_acceleration_px_per_s2 = {float(limits.max_acceleration)}")
    if of_photograph:
        lines.append("[picture]\npath = 'example'")
    return "\n".join(lines) + "\n"


def freed(scene: Scene) -> tuple[float, float]:
    """Velocity that a search ends at which may move it, px/s, and its gain over the default, dB."""
    design = optimise(scene, free=("shutter", "half_exposure", "velocity", "acceleration"))
    gain = design.metrics.expected_psnr - optimise(scene).metrics.expected_psnr
    return float(design.motion.velocity), float(gain)


def _summary(rows: dict[str, dict[str, float]]) -> dict[str, str]:
    cells = {}
    for name in ROWS:
        row = rows.get(name)
        cells[name] = f"{row['tool']:.3f} / {row['independent']:.3f}" if row else "-"
    return cells


def measured(name: str, scene: Scene) -> dict[str, Any]:
    """A row of the table: the best of a scene by either search, and what else is checked."""
    table, figures = compared(scene)
    best = max(figure["tool"] for figure in figures.values())
    anew = max(figure["independent"] for figure in figures.values())
    facts = {
        "best dB": f"{best:.3f} / {anew:.3f}",
        "of a limit": max(
            most_used(scene, row.motion) for row in table.rows if row.sequence is None
        ),
        "rises": purchases_rise(table),
        "command": command_agrees(scene, of_photograph=scene.picture.power_spectrum is not None),
    }
    return {"scene": name, **facts, **_summary(figures), "figures": figures}


def main() -> None:
    """Measure, store and print."""
    jax.config.update("jax_enable_x64", True)
    rows, start = [], time.perf_counter()
    for name, scene in scenes().items():
        rows.append(measured(name, scene))
        print(json.dumps(rows[-1]), f"{time.perf_counter() - start:.0f} s", flush=True)
    velocity, gain = freed(example_scene())
    every = [figure for row in rows for figure in row["figures"].values()]
    lead = max(figure["independent"] - figure["tool"] for figure in every)
    lead_anew = max(figure["independent"] - figure["anew"] for figure in every)
    apart = max(abs(figure["anew"] - figure["tool"]) for figure in every)
    pans = [row["figures"].get("best panned snapshot") for row in rows]
    pans_apart = max(abs(p["tool_velocity"] - p["independent_velocity"]) for p in pans if p)
    seconds = time.perf_counter() - start
    more = {"velocity": velocity, "gain": gain, "lead": lead, "lead_anew": lead_anew}
    harness.write("independent", rows, seconds=seconds, apart=apart, pans=pans_apart, **more)
    held = max(row["of a limit"] for row in rows)
    note = (
        "Expected PSNR, dB, by the package / by a search that shares no code with it. What that "
        f"search finds is at most {lead:+.4f} dB over what the package finds, and {lead_anew:+.4f} "
        f"dB where its own measure judges both ({ALLOWED} is allowed); the two measures of a "
        "design of the package, the other on twice as many frequencies, differ by at most "
        f"{apart:.4f} dB, and pans of snapshots by {pans_apart:.0f} px/s. Of every row the path "
        f"was sampled at {NUM_INSTANTS:,} instants: none takes more than {held:.5f} of a limit. "
        f"The purchases rise in {sum(row['rises'] for row in rows)} of {len(rows)} scenes, and the "
        f"command ends at the function's design to the last digit in "
        f"{sum(row['command'] for row in rows)}. On the built-in scene, which is symmetric, a "
        f"search that may pan ends at {abs(velocity):.2f} px/s, {round(gain, 4) + 0.0:+.4f} dB "
        "from the default."
    )
    columns = ["scene", "best dB", *ROWS]
    heading = "## An independent search for the same designs\n\n"
    harness.section("independent", f"{heading}{harness.table(rows, columns)}\n\n{note}")


if __name__ == "__main__":
    main()
