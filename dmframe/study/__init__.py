"""Studies: what varies over how many runs, where they run, and what they say."""
