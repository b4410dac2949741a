"""Pictures and tables of designs, comparisons and sweeps."""

from mishutter.report.photographs import photograph_of as photograph_of
from mishutter.report.photographs import photographs as photographs
from mishutter.report.photographs import scene_picture as scene_picture
from mishutter.report.plots import plot_capture as plot_capture
from mishutter.report.plots import plot_drive as plot_drive
from mishutter.report.plots import save_figure as save_figure
from mishutter.report.sweep_plots import write_pictures as write_pictures
from mishutter.report.tables import Report as Report
from mishutter.report.tables import document as document
from mishutter.report.tables import named_shutter as named_shutter
from mishutter.report.tables import print_report as print_report
from mishutter.report.tables import shown_rows as shown_rows
from mishutter.report.tables import write_report as write_report
