"""Recordings: readers of data files, units, sampling and resampling."""
