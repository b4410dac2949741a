"""Designs in a laboratory: drive tables, traces and calibration."""
