"""A virtual controller: exported programmes are run in time, and what a run leaves behind is read back."""
