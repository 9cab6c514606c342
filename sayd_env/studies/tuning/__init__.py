"""Searches: the gains of a controller, the free numbers of the vehicle."""
