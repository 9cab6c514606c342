"""Functional Mock-up Units for co-simulation (FMI 2.0 and 3.0): the damper in machine code, the vehicle."""
