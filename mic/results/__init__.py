"""What a run leaves behind: its tables, statistics with their uncertainty, displacement fields."""
