"""Verdicts, pictures and documents of designs, comparisons and sweeps.

Only a function that draws imports matplotlib.
"""

from mishutter.report.backgrounds import STILL_SHARES as STILL_SHARES
from mishutter.report.backgrounds import BackgroundGain as BackgroundGain
from mishutter.report.backgrounds import background_gains as background_gains
from mishutter.report.backgrounds import background_line as background_line
from mishutter.report.comparison import Comparison as Comparison
from mishutter.report.comparison import compare as compare
from mishutter.report.comparison import with_verdict as with_verdict
from mishutter.report.documents import Report as Report
from mishutter.report.documents import document as document
from mishutter.report.documents import file_to_build as file_to_build
from mishutter.report.documents import photograph_levels as photograph_levels
from mishutter.report.documents import pictured_rows as pictured_rows
from mishutter.report.documents import write_background as write_background
from mishutter.report.documents import write_report as write_report
from mishutter.report.fit_plots import plot_fit as plot_fit
from mishutter.report.in_plane import PlaneReport as PlaneReport
from mishutter.report.in_plane import write_plane_report as write_plane_report
from mishutter.report.measured import MeasuredCamera as MeasuredCamera
from mishutter.report.measured import measured_camera as measured_camera
from mishutter.report.measurement_plots import plot_motion as plot_motion
from mishutter.report.measurement_plots import plot_noise as plot_noise
from mishutter.report.plots import camera_text as camera_text
from mishutter.report.plots import motion_text as motion_text
from mishutter.report.plots import plot_capture as plot_capture
from mishutter.report.plots import plot_design as plot_design
from mishutter.report.plots import plot_drive as plot_drive
from mishutter.report.plots import plot_frames as plot_frames
from mishutter.report.plots import plot_kernels as plot_kernels
from mishutter.report.plots import plot_levels as plot_levels
from mishutter.report.plots import plot_option as plot_option
from mishutter.report.plots import plot_photograph as plot_photograph
from mishutter.report.plots import plot_profiles as plot_profiles
from mishutter.report.plots import plot_psnr as plot_psnr
from mishutter.report.plots import plot_transfer as plot_transfer
from mishutter.report.plots import save_figure as save_figure
from mishutter.report.plots import shown_name as shown_name
from mishutter.report.restored import photograph_of as photograph_of
from mishutter.report.restored import photographs as photographs
from mishutter.report.sweep_plots import plot_front as plot_front
from mishutter.report.sweep_plots import plot_map as plot_map
from mishutter.report.sweep_plots import write_pictures as write_pictures
from mishutter.report.tables import Table as Table
from mishutter.report.tables import comparison_tables as comparison_tables
from mishutter.report.tables import joined_name as joined_name
from mishutter.report.tables import page_table as page_table
from mishutter.report.verdict import device_notes as device_notes
from mishutter.report.verdict import option_name as option_name
