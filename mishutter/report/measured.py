"""A measured shutter beside its design: its loss, and the part that a shift in time wins back."""

from dataclasses import replace
from typing import Any, NamedTuple

from mishutter.design.design import given_design
from mishutter.hardware.traces import MeasuredProfile, Trace, measured_profile
from mishutter.model.scene import Scene
from mishutter.search.rows import LEAST_SHOWN, Row


class MeasuredCamera(NamedTuple):
    """Levels of a measured shutter, as measured and at its best shift in time."""

    level: float  # Expected PSNR as measured; dB
    design_level: float | None  # Expected PSNR of the design; dB, None without a design
    # Best advance of the shutter against the stage and the exposure, which stay as they are; s,
    # negative for a delay
    earlier: float
    shifted_level: float  # Expected PSNR with that advance; dB

    def lines(self) -> list[str]:
        """Sentences on the loss against the design, and on the best shift."""
        lines = [f"As measured: {self.level:.2f} dB{self._beside_design(self.level)}."]
        if self.shifted_level < self.level + LEAST_SHOWN:
            return [*lines, "No shift in time against the stage gives more."]
        way = "earlier" if self.earlier > 0 else "later"
        beside = self._beside_design(self.shifted_level)
        shift = f"{abs(self.earlier) * 1e3:.2g} ms {way}"
        return [*lines, f"Sent {shift} it has {self.shifted_level:.2f} dB{beside}."]

    def to_dict(self) -> dict[str, float | None]:
        """The levels and the shift, as plain numbers."""
        return {
            "level_db": self.level,
            "design_level_db": self.design_level,
            "best_sent_earlier_ms": self.earlier * 1e3,
            "shifted_level_db": self.shifted_level,
        }

    def _beside_design(self, level: float) -> str:
        if self.design_level is None:
            return ""
        below = self.design_level - level
        return f", {abs(below):.2f} dB {'below' if below >= 0 else 'above'} the design"


def measured_camera(
    scene: Scene,
    rows: dict[str, Row],
    trace: Trace,
    profile: MeasuredProfile,
    *,
    middle: float,  # s
    measured: str,
    designed: str,  # there may be no such row
) -> MeasuredCamera:
    r"""A measured shutter beside its design, and at its best shift against the stage.

    The best shift maximises the level by which rows are judged. It is at most a quarter of the
    exposure either way, and the trace must still cover the exposure. A bounded search in one
    variable finds it; every step fits the trace again at another mid-exposure, with the same levels
    of the closed and of the open shutter.
    """
    from scipy.optimize import minimize_scalar

    row = rows[measured]
    half = float(row.motion.half_exposure)

    def loss(earlier: float) -> float:
        moved = measured_profile(
            trace,
            half_exposure=half,
            middle=middle + earlier,
            closed=profile.closed,
            opened=profile.opened,
        )
        camera = given_design(scene, row.motion, moved.shutter, "Shifted.", is_measured=True)
        return -replace(row, exposures=camera.exposures, metrics=camera.metrics).level

    best: Any = minimize_scalar(
        loss,
        bounds=trace.span_of_shifts(half, middle),
        method="bounded",
        options={"xatol": 1e-3 * half},
    )
    design_level = rows[designed].level if designed in rows else None
    return MeasuredCamera(row.level, design_level, float(best.x), -float(best.fun))
