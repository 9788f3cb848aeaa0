"""Identification methods, which differ in the motion along which (7) is written."""
