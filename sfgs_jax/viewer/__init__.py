"""Room of viewer."""
