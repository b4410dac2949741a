"""Labelled grids of designs: grid, run, search, store, cluster and trade-offs."""

from mishutter.sweeps.grid import OPTIMISED as OPTIMISED
from mishutter.sweeps.grid import frames_of as frames_of
from mishutter.sweeps.grid import require_some_inside as require_some_inside
from mishutter.sweeps.grid import require_within as require_within
from mishutter.sweeps.run import WHY_NO_POINT as WHY_NO_POINT
from mishutter.sweeps.run import sweep as sweep
from mishutter.sweeps.trade_offs import best_points as best_points
from mishutter.sweeps.trade_offs import best_snapshots as best_snapshots
from mishutter.sweeps.trade_offs import gain_over as gain_over
from mishutter.sweeps.trade_offs import gain_over_snapshot as gain_over_snapshot
from mishutter.sweeps.trade_offs import is_higher_better as is_higher_better
from mishutter.sweeps.trade_offs import level_of as level_of
from mishutter.sweeps.trade_offs import light_map as light_map
from mishutter.sweeps.trade_offs import pareto_front as pareto_front
