"""Verdicts, pictures and documents of designs, comparisons and sweeps.

Pictures are imported from here. Only a function that draws imports matplotlib.
"""

from mishutter.report.fit_plots import plot_fit as plot_fit
from mishutter.report.measurement_plots import plot_motion as plot_motion
from mishutter.report.measurement_plots import plot_noise as plot_noise
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
from mishutter.report.sweep_plots import plot_front as plot_front
from mishutter.report.sweep_plots import plot_map as plot_map
