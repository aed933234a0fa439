"""Two flat strips in a lap joint."""
