"""Names of the loss by borders in the plane."""

from mishutter.evaluation.sequences import LONG as LONG
from mishutter.evaluation.sequences import loss_of_width as loss_of_borders

__all__ = ["LONG", "loss_of_borders"]
