"""Room of datasets."""
