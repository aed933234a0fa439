"""Pictures and the offline page. Drawing never solves."""
