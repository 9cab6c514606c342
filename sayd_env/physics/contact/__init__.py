"""Wheel-rail contact: geometry tables, Hertz, Kalker, and the creep-force laws."""
