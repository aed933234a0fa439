"""What several test modules share, in modules named by what they hold. No test imports another test."""
