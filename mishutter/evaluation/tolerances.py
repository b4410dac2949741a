"""The cost of each tolerance of a scene: where an engineer's money is best spent."""

from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from mishutter._core.checks import require_known
from mishutter._core.compiling import compiled, outside_trace
from mishutter.evaluation.ensembles import without_tolerances
from mishutter.evaluation.errors import LinearErrors
from mishutter.evaluation.needs import ONLY_SPECTRA, Plan
from mishutter.evaluation.response import Records
from mishutter.evaluation.views import sampled_view
from mishutter.model.motion import AbstractMotion
from mishutter.model.scene import Scene, require_scene
from mishutter.model.shutters.base import AbstractShutter
from mishutter.model.tolerances import TOLERANCE_NAMES

_UNITS = {
    "acceleration": ("%", 1e2),
    "velocity": ("px/s", 1.0),
    "delay": ("us", 1e6),
    "speed": ("px/s", 1.0),
    "transmittance": ("%", 1e2),
}
_ALL = "all"


@dataclass(frozen=True)
class ToleranceCost:
    """One tolerance, and its cost for a design by itself."""

    name: str  # The field of `Tolerances`; "all" for all of them together
    size: str  # The tolerance in words, with its unit
    cost: float  # Fall of the PSNR for a decoder that knows the distribution of the errors; dB
    unaware_cost: float  # Fall for a decoder that is made for a camera without errors; dB


@dataclass(frozen=True)
class ToleranceCosts:
    """Costs of the tolerances of a scene for a design."""

    expected_psnr: float  # Expected PSNR of a camera without errors; dB
    rows: tuple[ToleranceCost, ...]  # Cost of each tolerance above 0, and of all together

    @property
    def largest(self) -> ToleranceCost | None:
        """The tolerance that costs most by itself; None where none costs anything."""
        single = [row for row in self.rows if row.name != _ALL]
        return max(single, key=lambda row: row.cost, default=None)

    @property
    def verdict(self) -> str:
        """The tolerance to spend money on, in a sentence."""
        largest = self.largest
        if largest is None:
            return "No tolerance costs anything."
        share = f"{largest.cost:z.3f} of {self.rows[-1].cost:z.3f} dB"
        return f"The largest is the {largest.name}, {largest.size}: {share}."

    def to_dict(self) -> dict[str, object]:
        """The table as plain numbers and text."""
        rows = [
            {
                "name": row.name,
                "size": row.size,
                "cost_db": row.cost,
                "unaware_cost_db": row.unaware_cost,
            }
            for row in self.rows
        ]
        largest = None if self.largest is None else self.largest.name
        return {"expected_psnr_db": self.expected_psnr, "rows": rows, "largest": largest}

    def text(self) -> str:
        """The table as lines of fixed width, and the verdict below it."""
        lines = [f"{'tolerance':<15}{'1 sigma':>24}{'costs dB':>10}{'unaware dB':>12}"]
        lines += [
            f"{row.name:<15}{row.size:>24}{row.cost:>z10.3f}{row.unaware_cost:>z12.3f}"
            for row in self.rows
        ]
        return "\n".join([*lines, self.verdict])


@outside_trace()
def tolerance_costs(
    scene: Scene, motion: AbstractMotion, shutter: AbstractShutter
) -> ToleranceCosts:
    """Measures the cost of each of a scene's tolerances for a design, and of all together.

    A decoder that knows the distribution of the errors is the best single linear filter for
    them; one that is unaware is the best filter of a camera without errors.

    Args:
        scene: Speeds, light, noise and tolerances; concrete.
        motion: Motion of the sensor.
        shutter: Transmittance over the exposure.

    Raises:
        ValueError: if the scene has no tolerances, or JAX traces anything.
    """
    require_scene(scene)
    require_known("tolerance_costs", scene=scene, motion=motion, shutter=shutter)
    tolerances = scene.tolerances
    if tolerances is None:
        raise ValueError("`tolerance_costs(scene=...)` must have tolerances; got none.")
    names = [name for name in TOLERANCE_NAMES if float(getattr(tolerances, name)) > 0]
    rows, nominal = [], 0.0
    for name in (*names, _ALL):
        some = tolerances if name == _ALL else tolerances.alone(name)
        own = eqx.tree_at(lambda s: s.tolerances, scene, some)
        view = sampled_view(own, motion, shutter, ONLY_SPECTRA)
        without = view._replace(scene=without_tolerances(view.scene))
        records = Records.of(view), Records.of(without)
        errors = _errors(view.scene, view.motion, *records, view.plan)
        nominal, aware, unaware = (float(level) for level in -10 * jnp.log10(jnp.stack(errors)))
        size = "" if name == _ALL else _size(scene, name)
        rows.append(ToleranceCost(name, size, nominal - aware, nominal - unaware))
    return ToleranceCosts(nominal, tuple(rows))


def _size(scene: Scene, name: str) -> str:
    unit, factor = _UNITS[name]
    size = f"{float(getattr(scene.tolerances, name)) * factor:.4g} {unit}"
    if name != "transmittance":
        return size
    return f"{size} in {float(scene.tolerances.drive_step) * 1e6:.4g} us"  # type: ignore[union-attr]


@compiled
def _errors(
    scene: Scene, motion: AbstractMotion, recorded: Records, without: Records, plan: Plan
) -> tuple[Float[Array, ""], Float[Array, ""], Float[Array, ""]]:
    """Squared errors without tolerances, within them, and within them by an unaware decoder."""
    nominal_scene = without_tolerances(scene)
    nominal = LinearErrors(nominal_scene, motion, without.response(nominal_scene, plan))
    within = LinearErrors(scene, motion, recorded.response(scene, plan))
    return nominal.unknown, within.unknown, within.unaware(nominal)
