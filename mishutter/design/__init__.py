"""A finished design, and its file."""

from mishutter.design.design import GIVEN as GIVEN
from mishutter.design.design import Design as Design
from mishutter.design.design import Outcome as Outcome
from mishutter.design.design import given_design as given_design
from mishutter.design.design import metrics_to_dict as metrics_to_dict
from mishutter.design.design import motion_to_dict as motion_to_dict
from mishutter.design.design import package_version as package_version
from mishutter.design.design import scene_to_dict as scene_to_dict
from mishutter.design.design import sequence_to_dict as sequence_to_dict
