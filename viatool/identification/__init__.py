"""Measuring errors: what a recording tells about the sensors, motors and clocks of a robot."""

from viatool.identification.findings import Bounding, Identification, MeasuredTerm, UnmeasuredTerm
from viatool.identification.job import measure_errors

__all__ = ["Bounding", "Identification", "MeasuredTerm", "UnmeasuredTerm", "measure_errors"]
