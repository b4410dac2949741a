"""Pictures: their files, their linear light, and the power spectrum of their rows."""

from mishutter.pictures.files import PICTURE_FORMATS as PICTURE_FORMATS
from mishutter.pictures.files import PICTURE_SUFFIXES as PICTURE_SUFFIXES
from mishutter.pictures.files import Decoded as Decoded
from mishutter.pictures.files import header_size as header_size
from mishutter.pictures.images import LUMINANCE as LUMINANCE
from mishutter.pictures.images import Axis as Axis
from mishutter.pictures.images import Capture as Capture
from mishutter.pictures.images import Picture as Picture
from mishutter.pictures.images import PictureWarning as PictureWarning
from mishutter.pictures.images import checked_white as checked_white
from mishutter.pictures.images import decoded_pages as decoded_pages
from mishutter.pictures.images import examined as examined
from mishutter.pictures.images import example_picture as example_picture
from mishutter.pictures.images import light_of as light_of
from mishutter.pictures.images import middle_rows as middle_rows
from mishutter.pictures.images import pixels_along as pixels_along
from mishutter.pictures.images import read_captures as read_captures
from mishutter.pictures.images import read_levels as read_levels
from mishutter.pictures.images import read_opacity as read_opacity
from mishutter.pictures.images import read_picture as read_picture
from mishutter.pictures.images import row_power_spectrum as row_power_spectrum
from mishutter.pictures.images import shipped_picture as shipped_picture
from mishutter.pictures.images import to_display as to_display
from mishutter.pictures.images import turned as turned
from mishutter.pictures.images import write_picture as write_picture
