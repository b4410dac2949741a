"""Things that move in any direction, and frames of a sensor that moves in the plane."""

from mishutter.plane.ceilings import plane_ceiling as plane_ceiling
from mishutter.plane.families import FAMILIES as FAMILIES
from mishutter.plane.families import FREE as FREE
from mishutter.plane.families import PAN as PAN
from mishutter.plane.families import frames_of as frames_of
from mishutter.plane.frames import PlaneFrames as PlaneFrames
from mishutter.plane.levels import MEASURED as MEASURED
from mishutter.plane.levels import SEARCHED as SEARCHED
from mishutter.plane.levels import Grid as Grid
from mishutter.plane.levels import cross_motion_loss as cross_motion_loss
from mishutter.plane.levels import plane_psnr as plane_psnr
from mishutter.plane.search import PlaneBurst as PlaneBurst
from mishutter.plane.search import PlaneSearch as PlaneSearch
from mishutter.plane.search import best_in_plane as best_in_plane
from mishutter.plane.search import grid_words as grid_words
