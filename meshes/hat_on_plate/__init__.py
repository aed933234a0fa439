"""A hat section standing on a plate."""
