"""The simulator: vehicle, contact, track and dampers. Knows no Gymnasium, no policy, no result file."""
