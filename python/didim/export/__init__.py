"""Identified parameters written into the files of simulators and controllers."""

from .code.c_header import to_c as to_c
from .code.latex import to_latex as to_latex
from .mjcf import to_mjcf as to_mjcf
from .sdf import to_sdf as to_sdf
from .urdf import to_urdf as to_urdf
