"""What does a background cost a search, in the time of a loss and of its gradient?

The loss of a search over profile, acceleration and exposure of the built-in scene, as a whole,
before a still background and before one that moves.
"""

import jax
import jax.numpy as jnp
import numpy as np

import mishutter as ms
from benchmarks import harness
from mishutter._core.compiling import compiled
from mishutter.evaluation.layers import computed_speeds
from mishutter.evaluation.needs import reduced
from mishutter.model.scene import example_scene
from mishutter.search.objective import AbstractObjective, objective_of
from mishutter.search.planning import plan as plan_of_scene
from mishutter.search.search import NUM_COEFFICIENTS, starting_shutter
from mishutter.search.space import design_space

FREE = ("shutter", "half_exposure", "acceleration")
OCCLUSIONS = {
    "as a whole": None,
    "before a still background": ms.Occlusion(front_share=0.5, object_width=100.0),
    "both layers move": ms.Occlusion(front_share=0.3, object_width=100.0, background="moving"),
}
TEXT = """## The time of a loss before a background

A search over {free} of the built-in scene takes a loss and its gradient by {coordinates}
coordinates, compiled as the package compiles, in single precision; ms, and in times of those as a
whole. `speeds` are those at which transfer functions are computed.

{table}
"""


def objective(occlusion: ms.Occlusion | None) -> tuple[AbstractObjective, int]:
    """The objective of a search by the expected error, and the speeds that it computes."""
    loss, scene = ms.ExpectedErrorLoss(), example_scene().with_occlusion(occlusion)
    motion, shutter = scene.fullest_motion, starting_shutter(scene, NUM_COEFFICIENTS)
    space = design_space(scene, motion, shutter, FREE)
    plan = plan_of_scene(scene, motion, shutter, loss=loss, free=FREE).sizes
    few = reduced(scene, plan)
    return objective_of(loss, few, space, plan), computed_speeds(few).size


def row(picture: str, occlusion: ms.Occlusion | None) -> dict:
    """Times of a loss and of its gradient."""
    function, num_speeds = objective(occlusion)
    size = function.space.size  # type: ignore[attr-defined]
    box = jnp.asarray(np.random.default_rng(0).uniform(0.3, 0.7, size), jnp.float32)
    value = harness.timed(compiled(lambda f, x: f(x)), function, box)
    both = harness.timed(compiled(lambda f, x: jax.value_and_grad(f)(x)), function, box)
    return {
        "picture": picture,
        "speeds": num_speeds,
        "coordinates": size,
        "loss ms": 1e3 * value["best_s"],
        "with gradient ms": 1e3 * both["best_s"],
    }


def main() -> None:
    """Measure, store and print."""
    rows = [row(*each) for each in OCCLUSIONS.items()]
    for each in rows:
        for name in ("loss", "with gradient"):
            each[f"{name}, times"] = each[f"{name} ms"] / rows[0][f"{name} ms"]
    harness.write("layered_loss", rows)
    table = [
        {k: f"{v:.3g}" if isinstance(v, float) else str(v) for k, v in each.items()}
        for each in rows
    ]
    columns = [name for name in table[0] if name != "coordinates"]
    text = TEXT.format(
        free=" and ".join(FREE).replace(" and ", ", ", len(FREE) - 2).replace("_", " "),
        coordinates=rows[0]["coordinates"],
        table=harness.table(table, columns),
    )
    harness.section("layered_loss", text)


if __name__ == "__main__":
    main()
