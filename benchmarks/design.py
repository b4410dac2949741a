"""Which search is quickest to a good design, from 1 start and from 64?

Wall time against the gap to the best loss that any of them found, on one problem: a profile
of 24 coefficients, nine speeds, the weighted design loss. Every method is given the same
starts and the same compiled loss and gradient, and BLAS in one thread, as `optimise` sets it:
SciPy's own steps take up to a hundred times longer in two that wait for each other. Run
`python -m benchmarks.design`; a typical printout stands in `RESULTS.md`.
"""

import time
import warnings
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402
import optax  # noqa: E402
import optimistix as optx  # noqa: E402
from scipy.optimize import minimize  # noqa: E402

from benchmarks import harness  # noqa: E402
from mishutter import (  # noqa: E402
    DesignLoss,
    Limits,
    ParabolicMotion,
    Scene,
    SplineShutter,
    TukeyShutter,
    optimise,
)
from mishutter._core.parallel import alone_in_blas  # noqa: E402
from mishutter.evaluation.needs import needed_speeds, reduced, sizes  # noqa: E402
from mishutter.search.objective import AbstractObjective, objective_of  # noqa: E402
from mishutter.search.planning import plan as plan_of_scene  # noqa: E402
from mishutter.search.solvers import loss_and_gradient, losses_at, minimise  # noqa: E402
from mishutter.search.space import design_space  # noqa: E402
from mishutter.search.starts import start_boxes  # noqa: E402

NUM_STEPS = 150
MARKERS = "osv^<>DPX*"
WHOLE, OURS = "optimise (ours, the whole call)", "Optimistix BFGS (ours)"


def given() -> tuple[Scene, ParabolicMotion, SplineShutter]:
    """What `optimise` is called with: 24 coefficients and nine speeds."""
    motion = ParabolicMotion(acceleration=45 / 1e-4, half_exposure=1e-2)
    limits = Limits(max_stroke=45.0, max_top_speed=2e4)
    scene = Scene.uniform(
        max_speed=4500.0, num_speeds=9, photon_rate=1e5, read_noise=8.0, limits=limits
    )
    return scene, motion, SplineShutter.fit(TukeyShutter(0.5), 24)


def problem() -> tuple[AbstractObjective, AbstractObjective, np.ndarray]:
    """The objective as `optimise` plans it and computed from scratch, and 64 starts."""
    scene, motion, shutter = given()
    space, loss = design_space(scene, motion, shutter, "shutter"), DesignLoss()
    planned = plan_of_scene(scene, motion, shutter, loss=loss, free="shutter").sizes
    objective = objective_of(loss, reduced(scene, planned), space, planned)
    from_scratch = objective_of(
        loss, needed_speeds(scene, motion, shutter), space, sizes(scene, motion)
    )
    return objective, from_scratch, start_boxes(space, 64, seed=0)


def whole_call(_, starts):
    """`optimise` as it is called: the plan, the lowest of a cover, a polish of each, the proof."""
    options = {"loss": DesignLoss(), "free": "shutter", "max_steps": NUM_STEPS}
    return np.array([optimise(*given(), num_starts=len(starts), **options).loss])


def optimistix_bfgs(objective, starts):
    """What `optimise` runs where a motion moves: from one start after the other, in angles."""
    ends = [minimise(objective, start, max_steps=NUM_STEPS)[0] for start in starts]
    return losses_at(objective, np.stack(ends))


def optimistix_lbfgs(objective, starts):
    """Every start at once, with limited memory, bounds through a sine squared."""
    solver = optx.LBFGS(rtol=1e-7, atol=1e-7)

    def one(theta):
        return optx.minimise(
            lambda y, _: objective(jnp.sin(y) ** 2), solver, theta, max_steps=NUM_STEPS, throw=False
        ).value

    theta = jnp.arcsin(jnp.sqrt(jnp.clip(jnp.asarray(starts), 0.02, 0.98)))
    return _losses(objective, jnp.sin(_compiled(jax.vmap(one), "lbfgs")(theta)) ** 2)


def optax_adam(objective, starts):
    """First order, every start at once."""
    adam = optax.adam(0.03)

    def one(theta):
        def step(carry, _):
            y, state = carry
            gradient = jax.grad(lambda z: objective(jnp.sin(z) ** 2))(y)
            update, state = adam.update(gradient, state)
            return (optax.apply_updates(y, update), state), None

        return jax.lax.scan(step, (theta, adam.init(theta)), length=4 * NUM_STEPS)[0][0]

    theta = jnp.arcsin(jnp.sqrt(jnp.clip(jnp.asarray(starts), 0.02, 0.98)))
    return _losses(objective, jnp.sin(_compiled(jax.vmap(one), "adam")(theta)) ** 2)


@lru_cache
def _jaxopt():
    """Jaxopt, without its farewell."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        import jaxopt
    return jaxopt


def jaxopt_projected_gradient(objective, starts):
    """Projection on the box, every start at once."""
    solver = _jaxopt().ProjectedGradient(
        lambda x: objective(x), _jaxopt().projection.projection_box, maxiter=NUM_STEPS
    )
    run = jax.vmap(lambda x: solver.run(x, hyperparams_proj=(0.0, 1.0)).params)
    return _losses(objective, _compiled(run, "projected")(jnp.asarray(starts)))


def jaxopt_lbfgsb(objective, starts):
    """Box-constrained, limited memory, every start at once."""
    solver = _jaxopt().LBFGSB(lambda x: objective(x), maxiter=NUM_STEPS)
    low, high = jnp.zeros(starts.shape[1]), jnp.ones(starts.shape[1])
    run = jax.vmap(lambda x: solver.run(x, bounds=(low, high)).params)
    return _losses(objective, _compiled(run, "lbfgsb")(jnp.asarray(starts)))


def scipy_with_gradient(objective, starts):
    """SciPy's L-BFGS-B in a loop, with the same compiled gradient."""

    def value(x):
        loss, gradient = loss_and_gradient(objective, jnp.asarray(x))
        return float(loss), np.asarray(gradient)

    bounds = [(0, 1)] * starts.shape[1]
    options = {"maxiter": NUM_STEPS}
    return np.array(
        [
            minimize(value, x, jac=True, bounds=bounds, method="L-BFGS-B", options=options).fun
            for x in starts
        ]
    )


def scipy_without_gradient(objective, starts):
    """The same by finite differences, from at most two starts."""
    value = _compiled(lambda x: objective(x), "value")
    bounds = [(0, 1)] * starts.shape[1]
    options = {"maxiter": NUM_STEPS}
    return np.array(
        [
            minimize(lambda x: float(value(x)), x, bounds=bounds, options=options).fun
            for x in starts[:2]
        ]
    )


def random_search(objective, starts):
    """As many random profiles as the others take steps."""
    boxes = np.random.default_rng(1).uniform(size=(len(starts) * NUM_STEPS, starts.shape[1]))
    return _losses(objective, jnp.asarray(boxes))


METHODS = {
    WHOLE: whole_call,
    OURS: optimistix_bfgs,
    "Optimistix LBFGS": optimistix_lbfgs,
    "jaxopt LBFGSB": jaxopt_lbfgsb,
    "jaxopt projected gradient": jaxopt_projected_gradient,
    "Optax Adam": optax_adam,
    "SciPy L-BFGS-B, same gradient": scipy_with_gradient,
    "SciPy L-BFGS-B, gradient from scratch": scipy_with_gradient,
    "SciPy L-BFGS-B, differences": scipy_without_gradient,
    "random search": random_search,
}
_programs: dict[str, Callable[..., Any]] = {}


def _compiled(function, name):
    """One program a method, as a user who calls it twice would have."""
    return _programs.setdefault(name, jax.jit(function))


def _losses(objective, boxes):
    return np.asarray(_compiled(jax.vmap(objective), "losses")(boxes))


@alone_in_blas()
def measure() -> list[dict]:
    """First call and steady state of every method, from 1 and from 64 starts."""
    planned, from_scratch, starts = problem()
    rows = []
    for name, method in METHODS.items():
        objective = from_scratch if name.endswith("from scratch") else planned
        for count in (1, 64):
            try:
                seconds, losses = [], np.zeros(0)
                for _ in range(6):
                    start = time.perf_counter()
                    losses = method(objective, starts[:count])
                    seconds.append(time.perf_counter() - start)
                row = {"first_s": seconds[0], "best_s": min(seconds[1:]), "samples_s": seconds}
                row |= {"loss": float(np.min(losses)), "starts": count}
            except Exception as error:
                row = harness.failed(error) | {"loss": float("nan"), "starts": count}
            rows.append({"method": name, **{k: v for k, v in row.items() if k != "value"}})
    best = np.nanmin([row["loss"] for row in rows])
    for row in rows:
        row["gap"] = row["loss"] - best
    return rows


def picture(rows: list[dict]):
    """Wall time against the gap to the best loss."""
    figure, axes = plt.subplots(figsize=(7.5, 4.6), layout="constrained")
    for name, marker in zip(METHODS, MARKERS, strict=False):
        own = [row for row in rows if row["method"] == name]
        gaps = [max(row["gap"], 1e-10) for row in own]
        (line,) = axes.plot(gaps, [row["best_s"] for row in own], marker=marker, label=name, lw=0.8)
        axes.plot(gaps[-1], own[-1]["best_s"], marker, ms=12, mfc="none", color=line.get_color())
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="gap to the best loss found (1e-10: none)",
        ylabel="wall time, steady state [s]",
        title="Design search: 24 coefficients, 9 speeds; ringed: 64 starts, plain: 1 start",
    )
    axes.legend(fontsize=7)
    axes.grid(alpha=0.3)
    return figure


def main() -> None:
    """Measure, print, store."""
    rows = measure()
    by = {(row["method"], row["starts"]): row for row in rows}
    ours, whole = by[OURS, 64], by[WHOLE, 64]
    rivals = [
        by[f"SciPy L-BFGS-B, {what}", 64] for what in ("same gradient", "gradient from scratch")
    ]
    times = [
        f"{r['best_s']:.3g} s ({r['best_s'] / ours['best_s']:.1f} times as long, "
        f"{r['best_s'] / whole['best_s']:.1f} times as long as the whole call)"
        for r in rivals
    ]
    sentence = (
        f"From 64 starts our minimisations take {ours['best_s']:.3g} s, the whole call of "
        f"`optimise` with its plan, polish and certificate {whole['best_s']:.3g} s. SciPy's "
        f"L-BFGS-B in a loop takes {times[0]} with the same compiled gradient, which the plan has "
        f"made cheap, and {times[1]} with the compiled gradient of the loss as it is written. The "
        f"losses are {ours['loss']:.6f}, {rivals[0]['loss']:.6f} and {rivals[1]['loss']:.6f}."
    )
    columns = ["method", "starts", "first_s", "best_s", "loss", "gap"]
    harness.write("design", rows, sentence=sentence)
    harness.save_picture(picture(rows), "design")
    harness.section("design", harness.table(rows, columns) + "\n\n" + sentence)


if __name__ == "__main__":
    main()
