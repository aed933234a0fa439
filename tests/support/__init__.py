"""What several test modules need; no test stands in here."""
