"""Functional Mock-up Units (FMI 2.0 and 3.0, co-simulation): the damper as machine code, the vehicle in Python."""
