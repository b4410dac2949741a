"""Does the loss stay finite and right over its whole domain?

100,000 random scenes, motions and profiles, sensors at rest among them: the weighted design
loss and the expected-error loss with their gradients by profile, acceleration and half
exposure. A sample is computed again by other means: kernels by the 300-digit closed forms of
the tests, transfer functions by a fine quadrature in extended precision, slopes by differences
of those. Beside the losses stand two integrals with all of their derivatives: the transfer
function of a path that turns, and the kernel of a narrow Gaussian in single precision, by the
tests' closed forms. Run `python -m benchmarks.stress [COUNT] [SAMPLE]`; seeds are printed.
"""

import sys

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import mpmath as mp  # noqa: E402
import numpy as np  # noqa: E402
from scipy.interpolate import BSpline  # noqa: E402

from benchmarks import harness  # noqa: E402
from mishutter import (  # noqa: E402
    DesignLoss,
    ExpectedErrorLoss,
    ParabolicMotion,
    Scene,
    SplineShutter,
)
from mishutter.evaluation.losses import smooth_condition_number, value_of  # noqa: E402
from mishutter.evaluation.needs import Plan  # noqa: E402

PLAN = Plan(num_taps=40, dft_length=128, num_frequencies=32, num_nodes=320)
NUM_SPEEDS, NUM_COEFFICIENTS, BATCH = 3, 8, 1000
SEED, REACH = 20240917, 38.0
VALUE_BOUND, SLOPE_BOUND = 1e-12, 1e-9
"""Allowed error of a value, relative, and of a slope, of the largest, per unit of condition."""
LOSSES = {"design": DesignLoss(), "expected error": ExpectedErrorLoss()}
INTEGRALS = {
    "transfer function": np.float64,
    "transfer function, float32": np.float32,
    "narrow Gaussian's kernel, float32": np.float32,
}
EVALUATIONS_A_POINT = 20
"""Evaluations of a loss for each of an integral, which is called on its own."""


def points(rng: np.random.Generator, count: int) -> dict[str, np.ndarray]:
    """Random scenes and designs, with the edges of the domain among them."""
    half = 10 ** rng.uniform(-9, 5, count)
    nu = 10 ** rng.uniform(-4, 0.5, (count, NUM_SPEEDS)) * rng.choice(
        [-1, 0, 1], (count, NUM_SPEEDS)
    )
    nu[rng.uniform(size=count) < 0.1] = nu[0, 0]
    longest = REACH / (1 + np.max(np.abs(nu), axis=1)) ** 2
    stroke = 10 ** rng.uniform(-9, np.log10(longest), count)
    weights = rng.dirichlet(np.ones(NUM_SPEEDS), count) * rng.choice([0, 1], (count, NUM_SPEEDS))
    weights[:, 0] += 1 - weights.sum(axis=1)
    kind = rng.integers(0, 6, (count, 1))
    smooth = np.sort(rng.uniform(size=(count, NUM_COEFFICIENTS)))
    rough = rng.uniform(size=(count, NUM_COEFFICIENTS))
    sparse = (rough > 0.8).astype(float)
    shut, faint = np.zeros_like(rough), 1e-12 * rough
    profile = np.choose(kind, [smooth, rough, sparse, shut, faint, np.ones_like(rough)])
    dark = rng.uniform(size=count) < 0.05
    at_rest = rng.spawn(1)[0].uniform(size=count) < 0.05
    return {
        "box": profile,
        "acceleration": np.where(at_rest, 0.0, stroke / half**2),
        "half_exposure": half,
        "speeds": 2 * nu * (stroke / half)[:, None],
        "weights": weights,
        "photon_rate": np.where(dark, 0, 10 ** rng.uniform(0, 12, count) / half),
        "read_noise": np.where(rng.uniform(size=count) < 0.1, 0, 10 ** rng.uniform(-3, 3, count)),
    }


def value_and_slopes(loss, point: dict):
    """A loss and its slopes by profile, log acceleration and log half exposure."""

    def at(box, log_a, log_half):
        motion = ParabolicMotion(
            acceleration=point["acceleration"] * jnp.exp(log_a),
            half_exposure=point["half_exposure"] * jnp.exp(log_half),
        )
        scene = Scene(
            point["speeds"],
            point["weights"],
            photon_rate=point["photon_rate"],
            read_noise=point["read_noise"],
        )
        return value_of(loss, scene, motion, SplineShutter(box), PLAN)

    zero = jnp.zeros(())
    value, slopes = jax.value_and_grad(at, argnums=(0, 1, 2))(point["box"], zero, zero)
    return value, jnp.concatenate([slopes[0], jnp.stack(slopes[1:])])


def exact_loss(name: str, point: dict, direction: np.ndarray, step):
    """The loss some way along a direction, by other means than the package's."""
    step = np.longdouble(step)
    box = point["box"].astype(np.longdouble) + step * direction[:NUM_COEFFICIENTS]
    a = np.longdouble(point["acceleration"]) * np.exp(step * direction[-2])
    half = np.longdouble(point["half_exposure"]) * np.exp(step * direction[-1])
    compute = _exact_design if name == "design" else _exact_error
    return compute(point, box, a, half)


def _exact_design(point: dict, box, a, half):
    from support import reference

    window = reference.spline([mp.mpf(str(c)) for c in box])
    a, half = mp.mpf(str(a)), mp.mpf(str(half))
    turns = a > 0
    first = 0 if turns else -mp.mpf(PLAN.num_taps + 1) / 2
    edges = [k + first for k in range(PLAN.num_taps + 1)]

    def kernel(speed):
        # Past the end of the exposure the vertex is as far below the lowest place as this.
        sag, smear = a * half**2, abs(mp.mpf(float(speed))) * half
        below = (smear - 2 * sag) ** 2 / (4 * sag) if turns and smear > 2 * sag else 0
        places = [edge + below for edge in edges]
        taps = reference.exposures(window, a, half, float(speed), places, from_vertex=turns)
        return np.array([np.longdouble(mp.nstr(tap, 25)) for tap in taps])

    still = kernel(0.0)
    spread = sum(
        w * np.sum((kernel(s) - still) ** 2)
        for s, w in zip(point["speeds"], point["weights"], strict=True)
        if w > 0
    )
    energy = np.sum(still**2)
    turns = np.outer(np.arange(PLAN.dft_length // 2 + 1), np.arange(PLAN.num_taps))
    angle = (2 * np.pi * (turns % PLAN.dft_length) / PLAN.dft_length).astype(np.longdouble)
    wave = np.cos(angle) @ still, np.sin(angle) @ still
    power = wave[0] ** 2 + wave[1] ** 2
    logarithm = np.log(power / power.max() + np.finfo(np.float64).eps ** 2)
    decay = -200 * logarithm
    deepest = decay.max()
    sums = np.sum(np.exp(-decay)) * np.sum(np.exp(decay - deepest))
    condition = np.exp((np.log(sums) + deepest) / 400)
    light = np.longdouble(mp.nstr(window.total / 2, 25))
    return 0.1 * condition + np.sqrt(spread / energy) + 1 - light


def _exact_error(point: dict, box, a, half):
    count = NUM_COEFFICIENTS - 3
    knots = np.concatenate([-np.ones(3), np.linspace(-1, 1, count + 1), np.ones(3)])
    x, weight = np.polynomial.legendre.leggauss(24)
    ends = np.linspace(-1, 1, 16 * count + 1)
    tau = (ends[:-1, None] + np.diff(ends)[:, None] * (x + 1) / 2).ravel()
    share = np.tile(weight, 16 * count) / (32 * count)
    basis = BSpline.design_matrix(tau, knots, 3).toarray()
    light = share * (basis.astype(np.longdouble) @ box)
    frequency = (np.arange(PLAN.num_frequencies) + 0.5) / (2 * PLAN.num_frequencies)
    power = 1 / (frequency**2 + 0.01**2)
    power *= 0.04 / np.mean(power)
    spectra = []
    for speed in point["speeds"]:
        sag, smear = a * half * half, abs(np.longdouble(speed)) * half
        lowest = -(smear**2) / (4 * sag) if smear < 2 * sag else sag - smear
        position = sag * tau**2 - speed * half * tau - (lowest if a > 0 else 0)
        angle = 2 * np.longdouble(np.pi) * frequency[:, None] * position
        aperture = np.sinc(frequency)
        spectra.append((aperture * (np.cos(angle) @ light), aperture * (np.sin(angle) @ light)))
    spectra = np.array(spectra)
    p = point["weights"][:, None, None]
    mean = np.sum(p * spectra, axis=0)
    spread = np.sum(p * (spectra - mean) ** 2, axis=(0, 1))
    coherent = np.sum(mean**2, axis=0)
    electrons = point["photon_rate"] * 2 * half
    noise = np.sum(light) * 0.25 * electrons + point["read_noise"] ** 2
    signal = power * electrons**2
    total = signal * (coherent + spread) + noise
    dark = total <= 0
    left = np.where(dark, 1, (signal * spread + noise) / np.where(dark, 1, total))
    return np.sqrt(np.mean(power * left) / 0.04)


def checked(name: str, point: dict, value: float, slopes: np.ndarray, rng) -> dict:
    """How far a loss and one slope of it are from what they should be, in units of the bounds."""
    direction = rng.normal(size=slopes.size)
    folded = (point["box"] < 1e-3) | (point["box"] > 1 - 1e-3)
    direction[:NUM_COEFFICIENTS][folded] = 0
    direction /= np.linalg.norm(direction)
    step = 1e-6
    exact, *around = (exact_loss(name, point, direction, k * step) for k in (0, 1, -1, 2, -2))
    slope = (8 * (around[0] - around[1]) - (around[2] - around[3])) / (12 * step)
    condition = _condition(point) if name == "design" else 1.0
    largest = max(np.max(np.abs(slopes)), abs(value))
    return {
        "value": float(abs(value - exact) / (VALUE_BOUND * condition * abs(exact))),
        "slope": float(abs(slopes @ direction - slope) / (SLOPE_BOUND * condition * largest)),
    }


def _condition(point: dict) -> float:
    from mishutter import blur_kernel

    motion = ParabolicMotion(
        acceleration=point["acceleration"], half_exposure=point["half_exposure"]
    )
    still = blur_kernel(SplineShutter(point["box"]), motion, num_taps=PLAN.num_taps)
    return float(smooth_condition_number(jnp.fft.rfft(still, PLAN.dft_length)))


def measure(count: int, sample: int) -> list[dict]:
    """A row a loss: how many evaluations, how many not finite, the worst of the sample."""
    rows = []
    for name, loss in LOSSES.items():
        run = jax.jit(jax.vmap(lambda point, loss=loss: value_and_slopes(loss, point)))
        row = {"loss": name, "evaluations": 0, "not finite": 0, "re-checked": 0}
        row |= {"worst value / bound": 0.0, "worst slope / bound": 0.0, "seed": SEED}
        for batch in range(count // BATCH):
            rng = np.random.default_rng([SEED, batch])
            drawn = points(rng, BATCH)
            values, slopes = (np.asarray(x) for x in run(drawn))
            finite = np.isfinite(values) & np.all(np.isfinite(slopes), axis=1)
            row["evaluations"] += BATCH
            row["not finite"] += int(np.sum(~finite))
            for index in _sampled(rng, drawn, sample * BATCH / count):
                point = {key: array[index] for key, array in drawn.items()}
                errors = checked(name, point, values[index], slopes[index], rng)
                row["re-checked"] += 1
                row["worst value / bound"] = max(row["worst value / bound"], errors["value"])
                row["worst slope / bound"] = max(row["worst slope / bound"], errors["slope"])
        rows.append(row)
    return rows


def integrals(count: int, sample: int) -> list[dict]:
    """A row an integral, as `measure` gives for a loss; the bounds are those of the tests."""
    rows = []
    for name, dtype in INTEGRALS.items():
        rng, points, share = np.random.default_rng(SEED), count // EVALUATIONS_A_POINT, 0.0
        row = {"loss": name, "evaluations": points, "not finite": 0, "re-checked": 0}
        row |= {"worst value / bound": 0.0, "worst slope / bound": 0.0, "seed": SEED}
        for _ in range(points):
            share += sample / points
            found, errors = _integral(name, dtype, rng)
            row["not finite"] += not all(np.all(np.isfinite(x)) for x in found)
            if share < 1:
                continue
            share -= 1
            row["re-checked"] += 1
            for column, error in zip(("value", "slope"), errors(), strict=True):
                row[f"worst {column} / bound"] = max(row[f"worst {column} / bound"], error)
        rows.append(row)
    return rows


def _integral(name: str, dtype: type, rng: np.random.Generator):
    """Value and derivatives at a random point, and what finds the errors of both."""
    from support import helpers
    from support.cases import SHUTTERS

    if name.startswith("transfer"):
        point = helpers.turning_point(rng, dtype, str(rng.choice(list(SHUTTERS))))
        frequencies = helpers.turning_frequencies(rng, point)
        both = helpers.transfer_error, helpers.transfer_derivative_error
        return (
            helpers.transferred(point, frequencies),
            lambda: [error(point, frequencies) for error in both],
        )
    point = helpers.random_point(rng, dtype, "gaussian-narrow")
    taps, derivatives = helpers.computed(point)
    arguments = [
        k for k in helpers.ARGUMENTS if k != "position" or not helpers.edge_at_vertex(point)
    ]

    def errors():
        exact = helpers.exact_taps(point)
        slopes = [
            helpers.derivative_error(derivatives[:, helpers.ARGUMENTS.index(k)], point, k, exact)
            for k in arguments
        ]
        return helpers.tap_error(taps, point, exact), max(slopes)

    wanted = [helpers.ARGUMENTS.index(k) for k in arguments]
    return (taps, derivatives[:, wanted]), errors


def _sampled(rng: np.random.Generator, drawn: dict, mean: float) -> list[int]:
    """Some points of a batch at which slopes exist: not a closed shutter, nor equal kernels.

    A coefficient at 0 or 1 is folded there; the slope is then checked along the others.
    """
    spread = np.sum(drawn["weights"] * (drawn["speeds"] != 0), axis=1) > 0
    candidates = np.flatnonzero(spread & (drawn["box"].max(axis=1) > 1e-6))
    return rng.permutation(candidates)[: rng.poisson(mean)].tolist()


def main() -> None:
    """Measure, store and print."""
    given = [int(x) for x in sys.argv[1:] if x.isdigit()]
    count, sample = given + [100_000, 500][len(given) :]
    rows = measure(count, sample) + integrals(count, sample)
    harness.write("stress", rows)
    text = "## Stress: random scenes and designs, value and gradient of losses and integrals\n\n"
    harness.section("stress", text + harness.table(rows, list(rows[0])))


if __name__ == "__main__":
    main()
