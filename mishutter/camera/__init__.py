"""The recorded picture: capture, occlusion, footage and noise."""

from mishutter.camera.capture import as_light as as_light
from mishutter.camera.capture import as_pixels as as_pixels
from mishutter.camera.capture import blurred_at_speeds as blurred_at_speeds
from mishutter.camera.capture import captured_response as captured_response
from mishutter.camera.capture import centred_kernel as centred_kernel
from mishutter.camera.capture import distinct_colours as distinct_colours
from mishutter.camera.capture import every_colour as every_colour
from mishutter.camera.capture import kernel_layout as kernel_layout
from mishutter.camera.capture import noisy as noisy
from mishutter.camera.capture import simulate_capture as simulate_capture
from mishutter.camera.capture import skips as skips
from mishutter.camera.capture import through_optics as through_optics
from mishutter.camera.footage import VIDEO_SUFFIXES as VIDEO_SUFFIXES
from mishutter.camera.footage import Frames as Frames
from mishutter.camera.footage import read_frames as read_frames
from mishutter.camera.layers import Layer as Layer
from mishutter.camera.layers import Layers as Layers
from mishutter.camera.layers import is_layers_file as is_layers_file
from mishutter.camera.layers import read_layers as read_layers
from mishutter.camera.noise import fixed_key as fixed_key
from mishutter.camera.noise import white_electrons as white_electrons
from mishutter.camera.rows import along_rows as along_rows
from mishutter.camera.rows import blurred as blurred
from mishutter.camera.rows import channels_last as channels_last
from mishutter.camera.rows import fast_length as fast_length
from mishutter.camera.rows import rows_last as rows_last
