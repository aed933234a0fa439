"""A synthetic wheelhouse: an arched inner shell and an outer panel that meet in a flange along the arch."""
