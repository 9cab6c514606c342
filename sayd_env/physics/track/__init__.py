"""Track irregularities: spectra, measured files and realisations that the time step reads as splines."""

from sayd_env.measured.tracks import MeasuredTrack, read_measured
from sayd_env.physics.track.realisation import FADE_IN, GRID_STEP, TrackRealisation, realise
from sayd_env.physics.track.spectra import irregularity_psd, random_irregularity
from sayd_env.physics.track.spline import interpolation_coefficients, spline_table, spline_value_slope

__all__ = [
    "FADE_IN",
    "GRID_STEP",
    "MeasuredTrack",
    "TrackRealisation",
    "interpolation_coefficients",
    "irregularity_psd",
    "random_irregularity",
    "read_measured",
    "realise",
    "spline_table",
    "spline_value_slope",
]
