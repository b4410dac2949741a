"""The design search: space, objective, minimisation, rivals."""

from mishutter.search.comparison import BEST_BURST as BEST_BURST
from mishutter.search.comparison import BEST_CODED_STILL as BEST_CODED_STILL
from mishutter.search.comparison import BEST_PANNED_SNAPSHOT as BEST_PANNED_SNAPSHOT
from mishutter.search.comparison import BEST_SNAPSHOT as BEST_SNAPSHOT
from mishutter.search.comparison import BEST_TUKEY as BEST_TUKEY
from mishutter.search.comparison import OWN_BEST_MOTION as OWN_BEST_MOTION
from mishutter.search.comparison import Comparison as Comparison
from mishutter.search.comparison import Row as Row
from mishutter.search.comparison import compare as compare
from mishutter.search.comparison import taken_names as taken_names
from mishutter.search.planning import plan as plan
from mishutter.search.search import MAX_STEPS as MAX_STEPS
from mishutter.search.search import NUM_COEFFICIENTS as NUM_COEFFICIENTS
from mishutter.search.search import Outcome as Outcome
from mishutter.search.search import SearchFailedError as SearchFailedError
from mishutter.search.search import moved_by_default as moved_by_default
from mishutter.search.search import optimise as optimise
from mishutter.search.search import starting_shutter as starting_shutter
from mishutter.search.search import with_device as with_device
from mishutter.search.search import without_pan as without_pan
from mishutter.search.solvers import NonFiniteLossError as NonFiniteLossError
from mishutter.search.space import fills as fills
