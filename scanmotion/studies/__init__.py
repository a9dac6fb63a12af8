"""Many plans at once: which cell, which robot, which method, over a whole collection; run by Dask."""
