"""Which way to the blur kernel is quickest at a given error, for value and for gradient?

A typical printout stands in `RESULTS.md`.
"""

import sys

import jax

jax.config.update("jax_enable_x64", True)

import matplotlib.pyplot as plt  # noqa: E402
import mpmath as mp  # noqa: E402
import numpy as np  # noqa: E402
from support import reference  # noqa: E402
from support.cases import SHUTTERS  # noqa: E402

from benchmarks import harness  # noqa: E402
from benchmarks.rivals import PASSING_TIMES, Method, Problem, methods  # noqa: E402

NUM_TAPS = 64
DESIGN_TAPS, DESIGN_SPEEDS = 192, 9
"""What a design computes in one call: a kernel at each of its speeds."""
MARKERS = "osv^<>DPX*"


def problems(num_taps: int = NUM_TAPS) -> list[Problem]:
    """The five kinds of problem, each over the whole of its support."""

    def problem(name, slug, stroke, smear, T=0.02):
        edges = np.linspace(-_behind(stroke, smear), stroke + abs(smear), num_taps + 1) + 0.013
        a, s = stroke / T**2, smear / T
        return Problem(name, slug, SHUTTERS[slug].shutter(), a, T, s, edges)

    return [
        problem("smooth shutter", "hann", 45.0, 27.0),
        problem("52 chips", "flutter", 60.0, 24.0),
        problem("spline", "spline", 45.0, -27.0),
        problem("near-zero acceleration", "hann", 1e-7, 26.0),
        problem("faster than the sensor", "hann", 4.0, 80.0),
    ]


def _behind(stroke, smear):
    return smear**2 / (4 * stroke) if abs(smear) < 2 * stroke else abs(smear) - stroke


def speeds_of(problem: Problem, num_speeds: int) -> np.ndarray:
    """The problem's speed alone, or as many from one way to the other."""
    return problem.s * (np.linspace(-1, 1, num_speeds) if num_speeds > 1 else np.ones(1))


def direction(num_taps: int) -> np.ndarray:
    """Weights of the taps in the scalar whose gradient is taken."""
    return np.cos(1.3 * np.arange(num_taps) + 0.2)


def exact(problem: Problem, speeds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Taps by speed, and the gradient of their weighted sum by a, T, speeds, by the reference.

    The gradient is by shares of a, of T and of the problem's speed.
    """
    window = SHUTTERS[problem.slug].reference()
    edges, scales = problem.edges.tolist(), np.abs([problem.a, problem.T, problem.s])

    def taps(motion):
        a, T, s = motion
        return reference.exposures(window, a, T, s, edges, from_vertex=False)

    def by(index, at):
        def moved(x):
            weighted = zip(taps([*at[:index], x, *at[index + 1 :]]), weights, strict=True)
            return [mp.fsum(h * float(c) for h, c in weighted)]

        return float(reference.derivative(moved, at[index], scales[index])[0])

    weights = direction(problem.edges.size - 1)
    motions = [(problem.a, problem.T, float(s)) for s in speeds]
    values = np.array([[float(h) for h in taps(at)] for at in motions])
    each = np.array([[by(index, at) for index in range(3)] for at in motions]) * scales
    return values, np.concatenate([each[:, :2].sum(axis=0), each[:, 2]])


def value_of(method: Method, num_speeds: int):
    """A method's taps, by speed, as a function of a row of a, T and the speeds."""
    if num_speeds == 1:
        return lambda row: method.taps(row[0], row[1], row[2])[None]
    if method.compiled:
        every = jax.vmap(method.taps, in_axes=(None, None, 0))
        return lambda row: every(row[0], row[1], row[2:])
    return lambda row: np.stack([method.taps(row[0], row[1], s) for s in row[2:]])


def gradient_of(method: Method, num_speeds: int, weights: np.ndarray, scales: np.ndarray):
    """Gradient of the weighted sum of a method's taps by shares of `scales`."""
    value = value_of(method, num_speeds)

    def total(shares):
        return (value(shares * scales) * weights).sum()

    if method.compiled:
        return jax.jit(jax.grad(total))

    def differences(shares):
        steps = 1e-6 * np.eye(shares.size)
        return np.array([(total(shares + d) - total(shares - d)) / 2e-6 for d in steps])

    return differences


def measure(problem: Problem, num_speeds: int) -> list[dict]:
    """A row a method and setting: time and error of value and of gradient."""
    speeds = speeds_of(problem, num_speeds)
    taps, gradient = exact(problem, speeds)
    row = np.concatenate([[problem.a, problem.T], speeds])
    scales = np.abs([problem.a, problem.T, *[problem.s] * num_speeds])
    weights = direction(problem.edges.size - 1)
    rows = []
    for method in methods(problem):
        value = value_of(method, num_speeds)
        for what, function, argument, truth in (
            ("value", jax.jit(value) if method.compiled else value, row, taps),
            ("gradient", gradient_of(method, num_speeds, weights, scales), row / scales, gradient),
        ):
            named = {"problem": problem.name, "method": method.name, "knob": method.knob}
            try:
                result = harness.timed(function, argument)
                found = np.asarray(result.pop("value"), float)
                error = float(np.max(np.abs(found - truth)) / np.max(np.abs(truth)))
            except Exception as problem_met:
                result, error = harness.failed(problem_met), float("nan")
            rows.append({**named, "what": what, "error": error, **result})
    return rows


def picture(rows: list[dict], name: str) -> None:
    """Error along x, time along y; a method is a marker of its own, ours are filled."""
    columns = list(dict.fromkeys(row["problem"] for row in rows))
    labels = [label for label in dict.fromkeys(r["method"] for r in rows) if label != PASSING_TIMES]
    figure, panels = plt.subplots(
        2, len(columns), figsize=(10.5, 6), sharex=True, sharey=True, layout="constrained"
    )
    for (line, what), (column, problem) in (
        (i, j) for i in enumerate(("value", "gradient")) for j in enumerate(columns)
    ):
        panel = panels[line, column]
        for index, label in enumerate(labels):
            here = problem, what, label
            chosen = [r for r in rows if (r["problem"], r["what"], r["method"]) == here]
            x = [max(r["error"], 1e-17) for r in chosen]
            y = [1e3 * r["best_s"] for r in chosen]
            mine = label.startswith("ours")
            panel.loglog(
                x,
                y,
                MARKERS[index] + ("" if mine else "-"),
                label=label,
                color="black" if mine else plt.cm.viridis(index / len(labels)),
                markerfacecolor="black" if mine else "white",
                markersize=9 if mine else 6,
            )
        panel.set_title(problem if line == 0 else "", fontsize="medium")
        panel.grid(alpha=0.3)
    for line, what in enumerate(("value", "gradient")):
        panels[line, 0].set_ylabel(f"run time of the {what}, ms")
    for panel in panels[1]:
        panel.set_xlabel("error / largest")
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=5)
    harness.save_picture(figure, name)
    plt.close(figure)


def main() -> None:
    """Measure, store, print and draw."""
    design = f"{DESIGN_SPEEDS} speeds of {DESIGN_TAPS} taps, as a design computes them"
    sizes = (
        ("kernel", design, DESIGN_TAPS, DESIGN_SPEEDS),
        ("kernel_alone", f"one speed of {NUM_TAPS} taps", NUM_TAPS, 1),
    )
    columns = [
        "problem",
        "what",
        "method",
        "knob",
        "error",
        "best ms",
        "to ours",
        "first call s",
        "why",
    ]
    text = "## Kernel: run time against error\n"
    for name, heading, num_taps, num_speeds in sizes:
        rows: list[dict] = []
        for problem in problems(num_taps):
            rows += measure(problem, num_speeds)
            harness.write(name, rows, num_taps=num_taps, num_speeds=num_speeds)
            print(f"kernel: {heading}, {problem.name} done", file=sys.stderr)
        picture(rows, name)
        text += f"\nIn one call {heading}; times also to those of ours in float64. Passing times "
        text += "alone are the kernel of an open shutter, the least that anything exact computes:"
        text += f"\n\n![{name}](results/{name}.png)\n\n"
        text += harness.table(_shown(rows), columns) + "\n"
    harness.section("kernel", text)


def _shown(rows: list[dict]) -> list[dict]:
    """Rows for the table, with each time's ratio to that of ours, in double precision."""
    mine = {
        (row["problem"], row["what"]): row["best_s"]
        for row in rows
        if row["method"] == "ours, float64"
    }
    return [
        {
            **row,
            "best ms": 1e3 * row["best_s"],
            "to ours": row["best_s"] / mine[row["problem"], row["what"]],
            "first call s": row["first_s"],
        }
        for row in rows
    ]


if __name__ == "__main__":
    main()
