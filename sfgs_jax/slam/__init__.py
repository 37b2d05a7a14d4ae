"""Room of slam."""
