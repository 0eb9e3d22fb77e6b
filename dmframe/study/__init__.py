"""Studies: many runs of graphs with varied parameters, their execution, their report, and tuning."""
