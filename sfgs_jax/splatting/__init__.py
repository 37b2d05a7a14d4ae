"""Room of splatting."""
