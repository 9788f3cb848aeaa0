"""Identified parameters written into the files of simulators."""
