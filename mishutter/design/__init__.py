"""The design search: space, objective, solvers, comparison and drive table."""

from mishutter.design.comparison import BEST_CODED_STILL as BEST_CODED_STILL
from mishutter.design.comparison import BEST_PANNED_SNAPSHOT as BEST_PANNED_SNAPSHOT
from mishutter.design.comparison import BEST_SNAPSHOT as BEST_SNAPSHOT
from mishutter.design.comparison import BEST_TUKEY as BEST_TUKEY
from mishutter.design.comparison import OWN_BEST_MOTION as OWN_BEST_MOTION
from mishutter.design.comparison import Comparison as Comparison
from mishutter.design.comparison import Row as Row
from mishutter.design.comparison import compare as compare
from mishutter.design.comparison import taken_names as taken_names
from mishutter.design.drive import DriveTable as DriveTable
from mishutter.design.drive import drive_table as drive_table
from mishutter.design.planning import plan as plan
from mishutter.design.result import Design as Design
from mishutter.design.result import package_version as package_version
from mishutter.design.result import scene_to_dict as scene_to_dict
from mishutter.design.result import shutter_from_dict as shutter_from_dict
from mishutter.design.result import shutter_to_dict as shutter_to_dict
from mishutter.design.search import Outcome as Outcome
from mishutter.design.search import SearchFailedError as SearchFailedError
from mishutter.design.search import best_profile as best_profile
from mishutter.design.search import moved_by_default as moved_by_default
from mishutter.design.search import optimise as optimise
from mishutter.design.search import starting_shutter as starting_shutter
from mishutter.design.solvers import NonFiniteLossError as NonFiniteLossError
from mishutter.design.space import fills as fills
from mishutter.design.starts import window_fits as window_fits
