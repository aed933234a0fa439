"""The results of a run: tables, statistics with their uncertainty, displacement fields."""
