"""Can a search that shares no code with the package find better designs or rivals than it does?

Transfer functions, expected error, splines and starts are written anew from the docstrings; of the
package only the numbers of a `Scene` are read. The search screens random points of the limits,
descends from the best that differ by SciPy's L-BFGS-B, and counts what a finer quadrature confirms.
"""

import time
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.interpolate import BSpline
from scipy.optimize import minimize

from benchmarks import harness
from benchmarks.scenes import scenes as six_scenes
from mishutter import (
    AbstractMotion,
    AbstractShutter,
    Limits,
    Scene,
    SplineShutter,
    compare,
    example_picture,
    example_scene,
    optimise,
    row_power_spectrum,
)
from mishutter.model import steady

ALLOWED = 0.02
"""How much better than the package's the independent figure may be; dB."""
NUM_COEFFICIENTS, DEGREE = 24, 3
NODES_PER_PIECE, NUM_FREQUENCIES = 16, 256
"""Gauss nodes for each polynomial piece of a profile, and frequencies; figures have twice both."""
NUM_SCREENED, NUM_DESCENTS, NUM_STEPS = 2000, 10, 300
LEAST_SHARE = 0.02
"""Least acceleration that is searched, over the largest within limits."""
MARGIN = 0.25
"""Velocities that are searched beyond the speeds that occur, over the width of their range."""
FAR = 0.2
"""Difference of two starts' motions in some coordinate."""


class Mode(NamedTuple):
    """A kind of camera: whether it codes its exposure, pans and accelerates."""

    coded: bool
    pans: bool
    accelerates: bool


SNAPSHOT = Mode(coded=False, pans=False, accelerates=False)
PANNED_SNAPSHOT = Mode(coded=False, pans=True, accelerates=False)
CODED_STILL = Mode(coded=True, pans=True, accelerates=False)
ACCELERATED = Mode(coded=True, pans=True, accelerates=True)
ROWS = {
    "optimised": (ACCELERATED, CODED_STILL),
    "best snapshot": (SNAPSHOT,),
    "best panned snapshot": (PANNED_SNAPSHOT,),
    "best coded still": (CODED_STILL,),
}
"""Rows of the comparison, and the cameras the best of which each is."""


class Numbers(NamedTuple):
    """A scene's numbers, and nodes over the exposure with the basis of profiles on them."""

    speeds: np.ndarray
    weights: np.ndarray
    power: np.ndarray
    light: np.ndarray
    limits: np.ndarray
    tau: np.ndarray
    basis: np.ndarray


@dataclass(frozen=True)
class Found:
    """The best of a search: expected PSNR, dB, and motion in s, px/s, px/s^2."""

    psnr: float
    half_exposure: float
    velocity: float
    acceleration: float


def scenes() -> dict[str, Scene]:
    """Two of the six scenes of `benchmarks.scenes`, and six of other speeds and light."""
    known = six_scenes()
    photograph = row_power_spectrum(example_picture(), 256)._asdict()
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
            np.linspace(100, 600, 5), photon_rate=5e4, read_noise=6.0, limits=usual, **photograph
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
            **photograph,
        ),
        "bright: both ways to 3,000 px/s, exposures from 0.1 ms": Scene(
            3000 * both_ways, photon_rate=5e6, read_noise=4.0, limits=quick
        ),
        "dim: both ways to 2,000 px/s, 5e3 e-/s": Scene(
            2000 * both_ways, photon_rate=5e3, read_noise=2.0, limits=usual, **photograph
        ),
        "no pan, top speed 5,000 px/s: one way, 1,000 to 4,000 px/s": Scene(
            np.linspace(1000, 4000, 7), photon_rate=1e5, read_noise=8.0, limits=held, **photograph
        ),
    }


def numbers_of(scene: Scene, fineness: int = 1) -> Numbers:
    """The numbers of a scene, with so many times as many nodes and frequencies."""
    limits, count = scene.limits, NUM_FREQUENCIES * fineness
    frequency = (np.arange(count) + 0.5) / (2 * count)
    if scene.power_spectrum is None:
        power = 1 / (frequency**2 + 0.01**2)
    else:
        given = np.asarray(scene.power_spectrum)
        power = given[(2 * frequency * given.size).astype(int)]
    power = np.where(frequency <= float(scene.cutoff_frequency), power, 0)
    power = power / power.mean() * float(scene.deviation) ** 2
    tau, basis = _nodes(NODES_PER_PIECE * fineness)
    light = scene.photon_rate, scene.read_noise, scene.mean_level
    furthest = limits.max_stroke, limits.max_top_speed, limits.max_pan
    exposures = limits.min_half_exposure, limits.max_half_exposure
    return Numbers(
        speeds=np.asarray(scene.speeds),
        weights=np.asarray(scene.weights),
        power=power,
        light=np.array([float(x) for x in light]),
        limits=np.array([float(x) for x in (*furthest, *exposures)]),
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


def motion_at(x: jax.Array, numbers: Numbers, mode: Mode) -> tuple:
    """Half exposure, velocity and acceleration at a point of the unit box."""
    stroke, top, pan, shortest, longest = numbers.limits
    half = shortest * (longest / shortest) ** x[0]
    acceleration = velocity = jnp.zeros(())
    if mode.accelerates:
        largest = jnp.minimum(stroke / half**2, top / (2 * half))
        acceleration = largest * LEAST_SHARE ** (1 - x[1])
    if mode.pans:
        slowest, fastest = jnp.min(numbers.speeds), jnp.max(numbers.speeds)
        margin = MARGIN * (fastest - slowest)
        most = jnp.minimum(pan, jnp.maximum(top - 2 * acceleration * half, 0))
        low, high = jnp.minimum(slowest - margin, 0), jnp.maximum(fastest + margin, 0)
        velocity = jnp.clip(low + x[2] * (high - low), -most, most)
    return half, velocity, acceleration


@partial(jax.jit, static_argnums=2)
def decibels(x: jax.Array, numbers: Numbers, mode: Mode) -> jax.Array:
    """Expected squared error of the best single linear filter at a point of the unit box; dB."""
    motion = motion_at(x, numbers, mode)
    profile = x[3:] if mode.coded else jnp.ones(NUM_COEFFICIENTS)
    return error_of(profile, motion, numbers, accelerates=mode.accelerates)


def error_of(profile, motion: tuple, numbers: Numbers, *, accelerates: bool) -> jax.Array:
    """Expected squared error of a profile's coefficients on a motion; dB."""
    half, velocity, acceleration = motion
    rate, read_noise, mean_level = numbers.light
    speeds = numbers.speeds - velocity
    tau = numbers.tau[None]
    path = acceleration * (half * tau) ** 2 - (half * speeds)[:, None] * tau
    if accelerates:
        path = path + (speeds**2 / (4 * acceleration))[:, None]
    light = numbers.basis @ profile
    response = _transfer(path, light, numbers.power.size)
    mean = jnp.sum(numbers.weights[:, None].astype(complex) * response, axis=0)
    spread = numbers.weights @ _squared(response - mean[None])
    electrons = 2 * half * rate
    noise = light.sum() * mean_level / electrons + (read_noise / electrons) ** 2
    frequency = (np.arange(numbers.power.size) + 0.5) / (2 * numbers.power.size)
    power = numbers.power * jnp.sinc(frequency) ** 2
    lost = (power * spread + noise) / (power * (_squared(mean) + spread) + noise)
    return 10 * jnp.log10(jnp.mean(numbers.power * lost))


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


def search(
    scene: Scene, mode: Mode, *, num_screened: int = NUM_SCREENED, num_descents: int = NUM_DESCENTS
) -> Found:
    """The best design of a kind of camera within a scene's limits."""
    numbers, fine = numbers_of(scene), numbers_of(scene, 2)
    random = np.random.default_rng(20)
    points = [_random_point(random) for _ in range(num_screened)]
    starts = _differing(points, [float(decibels(x, numbers, mode)) for x in points], num_descents)

    def descended(x: np.ndarray) -> np.ndarray:
        function = lambda x: tuple(np.asarray(y) for y in _with_gradient(x, numbers, mode))  # noqa: E731
        rules = {"maxiter": NUM_STEPS, "ftol": 1e-9, "gtol": 1e-6}
        bounds = [(0, 1)] * x.size
        return minimize(function, x, jac=True, method="L-BFGS-B", bounds=bounds, options=rules).x

    ends = [descended(x) for x in starts]
    errors = [float(decibels(x, fine, mode)) for x in ends]
    best = int(np.argmin(errors))
    return Found(
        -errors[best], *(float(x) for x in motion_at(jnp.asarray(ends[best]), numbers, mode))
    )


def _random_point(random: np.random.Generator) -> np.ndarray:
    """A motion, and a profile that is a bump, a code, noise or a bump with some of it."""
    place = np.linspace(-1, 1, NUM_COEFFICIENTS)
    width, centre = np.exp(random.uniform(np.log(0.1), np.log(2))), random.uniform(-0.5, 0.5)
    bump = np.exp(-(np.abs((place - centre) / width) ** random.uniform(1.5, 8)))
    code = random.integers(0, 2, NUM_COEFFICIENTS)
    noise = random.uniform(size=NUM_COEFFICIENTS)
    profile = (bump, code, noise, bump + 0.3 * (noise - 0.5))[random.integers(4)]
    motion = random.uniform(size=3)
    motion[1] **= 0.5  # most near the fullest stroke
    return np.concatenate([motion, np.clip(profile, 0, 1)])


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


def compared(scene: Scene) -> dict[str, dict[str, float]]:
    """The rows of a comparison `beside` those of this search."""
    table = compare(scene, optimise(scene))
    names = {row.name for row in table.rows}
    return beside(scene, {name: table.row(name) for name in ROWS if name in names})


def beside(scene: Scene, rows: dict[str, Any], **effort: int) -> dict[str, dict[str, float]]:
    """Expected PSNR, dB, velocity, px/s, and stroke, px, by the package and by this search.

    `anew` is what the package found by the measure of this search.

    Args:
        scene: Speeds, light, noise and limits.
        rows: Designs or rows of a comparison by the name of the row that they stand for.
        effort: Of `search`.
    """
    modes = {mode for name in rows for mode in ROWS[name]}
    found = {mode: search(scene, mode, **effort) for mode in modes}
    figures = {}
    for name, row in rows.items():
        best = max((found[mode] for mode in ROWS[name]), key=lambda each: each.psnr)
        figures[name] = {
            "tool": float(row.metrics.expected_psnr),
            "independent": best.psnr,
            "anew": measured_anew(scene, row.shutter, row.motion),
            "tool_velocity": float(row.motion.velocity),
            "independent_velocity": best.velocity,
            "tool_stroke": float(row.motion.stroke),
            "independent_stroke": best.acceleration * best.half_exposure**2,
        }
    return figures


def measured_anew(scene: Scene, shutter: AbstractShutter, motion: AbstractMotion) -> float:
    """Expected PSNR of a design of the package by the measure of this search; dB."""
    profile = np.ones(NUM_COEFFICIENTS)
    if isinstance(shutter, SplineShutter):
        profile = np.asarray(shutter.coefficients)
    a = float(steady(motion).acceleration)
    numbers = float(motion.half_exposure), float(motion.velocity), a
    return -float(error_of(profile, numbers, numbers_of(scene, 2), accelerates=a > 0))


def freed(scene: Scene) -> tuple[float, float]:
    """Velocity that a search ends at which may move it, px/s, and its gain over the default, dB."""
    design = optimise(scene, free=("shutter", "half_exposure", "velocity", "acceleration"))
    gain = design.metrics.expected_psnr - optimise(scene).metrics.expected_psnr
    return float(design.motion.velocity), float(gain)


def _summary(rows: dict[str, dict[str, float]]) -> dict[str, str]:
    cells = {}
    for name in ROWS:
        row = rows.get(name)
        cells[f"{name} dB"] = f"{row['tool']:.3f} / {row['independent']:.3f}" if row else "-"
    for name, (camera, *_) in ROWS.items():
        if camera.pans and name in rows:
            pans = rows[name]["tool_velocity"], rows[name]["independent_velocity"]
            cells[f"{name} px/s"] = " / ".join(str(round(pan)) for pan in pans)
    return cells


def main() -> None:
    """Measure, store and print."""
    jax.config.update("jax_enable_x64", True)
    rows, start = [], time.perf_counter()
    for name, scene in scenes().items():
        figures = compared(scene)
        rows.append({"scene": name, **_summary(figures), "figures": figures})
        print(name, figures, f"{time.perf_counter() - start:.0f} s", flush=True)
    velocity, gain = freed(example_scene())
    every = [figure for row in rows for figure in row["figures"].values()]
    lead = max(figure["independent"] - figure["tool"] for figure in every)
    lead_anew = max(figure["independent"] - figure["anew"] for figure in every)
    apart = max(abs(figure["anew"] - figure["tool"]) for figure in every)
    seconds = time.perf_counter() - start
    more = {"velocity": velocity, "gain": gain, "lead": lead, "lead_anew": lead_anew}
    harness.write("independent", rows, seconds=seconds, apart=apart, **more)
    note = (
        "Each cell is the package / a search that shares no code with it. What that search finds "
        f"is at most {lead:+.4f} dB over what the package finds, and {lead_anew:+.4f} dB where its "
        f"own measure judges both ({ALLOWED} is allowed); the two measures of a design of the "
        f"package, the other on twice as many frequencies, differ by at most {apart:.4f} dB. On "
        "the built-in scene, which is symmetric, a search that may pan ends at "
        f"{abs(velocity):.2f} px/s, {round(gain, 4) + 0.0:+.4f} dB from the default."
    )
    columns = [column for column in rows[0] if column != "figures"]
    heading = "## An independent search for the same designs\n\n"
    harness.section("independent", f"{heading}{harness.table(rows, columns)}\n\n{note}")


if __name__ == "__main__":
    main()
