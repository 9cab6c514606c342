"""Readers of files that people have: recordings, profiles, track geometry, lines, dampers."""
