"""Room of gicp."""
