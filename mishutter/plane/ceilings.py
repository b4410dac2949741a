"""The name of the ceiling of exposures for searches in the plane."""

from mishutter.evaluation.ceilings import exposures_ceiling as plane_ceiling

__all__ = ["plane_ceiling"]
