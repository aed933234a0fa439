"""Code that several test modules share; it contains no test."""
